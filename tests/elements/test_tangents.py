"""Distances and normals by tangent planes."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.elements import TangentPlanes


@pytest.mark.parametrize("degree", [1, 2])
def test_distances_are_nearly_those_of_the_closest_points(degree):
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree, ec.to_unit_sphere)
    planes = TangentPlanes(ec.Surface(space, space.nodes), 0.05)
    points = 1.1 * ec.sphere("icosahedron", 3).vertices
    exact = np.linalg.norm(points - space.probe(space.nodes, space.nodes, points), axis=1)
    assert np.abs(planes.distance(points) - exact).max() < 0.005
    normal = planes.normal(points)
    assert np.einsum("ij,ij->i", normal, points / 1.1).min() > 0.998
    on_surface = planes.near(points)
    assert np.abs(planes.distance(on_surface)).max() < 1e-3


def test_finer_points_are_nearer():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    at = ec.Surface(space, space.nodes)
    errors = [
        np.abs(TangentPlanes(at, spacing).distance(at.points.reshape(-1, 3))).max()
        for spacing in (0.2, 0.1)
    ]
    assert errors[1] < 0.4 * errors[0]


def test_values_are_looked_up_where_points_are_near():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    planes = TangentPlanes(ec.Surface(space, space.nodes), 0.02)
    points = ec.sphere("octahedron", 2).vertices
    found = planes.values(space.nodes[:, 2])(points)
    assert np.abs(found - points[:, 2]).max() < 0.03


def test_points_and_values_of_other_shapes_are_refused():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    planes = TangentPlanes(ec.Surface(space, space.nodes), 0.05)
    for bad in (space.nodes, np.ones(len(space.nodes) + 1), np.ones((len(space.nodes), 1))):
        with pytest.raises(ValueError, match=r"nodal must have shape \(66,\), got"):
            planes.values(bad)
    for of in (planes.distance, planes.normal, planes.near, planes.values(space.nodes[:, 0])):
        with pytest.raises(ValueError, match=r"x must have shape \(n, 3\), got \(3,\)"):
            of(np.array([0.0, 0.0, 1.5]))
        with pytest.raises(ValueError, match=r"x must be finite, but x\[0, 0\] is nan"):
            of(np.array([[np.nan, 0.0, 1.5]]))
        np.testing.assert_array_equal(of([[0, 0, 1.5]]), of(np.array([[0.0, 0.0, 1.5]])))


def off_by(planes, x, points):
    """How far points are from the places whose values are theirs."""
    found = np.stack([planes.values(column)(points) for column in x.T], axis=1)
    return np.linalg.norm(found - points, axis=1)


def test_no_side_of_the_parts_of_long_triangles_is_longer_than_the_spacing():
    """So that their centres are at most two thirds of it away."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1).apply_scale([6.0, 1, 1]))
    x, b = space.nodes, np.random.default_rng(0).dirichlet([1, 1, 1], 200)
    points = (b @ x[space.cells]).reshape(-1, 3)
    assert off_by(TangentPlanes(ec.Surface(space, x), 0.3), x, points).max() < 2 / 3 * 0.3


def test_points_that_share_coordinates_with_those_before_have_their_own_planes():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    planes, fresh = (TangentPlanes(ec.Surface(space, space.nodes), 0.05) for _ in range(2))
    planes.distance(np.array([[0.0, 0.0, 1.1]]))
    below = np.array([[0.0, 0.0, -1.1]])
    np.testing.assert_array_equal(planes.distance(below), fresh.distance(below))


def test_spacings_and_normals_that_give_no_planes_are_refused():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 1)
    at = ec.Surface(space, space.nodes)
    for bad in (0.0, -1.0):
        spacing = np.full(32, 0.1)
        spacing[3] = bad
        with pytest.raises(ValueError, match=rf"spacing must be > 0, but spacing\[3\] is {bad}"):
            TangentPlanes(at, spacing)
    with pytest.raises(ValueError, match=r"spacing must be finite, but spacing\[0\] is nan"):
        TangentPlanes(at, np.full(32, np.nan))
    with pytest.raises(ValueError, match=r"spacing must have shape \(32,\), got \(3,\)"):
        TangentPlanes(at, np.ones(3))
    with pytest.raises(ValueError, match="spacing must be a finite number > 0, got 0"):
        TangentPlanes(at, 0)
    with pytest.raises(ValueError, match=r"normal must have shape \(18, 3\), got \(3,\)"):
        TangentPlanes(at, 0.1, np.ones(3))
    normal = space.nodes.copy()
    normal[5] = 0
    with pytest.raises(ValueError, match="normal must not be zero, but is at node 5"):
        TangentPlanes(at, 0.1, normal)
    with pytest.raises(TypeError, match="at must be a Surface"):
        TangentPlanes(space, 0.1)


def test_no_spacing_is_too_small_for_a_64th_of_a_side():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), 1)
    at = ec.Surface(space, space.nodes)
    points = 1.1 * ec.sphere("octahedron", 1).vertices
    least = TangentPlanes(at, np.sqrt(2) / 64).distance(points)
    np.testing.assert_array_equal(TangentPlanes(at, 1e-300).distance(points), least)
    np.testing.assert_array_equal(TangentPlanes(at, np.full(8, 1e-300)).distance(points), least)
    places = off_by(TangentPlanes(at, 1e-300), space.nodes, space.nodes)  # two thirds of heights
    np.testing.assert_allclose(places, np.sqrt(2 / 3) / 64, rtol=1e-12)
