"""NGSolve, given the same mesh, degree and quadrature, computes the same matrices, loads and runs.

It shares no code with the package: symbolic forms in C++, a hierarchical basis, its own rules.
"""

import os
from itertools import islice

import numpy as np
import pytest

import esfem_core as ec

if not os.environ.get("CI"):  # there it must be
    pytest.importorskip("ngsolve", reason="NGSolve comes with benchmarks/requirements.txt")
import ngsolve as ng
import ngsolve_peer

DEGREES = [1, 2, 3]


def sphere(kind, refinements, degree):
    """With quadrature that NGSolve has, too: its rule of exactness 2 has other points."""
    tri = ec.sphere(kind, refinements)
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere, exactness=max(4, 2 * degree))


def moved(degree):
    """An ellipsoid with a wave on it, whose nodes are on no symmetric place."""
    space = sphere("icosahedron", 1, degree)
    x = space.nodes * [1, 1.2, 0.8] + 0.1 * np.sin(2 * space.nodes[:, [1, 2, 0]])
    peer = ngsolve_peer.Peer(space)
    peer.move(x)
    return space, x, peer


def difference(found, theirs):
    return abs(found - theirs).max() / abs(theirs).max()


def in_our_basis(peer, form):
    form.Assemble()
    return peer.dual(peer.dual(peer.scipy(form).toarray()).T)


def load(peer, integrand):
    form = ng.LinearForm(integrand).Assemble()
    return peer.dual(form.vec.FV().NumPy())


@pytest.mark.parametrize("degree", DEGREES)
def test_mass_and_stiffness_matrix_are_the_same(degree):
    space, x, peer = moved(degree)
    for ours, form in zip(space.mass_stiffness(x), (peer.M, peer.A), strict=True):
        assert difference(ours.toarray(), in_our_basis(peer, form)) < 1e-13


@pytest.mark.parametrize("degree", DEGREES)
def test_on_flat_triangles_any_exact_quadrature_gives_the_same_matrices(degree):
    """Rules of NGSolve with other points: so ours are exact, too."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), degree)
    peer = ngsolve_peer.Peer(space, exactness=2 * degree + 5)
    for ours, form in zip(space.mass_stiffness(space.nodes), (peer.M, peer.A), strict=True):
        assert difference(ours.toarray(), in_our_basis(peer, form)) < 1e-13


@pytest.mark.parametrize("degree", DEGREES)
def test_loads_of_values_normals_gradients_and_fluxes_are_the_same(degree):
    space, x, peer = moved(degree)
    nodal = np.exp(x[:, 0]) + x[:, 1] * x[:, 2]
    at = ec.Surface(space, x, nodal)
    u = ng.GridFunction(peer.fes)
    u.vec.FV().NumPy()[:] = peer.coefficients(nodal)
    w = peer.fes.TestFunction()
    normal, gradient = ng.specialcf.normal(3), ng.grad(u).Trace()

    point = (at.points**2).sum(axis=-1)
    theirs = load(peer, (u**3 + ng.x**2 + ng.y**2 + ng.z**2) * w.Trace() * peer.ds)
    assert difference(at.load(at.u**3 + point), theirs) < 1e-13
    for i in range(3):
        theirs = load(peer, u * normal[i] * w.Trace() * peer.ds)
        assert difference(at.load(at.u[..., None] * at.normal)[:, i], theirs) < 1e-13
    theirs = load(peer, gradient * gradient * w.Trace() * peer.ds)
    assert difference(at.load((at.grad_u**2).sum(axis=-1)), theirs) < 1e-13
    flux = ng.CF((ng.y, u * ng.z, ng.x * ng.x))
    theirs = load(peer, flux * ng.grad(w).Trace() * peer.ds)
    X, Y, Z = np.moveaxis(at.points, -1, 0)
    ours = at.load(None, flux=np.stack([Y, at.u * Z, X**2], axis=-1))
    assert difference(ours, theirs) < 1e-13


@pytest.mark.parametrize(
    ("degree", "order", "solver"), [(1, 2, "direct"), (2, 3, "lagged"), (3, 1, "direct")]
)
def test_a_coupled_run_by_the_same_scheme_is_the_same(degree, order, solver):
    """[N] (2.19)-(2.21) on the expanding sphere, from the same starting values."""
    space = sphere("octahedron", 2, degree)
    step, n_steps = 1 / 20, order + 4
    theirs = ngsolve_peer.evolve(space, order, step, n_steps)
    ours = ec.evolve(
        space,
        ec.problems.expanding_sphere(),
        order,
        step,
        n_steps * step,
        mass="extrapolated",
        solver=solver,
    )
    pairs = list(zip(islice(ours, order, None), theirs, strict=True))
    assert len(pairs) == n_steps + 1 - order
    for state, (t, x, u) in pairs:
        assert state.t == pytest.approx(t)
        np.testing.assert_allclose(state.x, x, rtol=0, atol=1e-9 * abs(x).max())
        np.testing.assert_allclose(state.u, u, rtol=0, atol=1e-9 * abs(u).max())
