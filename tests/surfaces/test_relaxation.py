"""Triangles that are brought to a length and relaxed, on surfaces that are known by functions."""

import numpy as np
import pytest
import trimesh
from level_sets import BOXES, torus

import esfem_core as ec
from esfem_core.surfaces import Guide, central_gradient, descend, edges_of, evened, resized, split

GUIDE = Guide(torus, central_gradient(torus), lambda x: descend(torus, central_gradient(torus), x))


def torus_mesh(h=0.2):
    tri = ec.from_level_set(torus, BOXES[torus], h)
    return np.array(tri.vertices), np.array(tri.faces)


@pytest.mark.parametrize("h", [0.14, 0.28])
def test_edges_come_to_another_length_and_the_topology_stays(h):
    found = evened(*resized(*torus_mesh(), GUIDE, h), GUIDE, h)
    assert found.good
    assert found.quality.euler == 0
    assert 0.9 * h < found.quality.h_mean < 1.05 * h
    ec.check_triangulation(trimesh.Trimesh(found.vertices, found.faces, process=False))


def test_a_share_makes_edges_shorter_in_places():
    guide = GUIDE._replace(share=lambda x: np.where(x[:, 0] > 0, 1.0, 0.6))
    found = evened(*resized(*torus_mesh(), guide, 0.25), guide, 0.25)
    e = edges_of(found.faces)
    lengths, middle = e.lengths(found.vertices), found.vertices[e.ends].mean(axis=1)
    assert lengths[middle[:, 0] > 0.4].mean() / lengths[middle[:, 0] < -0.4].mean() > 1.4


def test_a_turn_that_is_not_allowed_is_refused():
    x, faces = torus_mesh(0.3)
    with pytest.raises(ValueError, match=r"turns by [\d.]+ degrees .*\(allowed: 6\.0\)"):
        evened(x, faces, GUIDE, 0.3, turn=float(np.cos(np.radians(6))))


def test_functions_of_a_guide_may_return_their_argument_or_keep_what_they_return():
    tri, sphere, kept = ec.sphere("octahedron", 2), ec.exact_surfaces.Sphere(2.0), []

    def project(x):
        kept.append((y := sphere.closest(x), y.copy()))
        return y

    guide = Guide(lambda x: ((x**2).sum(axis=1) - 4) / 2, lambda x: x, project)
    found = evened(*resized(2 * tri.vertices, tri.faces, guide, 0.5), guide, 0.5)
    np.testing.assert_allclose(np.linalg.norm(found.vertices, axis=1), 2, rtol=1e-12)
    for returned, before in kept:
        np.testing.assert_array_equal(returned, before)


def test_lengths_at_the_vertices_must_be_positive():
    tri = ec.sphere("octahedron", 1)
    with pytest.raises(ValueError, match="longest must be positive, got 0"):
        split(tri.vertices, tri.faces, np.zeros(len(tri.vertices)))
