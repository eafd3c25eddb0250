"""Exact solutions fulfil their equations; problems refuse what makes no sense."""

import numpy as np
import pytest
import sympy

import esfem_core as ec
from esfem_core.problems.spheres import _lambert_of_exponential


def test_expanding_sphere_symbolically():
    """[N] 7.3 derived again by sympy: f from the diffusion equation, g from the velocity law."""
    t, alpha, beta = sympy.symbols("t alpha beta", positive=True)
    q = sympy.symbols("x1:4")
    r, a = 1 + sympy.sin(sympy.pi * t) / 2, sympy.exp(-(t**2))

    def laplace_beltrami(w, radius):
        """Of a function given near the sphere: Laplacian - H d/dn - d^2/dn^2."""
        n = [s / radius for s in q]
        first = sum(n[i] * sympy.diff(w, q[i]) for i in range(3))
        second = sum(n[i] * n[j] * sympy.diff(w, q[i], q[j]) for i in range(3) for j in range(3))
        return sum(sympy.diff(w, s, 2) for s in q) - 2 / radius * first - second

    u = a * q[0] * q[1] * q[2]
    along = u.subs({s: r * s for s in q}, simultaneous=True)
    material = sympy.diff(along, t).subs({s: s / r for s in q}, simultaneous=True)
    f = material + 2 * sympy.diff(r, t) / r * u - laplace_beltrami(u, r)
    v = [sympy.diff(r, t) / r * s for s in q]
    g = [(v[i] - alpha * laplace_beltrami(v[i], r)) * r / q[i] + 2 * beta / r for i in range(3)]

    rng = np.random.default_rng(0)
    for time in (0.0, 0.3, 0.9):
        problem = ec.problems.expanding_sphere(alpha=0.7, beta=1.9)
        x = float(r.subs(t, time)) * ec.to_unit_sphere(rng.standard_normal((5, 3)))
        values = problem.exact.u(x, time)
        for point, value, f_value, g_value in zip(
            x,
            values,
            problem.f(values, None, x, time),
            problem.g(values, None, x, time),
            strict=True,
        ):
            at = {t: time, alpha: 0.7, beta: 1.9, **dict(zip(q, point, strict=True))}
            assert value == pytest.approx(float(u.subs(at)), rel=1e-14)
            assert f_value == pytest.approx(float(f.subs(at)), rel=1e-12)
            for component in g:
                assert g_value == pytest.approx(float(component.subs(at)), rel=1e-11)


@pytest.mark.parametrize("coupling", ["smooth", "printed", "none"])
def test_couplings_agree_on_the_solution(coupling):
    problem = ec.problems.expanding_sphere(coupling)
    x = problem.exact.x(ec.to_unit_sphere(np.random.default_rng(0).standard_normal((9, 3))), 0.4)
    reference = ec.problems.expanding_sphere("none").g(np.zeros(9), None, x, 0.4)
    np.testing.assert_allclose(
        problem.g(problem.exact.u(x, 0.4), None, x, 0.4), reference, rtol=1e-13
    )


@pytest.mark.parametrize("alpha", [0.0, 1e-3, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("beta", [0.5, 1.0])
def test_shrinking_sphere(alpha, beta):
    problem = ec.problems.shrinking_sphere(alpha, beta, u0=2.0)
    p = np.array([[0.6, 0.0, 0.8]])
    for t in (0.0, 0.1, 0.2, *(() if alpha == 0 else (1.0, 5.0))):
        r = np.linalg.norm(problem.exact.x(p, t))
        if r == 0:  # exp(-t/alpha) is too small for a float
            assert alpha == 1e-3
            continue
        if alpha:
            assert r**2 / 2 + 2 * alpha * np.log(r) == pytest.approx(0.5 - 2 * beta * t, abs=1e-13)
        else:
            assert r**2 == pytest.approx(1 - 4 * beta * t)
        speed = problem.exact.v(p, t) @ p.T
        assert speed * (1 + 2 * alpha / r**2) == pytest.approx(-2 * beta / r, rel=1e-12)
        assert problem.exact.u(r * p, t) == pytest.approx(2.0 / r**2, rel=1e-13)


def test_shrinking_sphere_without_regularisation_vanishes():
    problem = ec.problems.shrinking_sphere(alpha=0)
    with pytest.raises(ValueError, match=r"vanishes at t = 0\.25, asked for t = 0\.3"):
        problem.exact.x(np.eye(3), 0.3)


def test_lambert_where_the_exponential_overflows():
    for w in (700.0, 1e4):
        y = _lambert_of_exponential(w)
        assert y + np.log(y) == pytest.approx(w, rel=1e-15)


@pytest.mark.parametrize("parameters", [(1, 1, 1, 4), (0.5, 2.0, 1.5, 3.0), (0, 1, 0.5, 6)])
def test_growing_sphere(parameters):
    """The implicit solution: t = int (r^2 + 2 alpha)/(delta u0 - 2 beta r) dr, by quadrature."""
    alpha, beta, delta, u0 = parameters
    problem = ec.problems.growing_sphere(alpha, beta, delta, u0)
    p = np.array([[0.0, 1.0, 0.0]])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for t in (0.0, 0.1, 0.5):
        r = problem.exact.x(p, t)[0, 1]
        s = 1 + (r - 1) * (nodes + 1) / 2
        integral = (r - 1) / 2 * weights @ ((s**2 + 2 * alpha) / (delta * u0 - 2 * beta * s))
        assert integral == pytest.approx(t, abs=1e-12)
        speed = problem.exact.v(p, t)[0, 1]
        assert speed * (1 + 2 * alpha / r**2) + 2 * beta / r == pytest.approx(delta * u0 / r**2)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"alpha": -1.0}, ValueError, "alpha must be finite and not negative, got -1.0"),
        ({"beta": np.inf}, ValueError, "beta must be finite and not negative"),
        ({"diffusivity": 0.0}, ValueError, "diffusivity must be positive, got 0.0"),
        ({"diffusivity": np.array([1.0, -1.0])}, ValueError, "diffusivity must be positive"),
        ({"law": "dynamic"}, ValueError, "law must be \"regularised\", got 'dynamic'"),
        ({"f": 3.0}, TypeError, "f must be a function or None, got float"),
        ({"motion": lambda p, t: p, "g": lambda *_: 1}, ValueError, "the motion is prescribed"),
    ],
)
def test_problem_refuses(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.Problem(u0=lambda x: x[:, 0], **arguments)


def test_unknown_coupling():
    with pytest.raises(ValueError, match="coupling must be one of"):
        ec.problems.expanding_sphere("tight")


def test_initial_values():
    x = ec.to_unit_sphere(np.random.default_rng(0).standard_normal((4, 3)))
    assert ec.Problem(u0=np.arange(4)).initial_values(x).tolist() == [0, 1, 2, 3]
    with pytest.raises(ValueError, match=r"one row for each of 4 nodes, got \(3,\)"):
        ec.Problem(u0=np.arange(3)).initial_values(x)
    with pytest.raises(ValueError, match="u0 is not finite at node 0"):
        ec.Problem(u0=lambda x: np.full(len(x), np.nan)).initial_values(x)
