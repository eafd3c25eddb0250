"""Spheres, tori and displaced meshes: sizes, closed and on their surface, what is refused."""

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.surfaces import bisected_sphere, displaced


@pytest.mark.parametrize("refinements", range(4))
def test_spheres_have_the_stated_number_of_vertices(refinements):
    assert len(ec.sphere("octahedron", refinements).vertices) == 4 ** (refinements + 1) + 2
    assert len(ec.sphere("icosahedron", refinements).vertices) == 10 * 4**refinements + 2


@pytest.mark.parametrize("kind", ["octahedron", "icosahedron"])
def test_sphere_is_closed_oriented_and_round(kind):
    tri = ec.sphere(kind, 3)
    ec.check_triangulation(tri)
    assert tri.is_watertight
    assert tri.euler_number == 2
    assert tri.volume == pytest.approx(4 / 3 * np.pi, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(tri.vertices, axis=1), 1, rtol=0, atol=1e-15)


def test_octahedral_edges_stay_on_the_coordinate_planes():
    signs = np.sign(ec.sphere("octahedron", 4).triangles)
    assert not ((signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)).any()


@pytest.mark.parametrize("n", range(6))
def test_bisected_sphere_is_closed_with_the_stated_number_of_vertices(n):
    tri = bisected_sphere(n)
    assert (len(tri.vertices), len(tri.faces)) == (4 * 2**n + 2, 8 * 2**n)
    ec.check_triangulation(tri)
    np.testing.assert_allclose(np.linalg.norm(tri.vertices, axis=1), 1, rtol=1e-15)


def test_bisected_sphere_is_symmetric_under_reflections_and_of_one_size():
    tri = bisected_sphere(8)
    known = {tuple(v) for v in (tri.vertices * 1e9).round().astype(int)}
    for i in range(3):
        mirrored = tri.vertices * np.where(np.arange(3) == i, -1, 1)
        assert {tuple(v) for v in (mirrored * 1e9).round().astype(int)} == known
    assert tri.area_faces.max() < 4 * tri.area_faces.min()


def test_bisected_sphere_vertices_have_four_or_eight_neighbours_in_the_interior():
    # On a quadrisected octahedron all but six vertices have six.
    degrees = np.bincount(bisected_sphere(8).faces.ravel())
    assert np.mean(np.isin(degrees, (4, 8))) > 0.85
    assert np.mean(degrees == 6) < 0.15


def test_torus_is_closed_oriented_and_on_the_torus():
    tri = ec.torus(1.5, 0.5, 40, 16)
    ec.check_triangulation(tri)
    assert tri.euler_number == 0
    assert tri.volume == pytest.approx(2 * np.pi**2 * 1.5 * 0.25, rel=0.05)
    x, y, z = tri.vertices.T
    np.testing.assert_allclose((np.hypot(x, y) - 1.5) ** 2 + z**2, 0.25, atol=1e-14)


def test_displaced_vertices_stay_on_the_surface_and_near():
    tri = ec.sphere("icosahedron", 2)
    moved = displaced(tri, 0.3, ec.to_unit_sphere, seed=4)
    ec.check_triangulation(moved)
    np.testing.assert_allclose(np.linalg.norm(moved.vertices, axis=1), 1, atol=1e-14)
    assert np.abs(moved.vertices - tri.vertices).max() > 0.1 * tri.edges_unique_length.min()
    again = displaced(tri, 0.3, ec.to_unit_sphere, seed=4)
    assert np.array_equal(moved.vertices, again.vertices)
    same = displaced(tri, 0.0, ec.to_unit_sphere)
    np.testing.assert_allclose(same.vertices, tri.vertices, atol=1e-15)


def test_displacements_go_both_ways_and_as_far_as_their_share():
    tri = ec.sphere("octahedron", 2)
    moved = displaced(tri, 0.2, lambda x: x)
    shift = (moved.vertices - tri.vertices) / (0.2 * tri.edges_unique_length.min())
    assert -1 <= shift.min() < -0.95
    assert 0.95 < shift.max() <= 1
    assert abs(shift.mean()) < 0.1


def test_a_displaced_mesh_shares_nothing_with_the_one_it_was_made_of():
    tri = ec.sphere("octahedron", 1)
    moved = displaced(tri, 0.2, ec.to_unit_sphere)
    moved.faces[:] = moved.faces[:, ::-1].copy()
    assert tri.volume > 0
    np.testing.assert_array_equal(tri.faces, ec.sphere("octahedron", 1).faces)


