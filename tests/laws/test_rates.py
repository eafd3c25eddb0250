"""A rate is taken implicitly: stable for every step, of the order of the scheme.

The same as an explicit source has a largest step, derived here from the characteristic polynomial
delta(z) + k tau z gamma(z), whose root reaches the unit circle at z = -1. Transport and
cross-diffusion are explicit, too, and their limits are those of roots of the same kind.
"""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import observed_orders

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1))
ORDERS = [1, 2, 3, 4, 5]
AT_REST = ec.laws.Prescribed(lambda p, t: p)


def at_rest(exact_u=None, **species):
    """One species on the unit sphere at rest; an exact solution makes exact starting values."""
    exact = None
    if exact_u is not None:
        exact = ec.Exact(lambda p, t: p, lambda p, t: 0 * p, lambda x, t: exact_u(t) + 0 * x[:, 0])
    return ec.Problem(species={"u": ec.Species(1.0, **species)}, law=AT_REST, exact=exact)


def largest_explicit_step(p):
    """The k tau at which a source -k u begins to grow."""
    delta, gamma = ec.bdf.delta(p), ec.bdf.gamma(p)
    signs = (-1.0) ** np.arange(p + 1)
    return (signs @ delta) / (signs[:-1] @ gamma)


def test_the_documented_limits():
    limits = [largest_explicit_step(p) for p in ORDERS]
    np.testing.assert_allclose(limits, [2, 4 / 3, 20 / 21, 32 / 45, 256 / 465], rtol=1e-14)


@pytest.mark.parametrize("p", ORDERS)
def test_an_explicit_source_blows_up_beyond_its_limit_and_not_below(p):
    step, limit = 1 / 8, largest_explicit_step(p)
    for share in (0.97, 1.03):
        k = share * limit / step
        problem = at_rest(source=lambda at, k=k: -k * at.u)
        run = ec.evolve(SPACE, problem, p, step, 1200 * step)
        if share > 1:
            with (
                pytest.warns(ec.EvolutionWarning, match="step is too large for what is explicit"),
                pytest.raises(ec.EvolutionError, match="u has grown to"),
            ):
                list(run)
        else:
            sizes = [np.abs(state.u).max() for state in run]
            assert max(sizes) < 10
            assert sizes[-1] < 1e-6


def growth(p, y, z=0.0):
    """Of a wave of length 1/q in a step, y = tau a q of it explicit and z = tau D q^2 implicit."""
    coefficients = ec.bdf.delta(p).astype(complex)
    coefficients[0] += z
    coefficients[1:] -= 1j * y * ec.bdf.gamma(p)
    return abs(np.roots(coefficients)).max()


def growth_across(p, z, d, product):
    """Of two species in a step, z = tau q^2, with D = (1, d) implicit and D12 D21 explicit."""
    delta, gamma = ec.bdf.delta(p), np.append(0, ec.bdf.gamma(p))
    one, other = (np.append(delta[0] + z * own, delta[1:]) for own in (1, d))
    return abs(np.roots(np.convolve(one, other) - product * z**2 * np.convolve(gamma, gamma))).max()


@pytest.mark.parametrize("d", [1.0, 0.05, 20.0])
@pytest.mark.parametrize("p", ORDERS)
def test_cross_diffusion_is_stable_for_every_step_up_to_the_documented_limit(p, d):
    """For infinite z, 1 + mu (1 - (1 - zeta)^p) is zero at zeta = -1 if mu = 1/(2^p - 1)."""
    limit, waves = d / (2**p - 1) ** 2, np.geomspace(1e-3, 1e6, 200)
    for sign in (1, -1):
        assert max(growth_across(p, z, d, 0.98 * sign * limit) for z in waves) < 1
    assert max(growth_across(p, z, d, 1.02 * limit) for z in waves) > 1 + 1e-3


