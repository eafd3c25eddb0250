"""What may stand on the right of a velocity law: normals, averages, nodal values, tensions."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import observed_orders

SPHERE = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 4, ec.to_unit_sphere)
TORUS = ec.exact_surfaces.Torus(1.0, 0.4)


def radii(state):
    return np.linalg.norm(state.x, axis=1)


def mean_radius(state):
    return np.sqrt(state.surface().integral(1.0) / (4 * np.pi))


# Anisotropic growth


def test_growth_by_the_normal_makes_the_wulff_shape_it_should():
    """With v . nu = g(nu), while the surface is convex, the support function is h + t g."""
    law = ec.laws.Regularised(0.0, 0.0, lambda at: 1 + 0.3 * at.normal[..., 2] ** 2)
    errors = []
    for refinements in (1, 2):
        space = ec.SurfaceSpace(ec.sphere("icosahedron", refinements), 2, ec.to_unit_sphere)
        *_, last = ec.evolve(space, ec.Problem(law=law), 3, 1 / 40, 0.5)
        at = last.surface()
        support = np.sum(at.points * at.normal, axis=-1)
        errors.append(np.abs(support - 1 - 0.5 * (1 + 0.3 * at.normal[..., 2] ** 2)).max())
        top, equator = np.abs(last.x[:, 2]).max(), np.hypot(last.x[:, 0], last.x[:, 1]).max()
        assert (top, equator) == pytest.approx((1.65, 1.5), abs=2e-2 / 8**refinements)
    assert errors[1] < 2e-3
    assert np.log2(errors[0] / errors[1]) > 1.7


# Averages


def test_growth_by_a_mean_value_obeys_its_equation():
    """The mean of u is (amount)/(area) = 1/r^2, so r' = (1 - 2 beta r)/(r^2 + 2 alpha)."""
    alpha, beta = 0.5, 0.1
    problem = ec.Problem(
        lambda x: 1 + x[:, 0] + x[:, 1] * x[:, 2],
        g=lambda at: np.broadcast_to(at.mean(at.u), at.density.shape),
        alpha=alpha,
        beta=beta,
    )
    exact = ec.problems.growing_sphere(alpha, beta, delta=1.0, u0=1.0).exact
    radius = np.linalg.norm(exact.x(SPHERE.nodes, 1.0), axis=1)
    errors = []
    for step in (1 / 10, 1 / 20):
        *_, last = ec.evolve(SPHERE, problem, 2, step, 1.0, start="euler")
        errors.append(abs(mean_radius(last) - radius[0]))
    assert np.ptp(last.u) > 0.05
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.4)


def test_a_number_is_a_constant_speed():
    """What at.mean returns may be handed on as it is; r^3 = 1 + 3 t for u = 1/r^2."""
    problem = ec.Problem(1.0, g=lambda at: at.mean(at.u), alpha=0.0, beta=0.0)
    *_, last = ec.evolve(SPHERE, problem, 4, 1 / 40, 1.0)
    assert radii(last) == pytest.approx(4 ** (1 / 3), rel=1e-4)


def test_growth_shared_by_the_area_adds_volume_at_a_constant_rate():
    """With v . nu = 1/area on a torus, dV/dt = 1."""
    problem = ec.Problem(g=lambda at: 1 / at.integral(1.0), alpha=0.0, beta=0.0)

    def volume(state):
        at = state.surface()
        return at.integral((at.points * at.normal).sum(axis=-1)) / 3

    errors = []
    for n, m in ((15, 6), (30, 12)):
        space = ec.SurfaceSpace(ec.torus(1.0, 0.4, n, m), 2, TORUS.closest)
        first, *_, last = ec.evolve(space, problem, 3, 1 / 20, 1.0)
        errors.append(abs(volume(last) - volume(first) - 1.0))
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] > 5


# Nodal values


def test_a_nodal_source_is_the_function_it_interpolates():
    """x1 t is a finite element function: both ways give the same numbers."""

    def motion(p, t):
        return p * [1 + t, 1.0, 1 - t / 2]

    sources = (
        lambda at: at.space.evaluate(at.t * motion(at.space.nodes, at.t)[:, 0]),
        lambda at: at.t * at.points[..., 0],
    )
    runs = [
        list(ec.evolve(SPHERE, ec.Problem(1.0, f, motion=motion), 2, 0.05, 0.5, solver="direct"))
        for f in sources
    ]
    assert np.ptp(runs[0][-1].u) > 0.1
    np.testing.assert_allclose(runs[0][-1].u, runs[1][-1].u, rtol=0, atol=1e-13)


# Surface tension


class Tension:
    """(M + alpha A) v + A_beta x = 0 with a tension beta(u), int beta grad x . grad phi."""

    species: dict = {}  # noqa: RUF012 - what a reader would write

    def __init__(self, beta, alpha=0.0):
        self.beta, self.alpha = beta, alpha

    def velocity(self, at, new, tau, past, solve):
        B = at.matrix(stiffness=self.beta(at))
        return solve(at.M + self.alpha * at.A + tau * B, B @ past)


