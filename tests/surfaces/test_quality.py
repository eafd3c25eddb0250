"""Shapes of known triangles."""

import numpy as np
import pytest
import trimesh

import esfem_core as ec


def test_an_octahedron_has_equilateral_triangles_of_side_root_two():
    q = ec.mesh_quality(ec.sphere("octahedron", 0))
    assert (q.vertices, q.triangles, q.euler) == (6, 8, 2)
    assert [q.min_angle, q.max_angle] == pytest.approx([60, 60])
    assert [q.mean_ratio, q.min_ratio, q.uniformity] == pytest.approx([1, 1, 1])
    assert [q.h_min, q.h_mean, q.h_max] == pytest.approx([np.sqrt(2)] * 3)


def test_angles_lengths_and_ratios_agree_with_trimesh_and_the_radii():
    tri = trimesh.creation.torus(2.0, 0.5)
    q = ec.mesh_quality(tri)
    assert q.euler == tri.euler_number == 0
    assert q.min_angle == pytest.approx(np.degrees(tri.face_angles.min()))
    assert q.max_angle == pytest.approx(np.degrees(tri.face_angles.max()))
    a, b, c = np.linalg.norm(np.diff(tri.triangles[:, [0, 1, 2, 0]], axis=1), axis=2).T
    r_in, r_out = 2 * tri.area_faces / (a + b + c), a * b * c / (4 * tri.area_faces)
    assert q.min_ratio == pytest.approx((2 * r_in / r_out).min())
    assert q.mean_ratio == pytest.approx((2 * r_in / r_out).mean())
    length = tri.edges_unique_length
    assert [q.h_min, q.h_mean, q.h_max] == pytest.approx(
        [length.min(), length.mean(), length.max()]
    )


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_each_edge_counts_once_in_the_mean(turn):
    """A square of two triangles: its diagonal is a side of both, wherever their corners begin."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    faces = [np.roll([0, 1, 2], turn), [0, 2, 3]]
    q = ec.mesh_quality(trimesh.Trimesh(corners, faces, process=False))
    assert q.h_mean == pytest.approx((4 * 1 + np.sqrt(2)) / 5)


def test_on_a_closed_surface_the_mean_of_edges_is_that_of_sides():
    tri = trimesh.creation.torus(2.0, 0.5)
    sides = np.linalg.norm(np.diff(tri.triangles[:, [0, 1, 2, 0]], axis=1), axis=2)
    assert ec.mesh_quality(tri).h_mean == pytest.approx(sides.mean(), rel=1e-14)


def test_a_notebook_shows_a_table():
    q = ec.mesh_quality(ec.sphere("icosahedron", 2))
    assert "smallest angle: 54." in str(q)
    assert "<td>Euler number</td><td>2</td>" in q._repr_html_()


def test_a_collapsed_triangle_has_ratio_zero():
    q = ec.mesh_quality(trimesh.Trimesh(np.eye(3), [[0, 1, 2], [0, 0, 1]], process=False))
    assert (q.min_ratio, q.min_angle) == (0, 0)
    assert q.mean_ratio == pytest.approx(0.5)


def test_a_triangle_that_is_a_point_has_no_angles():
    q = ec.mesh_quality(trimesh.Trimesh(np.eye(3), [[0, 1, 2], [0, 0, 0]], process=False))
    assert (q.min_angle, q.max_angle) == pytest.approx((0, 60))


def test_only_triangles_can_be_measured():
    with pytest.raises(TypeError, match=r"tri must be a trimesh\.Trimesh, got None"):
        ec.mesh_quality(None)
    with pytest.raises(ValueError, match="tri must have triangles, got none"):
        ec.mesh_quality(trimesh.Trimesh())


def test_the_euler_number_is_that_of_any_mesh():
    tri = ec.sphere("octahedron", 2)
    tri.update_faces(tri.triangles_center[:, 2] > 0)
    assert ec.mesh_quality(tri).euler == 1  # vertices without triangles do not count
    tri.remove_unreferenced_vertices()
    assert ec.mesh_quality(tri).euler == 1


def test_an_edge_without_length_makes_a_mesh_infinitely_uneven():
    q = ec.mesh_quality(trimesh.Trimesh(np.eye(3), [[0, 1, 2], [0, 0, 1]], process=False))
    assert q.uniformity == np.inf
    assert "longest edge over shortest: inf" in str(q)


def test_vertices_that_are_not_finite_are_named():
    tri = ec.sphere("octahedron", 1)
    tri.vertices[3] = np.nan
    with pytest.raises(ValueError, match=r"tri must have finite vertices, but vertex 3 is \[nan"):
        ec.mesh_quality(tri)


def test_triangles_without_their_corners_are_refused():
    with pytest.raises(ValueError, match="of its vertices, 0 to 2, but they name 0 to 9"):
        ec.mesh_quality(trimesh.Trimesh(np.eye(3), [[0, 1, 9]], process=False))


@pytest.mark.parametrize("power", [-700, 700])
def test_a_mesh_of_any_size_is_measured(power):
    tri = ec.sphere("octahedron", 1)
    one, other = (
        ec.mesh_quality(trimesh.Trimesh(2.0**n * tri.vertices, tri.faces, process=False))
        for n in (0, power)
    )
    assert other.h_mean == 2.0**power * one.h_mean
    assert (other.min_angle, other.min_ratio) == (one.min_angle, one.min_ratio)