@pytest.mark.parametrize("p", [2, 3, 4])
def test_cross_diffusion_beyond_its_limit_is_stable_for_steps_below_a_multiple_of_h_squared(p):
    """Twice as strong, of equal diffusivities, for which z is the sum of 2^j/j."""
    limit = sum(2**j / j for j in range(1, p + 1))
    product = 4 / (2**p - 1) ** 2
    assert max(growth_across(p, z, 1, product) for z in np.geomspace(1e-3, limit, 100)) <= 1 + 1e-12
    assert growth_across(p, 1.02 * limit, 1, product) > 1 + 1e-4


def crossing(c):
    """Species a and b with the matrix D of 1 and c, c explicit."""
    return {
        name: ec.Species(start, source=lambda at, other=other: (None, -c * at.grad(other)))
        for name, other, start in (("a", "b", lambda x: 2 + x[:, 2]), ("b", "a", 1.0))
    }


@pytest.mark.parametrize("step", [1.0, 4.0])
def test_cross_diffusion_blows_up_beyond_its_limit_and_not_below(step):
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
    for share in (0.97, 1.3):
        problem = ec.Problem(species=crossing(share / 7), law=AT_REST)
        run = ec.evolve(space, problem, 3, step, 600 * step)
        if share > 1:
            with (
                pytest.warns(ec.EvolutionWarning, match=r"a gradient in a flux .* h\^2"),
                pytest.raises(ec.EvolutionError, match=r"has grown to .* a gradient in a flux"),
            ):
                list(run)
        else:
            *_, last = run
            assert max(np.ptp(last[name]) for name in "ab") < 1e-6


def test_the_components_of_a_constant_cross_diffusion_have_no_limit():
    """As the docstring of Species has it, with an eigenfunction of eigenvalue 2 to compare with."""
    d, T = np.linalg.eigh([[1.0, 0.9], [0.9, 1.0]])
    back = np.linalg.inv(T)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    z = space.nodes[:, 2]
    w = ec.Species(lambda x: np.c_[2 + x[:, 2], 1 + 0 * x[:, 2]] @ back.T, diffusivity=d)
    problem = ec.Problem(species={"w": w}, law=AT_REST)
    *_, last = ec.evolve(space, problem, 3, 1 / 40, 1.0)
    a, b = (last["w"] @ T.T).T
    fast, slow = np.exp(-2 * 1.9), np.exp(-2 * 0.1)
    np.testing.assert_allclose(a, 2 + (fast + slow) / 2 * z, rtol=0, atol=3e-4)
    np.testing.assert_allclose(b, 1 + (fast - slow) / 2 * z, rtol=0, atol=3e-4)


@pytest.mark.parametrize(("p", "limit"), [(1, 2), (2, 1.22), (3, 0.46), (4, 0.15), (5, 0.046)])
def test_explicit_transport_beside_diffusion_is_stable_up_to_the_documented_limit(p, limit):
    """Of tau a^2/D = y^2/z, whatever the length of the wave."""
    waves = np.geomspace(0.03, 30, 150)
    assert max(growth(p, y, y * y / limit) for y in waves) <= 1
    assert max(growth(p, y, y * y / (1.05 * limit)) for y in waves) > 1 + 1e-6


@pytest.mark.parametrize(("p", "limit"), [(3, 0.63), (4, 0.54)])
def test_explicit_transport_without_diffusion_is_stable_for_three_and_four_steps(p, limit):
    assert max(growth(p, y) for y in np.linspace(0.05, limit, 60)) <= 1
    assert growth(p, limit + 0.02) > 1 + 1e-3


@pytest.mark.parametrize("p", [1, 2, 5])
def test_explicit_transport_without_diffusion_grows_for_other_methods(p):
    assert all(growth(p, y) > 1 + 1e-9 for y in (0.05, 0.1, 0.3))


def turning(at):
    return np.cross([0, 0, 1], at.points)


