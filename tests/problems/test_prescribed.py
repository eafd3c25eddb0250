"""The problems of [LMV] Section 6: their sources derived again, their motions, short runs."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy

import esfem_core as ec
from esfem_core.errors import time_norms

SOLUTIONS = ["decay", "oscillation"]
LINEAR = ec.SurfaceSpace(ec.sphere("octahedron", 3))
QUADRATIC = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
TIMES = (0.0, 0.7, 2.0, 3.9)


def points(n, seed=0):
    return ec.to_unit_sphere(np.random.default_rng(seed).standard_normal((n, 3)))


def source(problem, x, t):
    """F of (2.1) at points of one's own: it depends on position and time only."""
    return problem.species["u"].source(SimpleNamespace(points=x, t=t))


def angles(p):
    return np.arccos(p[:, 2]), np.arctan2(p[:, 1], p[:, 0])


@pytest.fixture(scope="module", params=SOLUTIONS)
def derived(request):
    """The terms of (2.1) from a parametrisation and its metric tensor, as functions of (θ, φ, t).

    The parametrisation moves with the material, so u' is a derivative in t and div v that of the
    logarithm of the area density. Neither normals nor mean curvature enter.
    """
    theta, phi, t = sympy.symbols("theta phi t", real=True)
    a = 1 + sympy.sin(t) / 4
    X = sympy.Matrix(
        [
            sympy.sqrt(a) * sympy.sin(theta) * sympy.cos(phi),
            sympy.sin(theta) * sympy.sin(phi),
            sympy.cos(theta),
        ]
    )
    factor = {"decay": sympy.exp(-6 * t), "oscillation": sympy.cos(sympy.pi * t)}[request.param]
    u = factor * X[0] * X[1]
    J = X.jacobian([theta, phi])
    metric = J.T * J
    density = sympy.sqrt(metric.det())
    flux = density * metric.inv() * sympy.Matrix([sympy.diff(u, s) for s in (theta, phi)])
    laplacian = sum(sympy.diff(flux[i], s) for i, s in enumerate((theta, phi))) / density
    divergence = sympy.diff(sympy.log(density), t)
    material = sympy.diff(u, t)
    terms = {"material": material, "divergence": divergence, "laplacian": laplacian, "u": u}
    terms["f"] = material + u * divergence - laplacian
    return request.param, {
        name: sympy.lambdify((theta, phi, t), term, cse=True) for name, term in terms.items()
    }


@pytest.mark.parametrize("evaluation", ["direct", "lifted"])
def test_source_of_the_ellipsoid_symbolically(derived, evaluation):
    solution, terms = derived
    problem = ec.problems.oscillating_ellipsoid(solution, evaluation)
    p = points(20)
    for t in TIMES:
        x = problem.exact.x(p, t)
        expected = terms["f"](*angles(p), t)
        np.testing.assert_allclose(problem.exact.u(x, t), terms["u"](*angles(p), t), atol=1e-14)
        np.testing.assert_allclose(
            source(problem, x, t), expected, rtol=1e-10, atol=1e-10 * abs(expected).max()
        )


def test_source_of_the_ellipsoid_with_differences_in_time(derived):
    """Material derivative and velocity by central differences along the material points."""
    solution, terms = derived
    problem = ec.problems.oscillating_ellipsoid(solution)
    exact, p, eps = problem.exact, points(20, seed=1), 1e-5
    for t in (0.3, 0.7, 2.0):
        material, v = (
            (after - before) / (2 * eps)
            for before, after in (
                [exact.u(exact.x(p, s), s) for s in (t - eps, t + eps)],
                [exact.x(p, s) for s in (t - eps, t + eps)],
            )
        )
        np.testing.assert_allclose(exact.v(p, t), v, atol=1e-10)
        divergence, laplacian = (terms[name](*angles(p), t) for name in ("divergence", "laplacian"))
        x = exact.x(p, t)
        f = material + exact.u(x, t) * divergence - laplacian
        np.testing.assert_allclose(source(problem, x, t), f, atol=1e-8)


@pytest.mark.parametrize("solution", SOLUTIONS)
def test_ellipsoid_at_the_start_and_its_level_set(solution):
    problem = ec.problems.oscillating_ellipsoid(solution)
    p = points(20)
    assert problem.law.motion is problem.exact.x
    np.testing.assert_array_equal(problem.exact.x(p, 0.0), p)
    np.testing.assert_array_equal(problem.initial_values(p)["u"], p[:, 0] * p[:, 1])
    for t in TIMES:
        x = problem.exact.x(p, t)
        level = x[:, 0] ** 2 / (1 + np.sin(t) / 4) + x[:, 1] ** 2 + x[:, 2] ** 2
        np.testing.assert_allclose(level, 1, atol=1e-15)


