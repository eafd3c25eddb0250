"""The dynamic law: spheres against their equation, momentum, orders, stiff tension."""

import re
from fractions import Fraction

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp
from temporal import fine_run, temporal_orders

import esfem_core as ec
from esfem_core.study import final, observed_orders

ELLIPSOID = ec.exact_surfaces.Ellipsoid((1.3, 1.0, 0.8))
TRI = ec.sphere("icosahedron", 1)
TRI.vertices = ELLIPSOID.closest(TRI.vertices * ELLIPSOID.axes)
SPACE = ec.SurfaceSpace(TRI, 2, ELLIPSOID.closest)


def radius(alpha, beta, force, v0, t):
    """The equation r'' + 2 r'^2/r + 2 alpha r'/r^2 + 2 beta/r = g, integrated to rounding."""

    def rate(t, y):
        r, v = y
        return [v, force(t) - 2 * v**2 / r - 2 * alpha * v / r**2 - 2 * beta / r]

    return solve_ivp(rate, (0, t), [1.0, v0], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


@pytest.mark.parametrize(("alpha", "beta"), [(0.5, 0.0), (0.5, 1.0), (0.1, 0.7)])
def test_a_sphere_obeys_its_equation_with_order_p(alpha, beta):
    """Degree 8: the spatial error is below 1e-8."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 8, ec.to_unit_sphere)
    law = ec.laws.Dynamic(lambda x: 0.4 * x, alpha, beta, lambda at: 2 * np.cos(at.t))
    exact = radius(alpha, beta, lambda t: 2 * np.cos(t), 0.4, 0.6)
    for p in (1, 2, 3):
        errors = []
        for n in (20, 40):
            last = final(ec.evolve(space, ec.Problem(law=law), p, 0.6 / n, 0.6))
            r = np.linalg.norm(last.x, axis=1).mean()
            v = (last.v * last.x).sum(axis=1).mean() / r
            errors.append(np.linalg.norm([r, v] - exact))
            np.testing.assert_array_equal(last.v, last["velocity"])
        assert p - 0.25 < observed_orders([2, 1], errors)[0] < p + 0.5


@pytest.mark.slow
def test_orders_in_time_on_an_ellipsoid():
    law = ec.laws.Dynamic(lambda x: 0.3 * x[:, [1, 2, 0]], 0.3, 1.0, lambda at: 0.3 * at.u)
    problem = ec.Problem(species={"u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])}, law=law)
    fine = fine_run(SPACE, problem, 1 / 1280, 0.4, settled=0.1)
    for p in range(1, 6):
        for name, order in temporal_orders(SPACE, problem, p, [1 / 160, 1 / 320], fine).items():
            assert order == pytest.approx(p, abs=0.35), (p, name)


def test_orders_in_space_on_an_ellipsoid():
    """Against degree 5 on the finest mesh, in the nodes that the meshes share."""
    spaces = []
    for refinements, degree in [(1, 2), (2, 2), (2, 6)]:
        tri = ec.sphere("icosahedron", refinements)
        tri.vertices = ELLIPSOID.closest(tri.vertices * ELLIPSOID.axes)
        spaces.append(ec.SurfaceSpace(tri, degree, ELLIPSOID.closest))
    law = ec.laws.Dynamic(lambda x: 0.3 * ELLIPSOID.normal(x), 0.3, 0.5)
    last = [final(ec.evolve(s, ec.Problem(law=law), 4, 1 / 80, 0.5, start="euler")) for s in spaces]
    shared = 42  # vertices of the coarsest mesh come first
    errors = [np.sqrt(np.mean((s.x[:shared] - last[2].x[:shared]) ** 2)) for s in last[:2]]
    assert np.log2(errors[0] / errors[1]) > 2.9


def test_uniform_motion_is_exact_and_momentum_is_kept():
    law = ec.laws.Dynamic([0.1, 0.2, -0.3], alpha=0.2)
    last = final(ec.evolve(SPACE, ec.Problem(law=law), 3, 0.05, 0.5))
    np.testing.assert_allclose(last.x, SPACE.nodes + 0.5 * np.array([0.1, 0.2, -0.3]), atol=1e-12)
    law = ec.laws.Dynamic(lambda x: np.cross([0, 1, 2], x) + 0.3 * x**2, 0.2, 0.5)
    run = ec.evolve(SPACE, ec.Problem(law=law), 3, 0.02, 0.3, mass="extrapolated")
    momenta = np.array([state.products["velocity"].sum(axis=0) for state in run if state.products])
    assert np.ptp(momenta, axis=0).max() < 1e-12
    assert abs(momenta[0]).max() > 0.1


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
def test_large_tension_needs_no_small_step(p):
    """With tau beta/alpha = 10, twenty times what an explicit term is stable for."""
    law = ec.laws.Dynamic(
        lambda x: 0.01 * x[:, [1, 2, 0]], 0.05, 10.0, lambda at: 20 + 0 * at.density
    )
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    last = final(ec.evolve(space, ec.Problem(law=law), p, 0.05, 1.0))
    assert abs(np.linalg.norm(last.x, axis=1) - 1).max() < 0.1


def largest_growth(p, limit):
    """Growth per step with beta A x explicit, over all waves: tau = 1, alpha lambda = s.

    v' + s v + limit s x = 0 and x' = v, where x is extrapolated.
    """
    delta, gamma = (Polynomial(c) for c in (ec.bdf.delta(p), np.append(0, ec.bdf.gamma(p))))
    waves = np.logspace(-2, 5, 300)
    return max(1 / abs(((delta + s) * delta + limit * s * gamma).roots()).min() for s in waves)


def test_the_stated_limits_of_an_explicit_tension_are_those_of_its_roots():
    said = re.search(r"alpha` < (.+) for p", ec.laws.dynamic.__doc__)[1].split(", ")
    assert len(said) == 5
    for p, limit in enumerate(map(float, map(Fraction, said)), 1):
        assert largest_growth(p, 0.998 * limit) < 1 + 1e-9
        assert largest_growth(p, 1.002 * limit) > 1 + 1e-6


@pytest.mark.parametrize("mass", ["updated", "extrapolated"])
def test_a_run_that_goes_on_gives_the_same_bits(mass):
    law = ec.laws.Dynamic(lambda x: 0.3 * x, 0.3, 1.0, lambda at: at.u)
    problem = ec.Problem(1.0, law=law)
    run = {"order": 3, "step": 0.01, "end": 0.1, "solver": "direct", "mass": mass}
    states = list(ec.evolve(SPACE, problem, **run))
    again = final(ec.evolve(SPACE, problem, **run, start=states[4:7]))
    for name in ("velocity", "u"):
        np.testing.assert_array_equal(again[name], states[-1][name])


def test_a_law_of_nothing_but_a_number_starts_with_it_and_has_viscosity_but_no_tension():
    law = ec.laws.Dynamic(0.5)
    assert (law.alpha, law.beta) == (1.0, 0.0)
    first = next(iter(ec.evolve(SPACE, ec.Problem(law=law), 1, 0.1, 0.1)))
    assert (first["velocity"] == 0.5).all()


def test_an_array_of_the_caller_may_change_afterwards():
    v0 = np.ones_like(SPACE.nodes)
    law = ec.laws.Dynamic(v0)
    v0[:] = 7
    first = next(iter(ec.evolve(SPACE, ec.Problem(law=law), 1, 0.1, 0.1)))
    assert (first["velocity"] == 1).all()


def test_refused():
    with pytest.raises(ValueError, match="alpha must be a finite number >= 0, got -1"):
        ec.laws.Dynamic(0.0, alpha=-1)
    with pytest.raises(ValueError, match="beta must be a finite number >= 0, got -1"):
        ec.laws.Dynamic(0.0, beta=-1)
    with pytest.raises(TypeError, match="g must be a function of a Surface or None"):
        ec.laws.Dynamic(0.0, g=1.0)
    problem = ec.Problem(law=ec.laws.Dynamic(lambda x: x[:, 0]))
    with pytest.raises(ValueError, match=r"v0 must have shape \(162, 3\), got \(162,\)"):
        ec.evolve(SPACE, problem, 1, 0.1, 0.1)
    problem = ec.Problem(law=ec.laws.Dynamic([[0.1, 0.2, 0.3]]))  # of one node
    with pytest.raises(ValueError, match=r"v0 must have shape \(162, 3\), got \(1, 3\)"):
        ec.evolve(SPACE, problem, 1, 0.1, 0.1)
