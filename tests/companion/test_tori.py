"""Tori of the chapters: regular, or displaced along the surface."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.tori import torus


def test_without_displacement_it_is_the_grid_of_angles():
    tri, grid = torus(3), ec.torus(1.0, 0.4, 15, 6)
    assert np.array_equal(tri.vertices, grid.vertices)
    assert np.array_equal(tri.faces, grid.faces)


def test_displaced_vertices_stay_on_the_torus_and_are_the_same_each_time():
    tri = torus(4, displaced=0.2)
    assert np.abs(ec.exact_surfaces.Torus(1.0, 0.4).near(tri.vertices).distance).max() < 1e-14
    assert np.array_equal(tri.vertices, torus(4, displaced=0.2).vertices)
    assert np.abs(tri.vertices - torus(4).vertices).max() > 0.02


def test_a_large_displacement_is_refused():
    with pytest.raises(ValueError, match="displaced must"):
        torus(4, displaced=0.5)
