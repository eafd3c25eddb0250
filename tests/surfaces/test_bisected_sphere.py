"""Bisected octahedra: counts, closedness, right angles instead of equilateral triangles."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.surfaces import bisected_sphere


@pytest.mark.parametrize("n", range(6))
def test_is_a_closed_sphere_with_the_stated_number_of_vertices(n):
    tri = bisected_sphere(n)
    assert (len(tri.vertices), len(tri.faces)) == (4 * 2**n + 2, 8 * 2**n)
    ec.check_triangulation(tri)
    np.testing.assert_allclose(np.linalg.norm(tri.vertices, axis=1), 1, rtol=1e-15)


def test_symmetric_under_reflections_and_of_one_size():
    tri = bisected_sphere(8)
    known = {tuple(v) for v in (tri.vertices * 1e9).round().astype(int)}
    for i in range(3):
        mirrored = tri.vertices * np.where(np.arange(3) == i, -1, 1)
        assert {tuple(v) for v in (mirrored * 1e9).round().astype(int)} == known
    assert tri.area_faces.max() < 4 * tri.area_faces.min()


def test_vertices_have_four_or_eight_neighbours_in_the_interior():
    # On a quadrisected octahedron all but six vertices have six.
    degrees = np.bincount(bisected_sphere(8).faces.ravel())
    assert np.mean(np.isin(degrees, (4, 8))) > 0.85
    assert np.mean(degrees == 6) < 0.15


@pytest.mark.parametrize("n", [-1, 1.5])
def test_refuses_other_numbers(n):
    with pytest.raises(ValueError, match="bisections must be an integer >= 0"):
        bisected_sphere(n)
