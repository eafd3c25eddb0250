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
    found = planes.values(space.nodes[:, 2], points)
    assert np.abs(found - points[:, 2]).max() < 0.03