@pytest.mark.parametrize("t", [0.0, np.pi / 2, 3 * np.pi / 2])
def test_lifted_source_is_constant_along_normals(t):
    """On round, longest and shortest ellipsoid; poles and equator included."""
    direct = ec.problems.oscillating_ellipsoid("oscillation")
    lifted = ec.problems.oscillating_ellipsoid("oscillation", evaluation="lifted")
    x = direct.exact.x(np.vstack([np.eye(3), -np.eye(3), points(20)]), t)
    normal = x / [1 + np.sin(t) / 4, 1, 1]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    on_surface = source(direct, x, t)
    np.testing.assert_allclose(source(lifted, x, t), on_surface, atol=1e-13)
    for distance in (-0.5, -0.05, 1e-6, 0.05, 0.5):
        away = (x + distance * normal).reshape(13, 2, 3)
        np.testing.assert_allclose(
            source(lifted, away, t).ravel(), on_surface, rtol=1e-12, atol=1e-13
        )
    assert abs(source(direct, x + 0.05 * normal, t) - on_surface).max() > 1e-3


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 4)])
def test_direct_and_lifted_source_differ_by_the_geometry_error(degree, order):
    direct, lifted = (
        ec.problems.oscillating_ellipsoid("oscillation", e) for e in ("direct", "lifted")
    )
    t, sizes, differences = 0.9, [], []
    for refinements in (3, 4, 5):
        space = ec.SurfaceSpace(ec.sphere("octahedron", refinements), degree, ec.to_unit_sphere)
        x = direct.law.motion(space.nodes, t)
        q = space.quadrature_points(x)
        difference = source(direct, q, t) - source(lifted, q, t)
        differences.append(np.sqrt(space.load(x, difference**2).sum()))
        sizes.append(space.mesh_size(x))
    np.testing.assert_allclose(ec.study.observed_orders(sizes, differences), order, atol=0.1)


def test_lifting_refuses_what_has_no_closest_point():
    problem = ec.problems.oscillating_ellipsoid(evaluation="lifted")
    for x in ([0.0, 0.0, 0.0], [0.1, 0.0, 0.0]):
        with pytest.raises(ValueError, match=r"0\.0\] is too far from the ellipsoid"):
            source(problem, np.array([[[1.0, 0, 0], x]]), 1.0)


@pytest.mark.parametrize("evaluation", ["direct", "lifted"])
@pytest.mark.parametrize("p", [1, 2, 3])
def test_orders_in_time_on_the_ellipsoid(p, evaluation):
    problem = ec.problems.oscillating_ellipsoid("decay", evaluation)
    table = ec.study.time_study(QUADRATIC, problem, p, [1 / 20, 1 / 40], 1.0)
    for name in ("u_l2", "u_h1"):
        assert table.orders(name)[-1] == pytest.approx(p, abs=0.3)


@pytest.mark.parametrize("evaluation", ["direct", "lifted"])
def test_order_in_space_on_the_ellipsoid(evaluation):
    problem = ec.problems.oscillating_ellipsoid("oscillation", evaluation)
    spaces = [ec.SurfaceSpace(ec.sphere("octahedron", r)) for r in (2, 3, 4)]
    table = ec.study.space_study(spaces, problem, 4, 1 / 40, 1.0)
    assert table.orders("u_l2")[-1] == pytest.approx(2, abs=0.15)


