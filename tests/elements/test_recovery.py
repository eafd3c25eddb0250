"""Nodal normals and mean curvatures, at vertices with five triangles above all."""

import contextlib

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.elements import (
    nodal_average,
    normal_and_curvature,
    smoothed,
    smoothed_divergence,
)
from esfem_core.solvers import superlu

EGG = ec.exact_surfaces.Ellipsoid((1.3, 1.0, 0.8))


def textbook(at):
    """M^{-1} A x along the normal."""
    return np.linalg.norm(superlu(at.M).solve(at.A @ at.x), axis=1)


def flat_eggs():
    for refinements in (2, 3, 4):
        tri = ec.sphere("icosahedron", refinements)
        tri = trimesh.Trimesh(EGG.closest(tri.vertices * EGG.axes), tri.faces, process=False)
        space = ec.SurfaceSpace(tri)
        yield ec.Surface(space, space.nodes), np.bincount(tri.faces.ravel()) == 5


def test_curvature_converges_where_five_triangles_meet_and_that_of_the_textbook_does_not():
    old, new, normals = [], [], []
    for at, five in flat_eggs():
        exact = EGG.mean_curvature(at.x)
        normal, H = normal_and_curvature(at)
        old.append(np.abs(textbook(at) / exact - 1)[five].min())
        new.append(np.abs(H / exact - 1)[five].max())
        normals.append(np.linalg.norm(normal - EGG.normal(at.x), axis=1).max())
    assert min(old) > 0.3
    assert new[-1] < 1e-3
    assert np.log2(new[0] / new[2]) / 2 > 2
    assert np.log2(normals[0] / normals[2]) / 2 > 2.5


def test_curvature_of_flat_triangles_converges_at_every_vertex():
    largest = []
    for at, _ in flat_eggs():
        largest.append(np.abs(normal_and_curvature(at)[1] - EGG.mean_curvature(at.x)).max())
    assert np.log2(largest[0] / largest[2]) / 2 > 2


def test_curved_elements_are_taken_as_they_are():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    at = ec.Surface(space, space.nodes)
    normal = smoothed(at, at.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = normal_and_curvature(at)
    assert np.array_equal(found[0], normal)
    assert np.array_equal(found[1], smoothed_divergence(at, normal))


@pytest.mark.parametrize("degree", [1, 2])
def test_a_component_does_not_depend_on_others(degree):
    """One length of smoothing for both would be that of the large one."""
    small, large = ec.torus(n=24, m=12).apply_scale(0.1), ec.sphere("icosahedron", 2).apply_scale(3)
    both = trimesh.util.concatenate([small, large.apply_translation([5, 0, 0])])
    beside = ec.SurfaceSpace(both, degree)
    together = normal_and_curvature(ec.Surface(beside, beside.nodes))
    near = np.linalg.norm(beside.nodes, axis=1) < 0.5
    for tri, here in ((small, near), (large, ~near)):
        alone = ec.SurfaceSpace(tri, degree)
        by_itself = normal_and_curvature(ec.Surface(alone, alone.nodes))
        for own, found in zip(by_itself, together, strict=True):
            # The order of nodes on edges is another.
            np.testing.assert_allclose(np.sort(found[here], 0), np.sort(own, 0), rtol=0, atol=1e-9)


def test_a_nodal_average_weighs_elements_by_their_areas():
    tri = ec.torus(n=12, m=6)
    space = ec.SurfaceSpace(tri)
    numbers = np.arange(len(tri.faces)) ** 2.0
    found = nodal_average(ec.Surface(space, space.nodes), np.tile(numbers[:, None], (1, 3)))
    corners, areas = tri.faces.ravel(), np.repeat(tri.area_faces, 3)
    expected = np.bincount(corners, np.repeat(numbers, 3) * areas) / np.bincount(corners, areas)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_flow_of_flat_triangles_starts_with_them():
    at, _ = next(flat_eggs())
    values = ec.laws.MeanCurvature().initial(at)
    normal, H = normal_and_curvature(at)
    assert np.array_equal(values["normal"], normal)
    assert np.array_equal(values["H"], H)
    given = ec.laws.MeanCurvature(normal=EGG.normal).initial(at)
    assert np.array_equal(given["normal"], EGG.normal(at.x))


@pytest.mark.parametrize("degree", [1, 2])
def test_surfaces_with_a_boundary_are_refused(degree):
    tri = ec.sphere("octahedron", 2)
    tri.update_faces(tri.triangles_center[:, 2] > 0)
    tri.remove_unreferenced_vertices()
    space = ec.SurfaceSpace(tri, degree, ec.to_unit_sphere, boundary=True)
    with pytest.raises(ValueError, match="at must be a closed surface, but has a boundary"):
        normal_and_curvature(ec.Surface(space, space.nodes))


def test_normals_must_be_nodal():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
    with pytest.raises(ValueError, match=r"normal must have shape \(42, 3\), got \(42,\)"):
        smoothed_divergence(ec.Surface(space, space.nodes), np.ones(42))


@pytest.mark.parametrize(
    ("function", "others"),
    [
        (nodal_average, [np.ones(42)]),
        (smoothed, [np.ones(42)]),
        (smoothed_divergence, [np.ones((42, 3))]),
        (normal_and_curvature, []),
    ],
)
def test_what_is_no_surface_is_refused_by_name(function, others):
    with pytest.raises(TypeError, match="at must be a Surface, got None"):
        function(None, *others)


def test_a_curvature_that_flat_triangles_do_not_give_may_be_given():
    tri = ec.sphere("icosahedron", 2)
    x, (a, b, c) = np.array(tri.vertices), tri.faces[0]
    x[a] = (x[b] + x[c]) / 2 + 1e-6 * (x[a] - (x[b] + x[c]) / 2)
    space = ec.SurfaceSpace(trimesh.Trimesh(x, tri.faces, process=False))
    unit = ec.exact_surfaces.Sphere()
    given = {"normal": unit.normal, "curvature": unit.mean_curvature}
    for law, message in (({}, r"triangles so flat .* normal= and curvature="), (given, None)):
        problem = ec.Problem(species={}, law=ec.laws.MeanCurvature(beta=0.01, **law))
        with pytest.raises(ValueError, match=message) if message else contextlib.nullcontext():
            next(ec.evolve(space, problem, 1, 0.05, 0.3))
