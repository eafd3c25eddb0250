"""Defects: perturbed runs that return the exact values, orders, and the splits of the proof."""

import numpy as np
import pytest
from scipy.linalg import solve

import esfem_core as ec
from esfem_core.problems import Exact
from esfem_core.study import observed_orders
from esfem_core.surfaces.exact_surfaces import Ellipsoid
from esfem_core.theory.defect_terms import (
    Field,
    spatial_terms_u,
    temporal_terms_u,
    temporal_terms_v,
)
from esfem_core.theory.defects import defects, dual_norm, interpolant, spatial_defects

EXPANDING = ec.problems.expanding_sphere()


def space_of(refinements=1, degree=2):
    return ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)


def triaxial():
    """Stretch the sphere along three axes; f and g are arbitrary, no equation is solved."""

    def scale(t, n):
        w = np.array([1.0, 1.3, 0.7])
        return (n == 0) + 0.3 * w**n * np.sin(w * t + n * np.pi / 2)

    def f(u, grad_u, x, t):
        return u**2 + grad_u[..., 0] * x[..., 1]

    def g(u, grad_u, x, t):
        return np.sin(u) + grad_u[..., 2] ** 2

    exact = Exact(
        lambda p, t: p * scale(t, 0),
        lambda p, t: p * scale(t, 1),
        lambda x, t: np.cos(t) * x[..., 0] + x[..., 1] * x[..., 2],
    )
    return ec.Problem(u0=lambda x: x[:, 0], f=f, g=g, alpha=0.5, beta=2.0, exact=exact)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
@pytest.mark.parametrize(
    "problem",
    [EXPANDING, triaxial(), ec.problems.oscillating_ellipsoid("oscillation")],
    ids=["sphere", "triaxial", "prescribed"],
)
def test_a_run_perturbed_by_the_defects_returns_the_exact_values(problem, order):
    space, step = space_of(0), 1 / 40

    def perturbation(n):
        return defects(space, problem, order, step, n)

    run = ec.evolve(space, problem, order, step, 0.5, solver="direct", perturbation=perturbation)
    for state in run:
        e = ec.errors.compare(space, problem, state)
        assert max(e.x_l2, e.x_h1, e.u_l2, e.u_h1) < 1e-11
        if state.v is not None and problem.motion is None:  # else v is the quotient of positions
            assert max(e.v_l2, e.v_h1) < 1e-11


def test_starting_values_are_not_perturbed():
    space, seen = space_of(0), []

    def perturbation(n):
        seen.append(n)
        return np.zeros(len(space.nodes)), np.zeros((1, 3)), np.zeros((1, 3))

    list(ec.evolve(space, EXPANDING, 3, 0.1, 0.6, start="euler", perturbation=perturbation))
    assert seen == [3, 4, 5, 6]


def test_what_the_scheme_reproduces_has_no_defect():
    # u constant on a surface at rest, held there by g = beta H
    space = space_of(2)
    exact = Exact(lambda p, t: p, lambda p, t: 0 * p, lambda x, t: np.ones(x.shape[:-1]))
    problem = ec.Problem(u0=lambda x: np.ones(len(x)), beta=0.0, exact=exact)
    for values in defects(space, problem, 3, 0.1, 7):
        assert np.abs(values).max() < 1e-14


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_what_time_leaves_has_order_p(order):
    space, problem, t, steps = space_of(0), triaxial(), 1.0, [1 / 20, 1 / 40]
    limit = spatial_defects(space, problem, t)
    M, A = space.mass_stiffness(interpolant(space, problem, t).x)
    K = M + A
    sizes = []
    for step in steps:
        d = defects(space, problem, order, step, round(t / step))
        time_u, time_v = dual_norm(K, d.u - limit.u), dual_norm(K, d.v - limit.v)
        sizes.append([time_u, time_v, np.abs(d.x).max()])
    for column in np.transpose(sizes):
        assert observed_orders(steps, column)[0] > order - 0.25


@pytest.mark.parametrize("order", [1, 3, 5])
def test_the_terms_of_the_proof_add_up(order):
    space, problem, step = space_of(0), triaxial(), 1 / 20
    n = 2 * order + 3
    d, limit = defects(space, problem, order, step, n), spatial_defects(space, problem, n * step)
    terms = temporal_terms_u(space, problem, order, step, n)
    assert np.abs(sum(terms.values()) - (d.u - limit.u)).max() < 1e-11
    assert all(np.abs(r).max() > 1e-9 for r in terms.values())
    terms = temporal_terms_v(space, problem, order, step, n * step)
    assert np.abs(sum(terms.values()) - (d.v - limit.v)).max() < 1e-12


def test_the_spatial_defect_of_a_prescribed_motion_is_a_derivative():
    space, problem = space_of(1, 1), ec.problems.oscillating_ellipsoid("oscillation")
    t, eps = 0.3, 1e-4
    now = interpolant(space, problem, t)

    def mass_term(s):
        state = interpolant(space, problem, s)
        return space.mass_stiffness(state.x)[0] @ state.u

    A = space.mass_stiffness(now.x)[1]
    points = space.quadrature_points(now.x)
    f = problem.f(None, None, points, t)
    expected = (mass_term(t + eps) - mass_term(t - eps)) / (2 * eps) + A @ now.u
    expected -= space.load(now.x, f)
    assert np.abs(spatial_defects(space, problem, t).u - expected).max() < 1e-7


def test_dual_norm_is_a_supremum():
    space = space_of(0)
    M, A = space.mass_stiffness(space.nodes)
    K = M + 0.3 * A
    rng = np.random.default_rng(1)
    r = rng.normal(size=(len(space.nodes), 3))
    best = solve(K.toarray(), r)  # the supremum is attained there
    attained = np.sum(r * best) / np.sqrt(np.sum(best * (K @ best)))
    assert dual_norm(K, r) == pytest.approx(attained)
    w = rng.normal(size=r.shape)
    assert np.sum(r * w) / np.sqrt(np.sum(w * (K @ w))) < attained
    with pytest.raises(ValueError, match="functional must have 42 rows"):
        dual_norm(K, r[:5])


def test_bad_input():
    space = space_of(0)
    with pytest.raises(ValueError, match="n = p = 3, got n = 2"):
        defects(space, EXPANDING, 3, 0.1, 2)
    with pytest.raises(ValueError, match="n = 2 p = 6 on, got n = 5"):
        temporal_terms_u(space, EXPANDING, 3, 0.1, 5)
    with pytest.raises(ValueError, match="exact solution"):
        defects(space, ec.Problem(u0=lambda x: x[:, 0]), 1, 0.1, 1)


def test_the_spatial_terms_of_the_proof_add_up():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")

    def axis(t):
        return np.sqrt(1 + 0.25 * np.sin(t))

    field = Field(
        surface=lambda t: Ellipsoid((axis(t), 1.0, 1.0)),
        v=lambda x, t: x * [np.cos(t) / (8 * axis(t) ** 2), 0, 0],
        f=lambda x, t: problem.f(None, None, x, t),
    )
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere, exactness=10)
    *terms, spurious = spatial_terms_u(space, problem, field, 0.6).values()
    expected = spatial_defects(space, problem, 0.6).u
    assert np.abs(sum(terms) - expected).max() < 1e-7
    assert all(np.abs(r).max() > 2e-7 for r in [*terms, spurious])