def test_points_are_projected_to_the_unit_sphere_whatever_their_axes():
    x = np.random.default_rng(0).standard_normal((4, 5, 3))
    y = ec.to_unit_sphere(x)
    np.testing.assert_allclose(np.linalg.norm(y, axis=-1), 1, rtol=1e-15)
    np.testing.assert_allclose(np.cross(x, y), 0, atol=1e-15)
    assert np.array_equal(y[2, 3], ec.to_unit_sphere(x[2, 3]))
    assert ec.to_unit_sphere(np.empty((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("point", [[0, 0, 0], [1, np.nan, 0], [0, np.inf, 0]])
@pytest.mark.parametrize("axes", [(), (2,), (2, 2)])
def test_a_point_without_a_closest_one_on_the_unit_sphere_is_shown(point, axes):
    points = np.ones((*axes, 3))
    points[(-1,) * len(axes)] = point
    with pytest.raises(ValueError, match="points must have a positive and finite distance") as e:
        ec.to_unit_sphere(points)
    assert str(e.value).endswith(f"one is {np.array(point, float).tolist()}")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ec.sphere("cube"), 'kind must be "octahedron" or "icosahedron", got \'cube\''),
        (
            lambda: ec.sphere("octahedron", -1),
            "refinements must be an integer from 0 to 12, got -1",
        ),
        (
            lambda: ec.sphere("octahedron", 1.5),
            "refinements must be an integer from 0 to 12, got 1.5",
        ),
        (lambda: bisected_sphere(-1), "bisections must be an integer from 0 to 24, got -1"),
        (lambda: bisected_sphere(1.5), "bisections must be an integer from 0 to 24, got 1.5"),
        (lambda: ec.torus(1.0, 1.0), "R must be larger than r, got R = 1 and r = 1"),
        (lambda: ec.torus(1.7e308, 1e308), r"R \+ r must be up to 1e\+75, got R = 1\.7e\+308 and"),
        (lambda: ec.torus(1.0, 0.0), "r must be a finite number > 0, got 0"),
        (lambda: ec.torus(np.inf, 1.0), "R must be a finite number > 0, got inf"),
        (lambda: ec.torus(n=2), "n must be an integer from 3 to 10000, got 2"),
        (lambda: ec.torus(m=8.5), "m must be an integer from 3 to 10000, got 8.5"),
        (lambda: moved(share=0.5), "share must be a finite number >= 0 and <= 0.3, got 0.5"),
        (lambda: moved(seed=-1), "seed must be an integer >= 0, got -1"),
        (
            lambda: moved(project=lambda x: x[:, :2]),
            r"project\(x\) must have shape \(6, 3\), got \(6, 2\)",
        ),
        (
            lambda: ec.to_unit_sphere([1.0, 2.0]),
            r"points must have shape \(\.\.\., 3\), got \(2,\)",
        ),
    ],
)
def test_what_is_no_shape_is_refused_by_the_argument_s_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def moved(tri=None, share=0.1, project=ec.to_unit_sphere, seed=0):
    return displaced(ec.sphere("octahedron", 0) if tri is None else tri, share, project, seed)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ec.sphere("octahedron", "3"),
            "refinements must be an integer from 0 to 12, got '3'",
        ),
        (lambda: ec.torus(n=None), "n must be an integer from 3 to 10000, got None"),
        (lambda: moved(tri=(1, 2)), r"tri must be a trimesh.Trimesh, got \(1, 2\)"),
        (lambda: ec.to_unit_sphere([[1j, 0, 0]]), "points must hold real numbers, got complex128"),
    ],
)
def test_arguments_of_another_type_are_refused_by_name(make, message):
    with pytest.raises(TypeError, match=message):
        make()


def test_numbers_of_any_library_make_the_same_mesh():
    for first, second in [
        (ec.sphere("octahedron", 2), ec.sphere("octahedron", np.float32(2))),
        (ec.torus(2, 1, 8, 6), ec.torus(np.float32(2), 1.0, np.int8(8), 6.0)),
        (bisected_sphere(3), bisected_sphere(np.array(3))),
    ]:
        assert np.array_equal(first.vertices, second.vertices)
        assert np.array_equal(first.faces, second.faces)


def test_the_diagonals_of_a_torus_do_not_depend_on_the_version_of_trimesh():
    faces = ec.torus(1.0, 0.4, 4, 3).faces
    assert faces[:6].tolist() == [[0, 3, 1], [1, 3, 4], [1, 4, 2], [2, 4, 5], [2, 5, 0], [0, 5, 3]]
    # Every quadrilateral is cut alike: each vertex has six neighbours, three on either side.
    assert (np.bincount(faces.ravel()) == 6).all()
    shifted = (faces.reshape(4, 6, 3)[0] + 3 * np.arange(4)[:, None, None]) % 12
    np.testing.assert_array_equal(shifted, faces.reshape(4, 6, 3))


def test_a_mesh_without_triangles_has_none_to_displace():
    with pytest.raises(ValueError, match="tri must have triangles, got none"):
        displaced(trimesh.Trimesh(), 0.1, ec.to_unit_sphere)