@pytest.mark.parametrize(("k", "documented"), [(1, 2.4), (2, 6.5), (3, 11)])
def test_the_documented_frequencies_of_transport(k, documented):
    """In units of |a|/h, on a mesh of two sizes of triangles."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), k, ec.to_unit_sphere)
    at, unit = ec.Surface(space, space.nodes), np.eye(len(space.nodes))
    C = [at.load(None, space.evaluate(e)[..., None] * turning(at)) for e in unit]
    omega = abs(np.linalg.eigvals(np.linalg.solve(at.M.toarray(), np.transpose(C)))).max()
    assert omega * space.mesh_size(space.nodes) == pytest.approx(documented, rel=0.25)


@pytest.mark.parametrize("p", ORDERS)
@pytest.mark.parametrize("rate", [800.0, lambda at: 800 + 400 * at.points[..., 0]])
def test_an_implicit_rate_is_stable_at_any_step(p, rate):
    """With k tau = 100, what is left after a step is of the size 1/(k tau)."""
    u = [s.u for s in ec.evolve(SPACE, at_rest(rate=rate), p, 1 / 8, 8.0, start="euler")]
    assert max(np.abs(w).max() for w in u[p:]) < 0.2
    assert np.abs(u[-1]).max() < 1e-9


@pytest.mark.parametrize("p", ORDERS)
@pytest.mark.parametrize(
    ("rate", "exact"),
    [(3.0, lambda t: np.exp(-3 * t)), (lambda at: at.u**2, lambda t: (1 + 2 * t) ** -0.5)],
    ids=["k", "u squared"],
)
def test_an_implicit_rate_has_the_order_of_the_scheme(p, rate, exact):
    problem, steps, errors = at_rest(exact, rate=rate), [1 / 20, 1 / 40, 1 / 80], []
    for step in steps:
        *_, last = ec.evolve(SPACE, problem, p, step, 1.0, solver="direct")
        errors.append(np.abs(last.u - exact(1.0)).max())
    assert observed_orders(steps, errors)[-1] == pytest.approx(p, abs=0.3)


def test_a_rate_is_the_same_as_a_source_of_the_new_value():
    """One Euler step, written out: (M/tau + A + k M) u^1 = M u^0/tau."""
    tau, k = 0.1, 5.0
    problem = ec.Problem(species={"u": ec.Species(lambda x: 1 + x[:, 2], rate=k)}, law=AT_REST)
    *_, last = ec.evolve(SPACE, problem, 1, tau, tau, solver="direct")
    M, A = SPACE.mass_stiffness(SPACE.nodes)
    rest = M @ (last.u - 1 - SPACE.nodes[:, 2]) / tau + A @ last.u + k * M @ last.u
    assert np.abs(rest).max() < 1e-14


@pytest.mark.parametrize("name", ["initial", "diffusivity"])
def test_arrays_of_a_species_are_copies_that_nobody_changes(name):
    given = np.ones(2)
    held = getattr(ec.Species(**{"initial": 1.0, name: given}), name)
    given[0] = 5.0
    np.testing.assert_array_equal(held, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        held[0] = 5.0


@pytest.mark.parametrize("name", ["alpha", "beta"])
@pytest.mark.parametrize("law", [ec.laws.Regularised, ec.laws.Dynamic])
def test_coefficients_of_laws_are_not_negative(law, name):
    with pytest.raises(ValueError, match=rf"{name} must be a finite number >= 0, got -1"):
        law(**{name: -1})


@pytest.mark.parametrize("rate", [[1.0, 2.0], (1.0,), np.ones(2)])
def test_a_rate_is_one_number_for_all_components(rate):
    with pytest.raises(
        TypeError, match=r"rate must be .*components with rates of their own are sp"
    ):
        ec.Species([1.0, 2.0], rate=rate)


def test_a_condition_as_a_source_is_told_how_it_becomes_numbers():
    with pytest.raises(TypeError, match=r"real numbers, got bool .*np\.where\(condition, 1\.0, 0"):
        list(ec.evolve(SPACE, ec.Problem(1.0, lambda at: at.u > 1), 1, 0.1, 0.1))
    list(ec.evolve(SPACE, ec.Problem(1.0, lambda at: np.where(at.u > 1, 1.0, 0.0)), 1, 0.1, 0.1))
