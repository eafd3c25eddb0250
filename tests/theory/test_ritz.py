"""Prolongation and Ritz projection: exact facts, the rates of the theory, refusals."""

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.errors import seminorm
from esfem_core.theory.ritz import prolongation, ritz_projection

TRI = ec.sphere("octahedron", 2)


@pytest.mark.parametrize(("degree", "higher"), [(1, 2), (1, 4), (2, 2), (2, 3), (2, 5)])
def test_prolonged_functions_are_the_same(degree, higher):
    space = ec.SurfaceSpace(TRI, degree, exactness=10)
    fine = ec.SurfaceSpace(TRI, higher, exactness=10)
    up = prolongation(space, fine)
    u = np.random.default_rng(0).standard_normal(len(space.nodes))
    np.testing.assert_allclose(fine.evaluate(up @ u), space.evaluate(u), atol=1e-13)
    np.testing.assert_allclose(up.sum(axis=1), 1, atol=1e-14)


def test_the_projection_of_a_discrete_function_on_the_same_surface_is_itself():
    space, fine = ec.SurfaceSpace(TRI), ec.SurfaceSpace(TRI, 3)
    u = np.random.default_rng(1).standard_normal(len(space.nodes))
    values = prolongation(space, fine) @ u
    projected = ritz_projection(space, space.nodes, fine, fine.nodes, values)
    np.testing.assert_allclose(projected, u, atol=1e-12)


def test_it_is_orthogonal_and_keeps_the_integral():
    space, fine = ec.SurfaceSpace(TRI), ec.SurfaceSpace(TRI, 4, ec.to_unit_sphere)
    z = np.exp(fine.nodes[:, 0]) * fine.nodes[:, 1] + 1
    P = ritz_projection(space, space.nodes, fine, fine.nodes, z)
    M, A = space.mass_stiffness(space.nodes)
    M_exact, A_exact = fine.mass_stiffness(fine.nodes)
    load = prolongation(space, fine).T @ (A_exact @ z)
    np.testing.assert_allclose(A @ P, load, atol=1e-12)
    assert (M @ P).sum() == pytest.approx((M_exact @ z).sum(), rel=1e-13)


def test_errors_of_a_harmonic_on_the_sphere_are_of_second_and_first_order():
    """Between P and the function itself, on a mesh without supercloseness."""
    errors = []
    for refinements in (2, 3, 4):
        tri = ec.sphere("octahedron", refinements)
        shift = np.random.default_rng(2).uniform(-0.2, 0.2, tri.vertices.shape)
        tri.vertices = ec.to_unit_sphere(tri.vertices + shift / 2**refinements)
        space, fine = ec.SurfaceSpace(tri), ec.SurfaceSpace(tri, 4, ec.to_unit_sphere)
        z = fine.nodes[:, 0] * fine.nodes[:, 1]
        P = ritz_projection(space, space.nodes, fine, fine.nodes, z)
        error = prolongation(space, fine) @ P - z
        errors.append([seminorm(matrix, error) for matrix in fine.mass_stiffness(fine.nodes)])
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates[-1] == pytest.approx([2, 1], abs=0.2)


def test_spaces_that_do_not_belong_together_are_refused():
    linear, quadratic = ec.SurfaceSpace(TRI), ec.SurfaceSpace(TRI, 2)
    with pytest.raises(ValueError, match="fine must have degree 2 or more, but has 1"):
        prolongation(quadratic, linear)
    with pytest.raises(ValueError, match="fine must be on the triangulation of space"):
        prolongation(linear, ec.SurfaceSpace(ec.sphere("octahedron", 1), 2))
    renumbered = trimesh.Trimesh(TRI.vertices, np.roll(TRI.faces, 1, axis=0), process=False)
    with pytest.raises(ValueError, match="fine must be on the triangulation of space"):
        prolongation(linear, ec.SurfaceSpace(renumbered, 2))


def test_a_surface_of_two_components_has_no_projection():
    far = TRI.copy()
    far.apply_translation([3, 0, 0])
    space = ec.SurfaceSpace(trimesh.util.concatenate([TRI, far]))
    with pytest.raises(ValueError, match="space must be on a connected surface, but has 2 comp"):
        ritz_projection(space, space.nodes, space, space.nodes, space.nodes[:, 0])


def test_arrays_of_another_shape_are_refused_by_their_names():
    linear, quadratic = ec.SurfaceSpace(TRI), ec.SurfaceSpace(TRI, 2)
    x, y, z = linear.nodes, quadratic.nodes, quadratic.nodes[:, 0]
    with pytest.raises(ValueError, match=r"x must have shape \(66, 3\), got \(258, 3\)"):
        ritz_projection(linear, y, quadratic, y, z)
    with pytest.raises(ValueError, match=r"y must have shape \(258, 3\), got \(66, 3\)"):
        ritz_projection(linear, x, quadratic, x, z)
    with pytest.raises(ValueError, match=r"z must have shape \(258,\), got \(66,\)"):
        ritz_projection(linear, x, quadratic, y, np.zeros(66))
    with pytest.raises(ValueError, match=r"z must be finite, but z\[0\] is nan"):
        ritz_projection(linear, x, quadratic, y, np.nan * z)