def test_bat_is_the_printed_map_away_from_the_poles():
    """(6.2) as printed."""
    motion, p = ec.problems.baseball_bat().law.motion, points(200)
    x1, x2, x3 = p.T
    root = np.sqrt(x2**2 + x3**2)
    assert root.min() > 0.05
    for t in (0.0, 0.15, 0.5, 1.0):
        g = np.exp(-2 * t) * root + (1 - np.exp(-2 * t)) * (
            (1 - x1**2) * (x1**2 + 0.05) + x1**2 * np.sqrt(1 - x1**2)
        )
        printed = np.column_stack([x1 + np.maximum(0, x1) * t, g * x2 / root, g * x3 / root])
        np.testing.assert_allclose(motion(p, t), printed, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(motion(p, 0.0), p)


@pytest.mark.parametrize("t", [0.0, 0.5, 1.0])
def test_bat_at_the_poles(t):
    """The poles are nodes and stay on the axis, and the map is continuous there."""
    motion, x = ec.problems.baseball_bat().law.motion, LINEAR.nodes
    poles = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert all((x == pole).all(axis=1).any() for pole in poles)
    np.testing.assert_array_equal(motion(poles, t), [[1 + t, 0, 0], [-1, 0, 0]])
    for eps in (1e-4, 1e-8, 1e-12, 1e-200):
        near = ec.to_unit_sphere(poles + np.array([0, 0.6, 0.8]) * eps)
        np.testing.assert_allclose(motion(near, t), motion(poles, t), atol=2 * eps)
        # There c = 1 + O(eps), as no subtraction under a root could show.
        np.testing.assert_allclose(motion(near, t)[:, 1] / (0.6 * eps), 1, atol=2 * eps + 1e-15)


def test_bat_has_a_velocity_that_is_only_lipschitz():
    """Continuous across x1 = 0, where the derivative of its first component jumps by 1."""
    motion, eps, t = ec.problems.baseball_bat().law.motion, 1e-4, 0.5

    def velocity(x1):
        s = np.sqrt(1 - x1**2)
        p = np.array([[x1, 0.6 * s, 0.8 * s]])
        return ((motion(p, t + eps) - motion(p, t - eps)) / (2 * eps))[0]

    np.testing.assert_allclose(velocity(1e-12), velocity(-1e-12), atol=1e-11)
    right, left = ((velocity(side * 1e-3) - velocity(0.0)) / (side * 1e-3) for side in (1.0, -1.0))
    np.testing.assert_allclose(right - left, [1, 0, 0], atol=1e-2)


def test_bat_has_a_jump_in_its_curvature():
    """Its profile, radius over x1, has slope 0 at x1 = 0, but two second derivatives."""
    motion, eps, t = ec.problems.baseball_bat().law.motion, 1e-3, 1.0
    p1 = np.array([-eps, 0.0, eps])
    x = motion(np.column_stack([p1, np.sqrt(1 - p1**2), 0 * p1]), t)
    left, right = (2 * (x[i, 1] - x[1, 1]) / x[i, 0] ** 2 for i in (0, 2))
    assert right / left == pytest.approx(1 / (1 + t) ** 2)
    assert left == pytest.approx(3.24, abs=0.01)


def test_initial_values_of_the_bat():
    p, bat = points(10), ec.problems.baseball_bat()
    np.testing.assert_array_equal(bat.initial_values(p)["u"], p[:, 0] * p[:, 1])
    np.testing.assert_array_equal(ec.problems.baseball_bat(lambda x: x).initial_values(p)["u"], p)
    with pytest.raises(
        ValueError, match=r"u0 of 'u' must give .* one row for each of 10 nodes, .*; got \(3,\)"
    ):
        ec.problems.baseball_bat(np.arange(3)).initial_values(p)
    with pytest.raises(ValueError, match="problem must have an exact solution"):
        time_norms(LINEAR, bat, ec.evolve(LINEAR, bat, 1, 0.5, 0.5), (0.0, 1.0))


@pytest.mark.parametrize("p", [2, 4])
@pytest.mark.parametrize("solver", ["lagged", "direct"])
@pytest.mark.parametrize("u0", [None, lambda x: 1 + x[:, 0] * x[:, 1]])
def test_mass_on_the_bat_is_conserved(p, solver, u0):
    """1' M(t_n) u_n relative to 1' M(t_n) |u_n|, for f = 0."""
    masses = []
    for state in ec.evolve(LINEAR, ec.problems.baseball_bat(u0), p, 0.05, 1.0, solver=solver):
        M, _ = LINEAR.mass_stiffness(state.x)
        masses.append(((M @ state.u).sum(), (M @ abs(state.u)).sum()))
    total, size = np.transpose(masses)
    assert (abs(total - total[0]) < 1e-12 * size).all()


def test_time_norms():
    """Against the definition, with all states kept."""
    problem, tau = ec.problems.oscillating_ellipsoid("oscillation"), 0.1
    states = list(ec.evolve(LINEAR, problem, 3, tau, 1.0))
    l2, h1 = [], []
    for state in states[4:9]:
        M, A = LINEAR.mass_stiffness(state.x)
        e = state.u - problem.exact.u(state.x, state.t)
        l2.append(e @ (M @ e))
        h1.append(e @ (A @ e))
    expected = (np.sqrt(max(l2)), np.sqrt(tau * sum(h1)))
    assert time_norms(LINEAR, problem, iter(states), (0.4, 0.8)) == pytest.approx(expected)
    # 0.1 * 3 > 0.3, yet both ends count; the starting states, 0 to 0.2, do not.
    whole = time_norms(LINEAR, problem, iter(states), (0.3, 1.0))
    assert whole == time_norms(LINEAR, problem, iter(states), (0.0, 1.0))
    assert whole[1] > expected[1]
    with pytest.raises(ValueError, match=r"window must hold a step .* lies in \(0\.0, 0\.2\)"):
        time_norms(LINEAR, problem, iter(states), (0.0, 0.2))


def test_refusals():
    with pytest.raises(
        ValueError, match='solution must be "decay" or "oscillation", got \'growth\''
    ):
        ec.problems.oscillating_ellipsoid("growth")
    with pytest.raises(ValueError, match='evaluation must be "direct" or "lifted", got \'nodal\''):
        ec.problems.oscillating_ellipsoid(evaluation="nodal")
