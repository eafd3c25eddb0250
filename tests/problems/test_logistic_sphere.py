"""The logistic sphere: its equations derived again by sympy, and the orders of its errors."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy

import esfem_core as ec
from esfem_core.study import space_study, time_study

PARAMETERS = [{}, {"alpha": 0.3, "beta": 0.7, "delta": 2.0, "limit": 0.5, "rate": 1.5}]


@pytest.fixture(scope="module")
def derived():
    """The terms of both equations on a sphere of radius r(t), from a parametrisation.

    With the Laplace-Beltrami operator of its metric; functions of (theta, phi, t, r, r', alpha,
    beta).
    """
    theta, phi, t, alpha, beta, size, speed = symbols = sympy.symbols(
        "theta phi t alpha beta size speed", positive=True
    )
    r = sympy.Function("r", positive=True)(t)
    nu = sympy.Matrix(
        [sympy.sin(theta) * sympy.cos(phi), sympy.sin(theta) * sympy.sin(phi), sympy.cos(theta)]
    )
    x = r * nu
    J = x.jacobian([theta, phi])
    metric = (J.T * J).applyfunc(sympy.simplify)
    density = r**2 * sympy.sin(theta)
    assert sympy.simplify(metric.det() - density**2) == 0

    def laplacian(w):
        flux = density * metric.inv() * sympy.Matrix([sympy.diff(w, s) for s in (theta, phi)])
        return sum(sympy.diff(flux[i], s) for i, s in enumerate((theta, phi))) / density

    u = sympy.exp(-6 * t) * x[0] * x[1]
    v = sympy.diff(x, t)
    f = sympy.diff(u, t) + u * sympy.diff(sympy.log(density), t) - laplacian(u)
    law = v - alpha * v.applyfunc(laplacian) - beta * x.applyfunc(laplacian)
    tangential = law - law.dot(nu) * nu
    assert tangential.applyfunc(sympy.simplify) == sympy.zeros(3, 1)
    terms = {"u": u, "f": f, "g": sympy.simplify(law.dot(nu))}
    values = {sympy.diff(r, t): speed, r: size}
    return {
        name: sympy.lambdify(symbols, term.subs(values), cse=True) for name, term in terms.items()
    }


@pytest.mark.parametrize("parameters", PARAMETERS, ids=["as given", "others"])
def test_equations_hold_symbolically(derived, parameters):
    law = {"alpha": 1.0, "beta": 0.0, "limit": 2.0, "rate": 0.5} | parameters
    problem = ec.problems.logistic_sphere(**parameters)
    p = ec.to_unit_sphere(np.random.default_rng(0).standard_normal((20, 3)))
    angles = np.arccos(p[:, 2]), np.arctan2(p[:, 1], p[:, 0])
    for t in (0.0, 0.4, 1.7):
        decay = np.exp(-law["rate"] * t)
        r = law["limit"] / (law["limit"] * decay + (1 - decay))
        dr = law["rate"] * r * (1 - r / law["limit"])
        expected = {
            name: term(*angles, t, law["alpha"], law["beta"], r, dr)
            for name, term in derived.items()
        }
        x = problem.exact.x(p, t)
        u = problem.exact.u(x, t)
        at = SimpleNamespace(points=x, t=t, u=u)
        np.testing.assert_allclose(x, r * p, atol=1e-14)
        np.testing.assert_allclose(problem.exact.v(p, t), dr * p, atol=1e-14)
        np.testing.assert_allclose(u, expected["u"], atol=1e-14)
        np.testing.assert_allclose(problem.species["u"].source(at), expected["f"], atol=1e-12)
        np.testing.assert_allclose(problem.law.g(at), expected["g"] + 0 * u, atol=1e-12)
        np.testing.assert_allclose(problem.exact.closest(1.1 * x, t), x, atol=1e-14)
        np.testing.assert_allclose(problem.exact.origin(x, t), p, atol=1e-14)


def test_u_drives_the_surface():
    at = SimpleNamespace(points=np.eye(3), t=0.3, u=np.array([0.0, 1.0, 0.0]))
    for delta in (0.0, 0.4, -2.0):
        g = ec.problems.logistic_sphere(delta=delta).law.g(at)
        assert g[1] - g[0] == pytest.approx(delta, abs=1e-14)


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
def test_bdf_has_its_order(p):
    """Against a fine run on the same mesh, whose states also start the runs."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 3, ec.to_unit_sphere)
    problem = ec.problems.logistic_sphere(beta=0.5)
    fine = list(ec.evolve(space, problem, 5, 1 / 640, 0.5, start="euler", solver="direct"))[64:]
    table = time_study(space, problem, p, [1 / 80, 1 / 160], 0.5, fine=fine, solver="direct")
    for name in ("x_l2", "x_h1", "v_l2", "v_h1", "u_l2", "u_h1"):
        assert table.orders(name)[-1] == pytest.approx(p, abs=0.35), name


def test_the_radius_solves_the_logistic_equation():
    t, k, R = sympy.symbols("t k R", positive=True)
    r = R / (R * sympy.exp(-k * t) + (1 - sympy.exp(-k * t)))
    assert sympy.simplify(sympy.diff(r, t) - k * r * (1 - r / R)) == 0
    assert r.subs(t, 0) == 1


@pytest.mark.parametrize("measure", [ec.errors.lifted, ec.errors.compare])
def test_quadratic_elements_have_orders_three_and_two(measure):
    """As proven, or up to one more: on spheres, and against the nodal interpolant."""
    spaces = [ec.SurfaceSpace(ec.sphere("icosahedron", n), 2, ec.to_unit_sphere) for n in (2, 3)]
    problem = ec.problems.logistic_sphere(beta=0.5)
    table = space_study(spaces, problem, 4, 1 / 80, 0.25, measure)
    for name, proven in (("l2", 3), ("h1", 2)):
        for letter in "xvu":
            assert proven - 0.1 < table.orders(f"{letter}_{name}")[-1] < proven + 1.3, letter


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"limit": 0.0}, "limit must be a finite number > 0, got 0.0"),
        ({"rate": -1.0}, "rate must be a finite number > 0, got -1.0"),
        ({"delta": np.nan}, "delta must be a finite number, got nan"),
        ({"alpha": -1.0}, "alpha must be a finite number >= 0, got -1.0"),
    ],
)
def test_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        ec.problems.logistic_sphere(**parameters)