def constant(at):
    return np.full(at.density.shape, 0.5)


def marangoni(at):
    """-H nu/2 = -x/|x|^2 on spheres, as a force."""
    return -at.points / (at.points**2).sum(axis=-1, keepdims=True)


def shrunk(alpha):
    """The exact radius at t = 1/4 for beta = 1/2."""
    exact = ec.problems.shrinking_sphere(alpha, 0.5).exact
    return np.linalg.norm(exact.x(np.eye(3)[:1], 0.25))


# Laws, the last time, and the exact radius: (r^2 + 4 alpha log r)/2 = 1/2 - t for beta = 1/2;
# for beta = u = 1/r^2, r^4 + 4 alpha r^2 = 1 + 4 alpha - 8 t.
REST = {"u": ec.Species(1.0)}
TENSIONS = {
    "constant": (Tension(constant), {}, 0.25, np.sqrt(0.5)),
    "constant, alpha": (Tension(constant, 0.03), {}, 0.25, shrunk(0.03)),
    "force, alpha": (ec.laws.Regularised(0.1, 0.0, marangoni), {}, 0.25, shrunk(0.1)),
    "u": (Tension(lambda at: at.u), REST, 0.075, 0.4**0.25),
    "u, alpha": (Tension(lambda at: at.u, 0.1), REST, 0.075, np.sqrt(np.sqrt(0.84) - 0.2)),
}


@pytest.mark.parametrize("case", TENSIONS)
def test_a_tension_gives_the_exact_radius_with_order_p(case):
    """The temporal error of the mean radius, against a fine run on the same mesh.

    Without alpha up to p = 3 only: see the next test.
    """
    law, species, end, exact = TENSIONS[case]
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    problem = ec.Problem(species=species, law=law)
    stable = 3 if case in ("constant", "u") else 5
    fine = list(ec.evolve(space, problem, stable, end / 640, end, start="euler", solver="direct"))
    assert mean_radius(fine[-1]) == pytest.approx(exact, rel=4e-3)
    for p in range(1, stable + 1):
        counts, errors = (20, 40), []
        steps = [end / n for n in counts]
        for step, n in zip(steps, counts, strict=True):
            start = fine[:: 640 // n][:p]
            *_, last = ec.evolve(space, problem, p, step, end, start=start, solver="direct")
            errors.append(abs(mean_radius(last) - mean_radius(fine[-1])))
        assert observed_orders(steps, errors)[0] == pytest.approx(p, abs=0.4), p


@pytest.mark.parametrize("degree", [1, 2])
def test_mean_curvature_without_alpha_is_unstable_from_order_four_on(degree):
    """The tangential part of A(x~) x: implicit in x, and explicit with the other sign in x~.

    Its characteristic polynomial delta(z) + kappa (1 - z)^p, kappa = tau beta lambda, has roots in
    the unit disk for large kappa from p = 4 on. alpha > 0 bounds kappa by tau beta/alpha.
    """
    for p in (1, 2, 3, 4, 5):
        z = np.polynomial.Polynomial([0.0, 1.0])
        delta = np.polynomial.Polynomial(ec.bdf.delta(p))
        for kappa, unstable in ((100.0, p >= 4), (0.1, False)):
            roots = (delta + kappa * (1 - z) ** p).roots()
            others = roots[np.abs(roots - 1) > 1e-6]
            assert (np.abs(others).min(initial=2.0) < 1) == unstable, (p, kappa)

    space = ec.SurfaceSpace(ec.sphere("icosahedron", 4 - degree), degree, ec.to_unit_sphere)
    for alpha, p, survives in ((0.0, 3, True), (0.0, 5, False), (0.01, 5, True)):
        problem = ec.Problem(law=Tension(lambda at: np.full(at.density.shape, 1.0), alpha))
        run = ec.evolve(space, problem, p, 1 / 800, 0.15, start="euler")
        if survives:
            *_, last = run
            assert mean_radius(last) == pytest.approx(np.sqrt(0.4), rel=0.03)
        else:
            with pytest.raises(ec.EvolutionError, match="turned over"):
                list(run)


def test_a_constant_tension_is_that_of_the_built_in_law():
    problem, same = ec.Problem(law=Tension(constant)), ec.Problem(alpha=0.0, beta=0.5)
    with pytest.warns(ec.EvolutionWarning, match="alpha = 0 with beta > 0"):
        *_, built_in = ec.evolve(SPHERE, same, 3, 1 / 40, 0.4, solver="direct")
    *_, own = ec.evolve(SPHERE, problem, 3, 1 / 40, 0.4, solver="direct")
    np.testing.assert_allclose(own.x, built_in.x, rtol=0, atol=1e-11)
