"""Several species, or none: what they share, and the amounts that are kept."""

from fractions import Fraction

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import final

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)


def law():
    """One that does not see the species: so each of them can be run alone."""
    return ec.laws.Regularised(0.7, 0.3, lambda at: 2 + at.points[..., 2] * np.cos(3 * at.t))


def species(**diffusivities):
    initial = {"a": lambda x: 1 + x[:, 0] * x[:, 1], "b": lambda x: 2 + x[:, 2], "c": 3.0}
    return {
        name: ec.Species(initial[name], lambda at, name=name: -at[name], diffusivity=D)
        for name, D in diffusivities.items()
    }


def run(some, solver="lagged"):
    statistics = ec.Statistics()
    problem = ec.Problem(species=some, law=law())
    states = ec.evolve(SPACE, problem, 2, 0.05, 0.5, solver=solver, statistics=statistics)
    return final(states), statistics


@pytest.mark.parametrize(("solver", "close"), [("direct", 1e-13), ("lagged", 1e-10)])
def test_species_with_equal_matrices_share_a_solve_and_a_factorisation(solver, close):
    both, statistics = run(species(a=1.0, b=1.0), solver)
    alone = {name: run(species(**{name: 1.0}), solver) for name in "ab"}
    assert statistics.solves["a and b"] == alone["a"][1].solves["a"]
    assert not {"a", "b"} & set(statistics.solves)
    shared, single = (s.solvers[k] for s, k in ((statistics, "a and b"), (alone["a"][1], "a")))
    assert shared.factorisations == single.factorisations
    for name in "ab":
        np.testing.assert_allclose(both[name], alone[name][0][name], rtol=0, atol=close)
    np.testing.assert_array_equal(both.x, alone["a"][0].x)


def test_what_is_shared_is_what_is_equal():
    """Diffusivity, rate and conservation, each by its number; a function is one's own."""

    def kinds(**changes):
        one = ec.Species(1.0, diffusivity=0.5, rate=2.0)
        other = ec.Species(2.0, **{"diffusivity": 0.5, "rate": 2.0} | changes)
        third = ec.Species(3.0, diffusivity=np.float64(0.5), rate=2)
        return set(run({"a": one, "b": other, "c": third})[1].solves) - {"law 1", "start"}

    assert kinds() == {"a and b and c"}
    separate = {"a and c", "b"}
    assert kinds(diffusivity=0.25) == separate
    assert kinds(rate=1.0) == separate
    assert kinds(conserved=False) == separate
    assert kinds(diffusivity=lambda at: np.full(at.density.shape, 0.5)) == separate
    assert kinds(rate=lambda at: np.full(at.density.shape, 2.0)) == separate


def test_a_function_that_is_constant_is_the_constant():
    constant, _ = run({"a": ec.Species(lambda x: x[:, 0], rate=2.0, diffusivity=0.5)}, "direct")
    for kind in ((), (3, 3)):
        D = 0.5 * (np.eye(3) if kind else 1.0)
        functions = ec.Species(
            lambda x: x[:, 0],
            rate=lambda at: np.full(at.density.shape, 2.0),
            diffusivity=lambda at, D=D, kind=kind: np.broadcast_to(D, (*at.density.shape, *kind)),
        )
        same, _ = run({"a": functions}, "direct")
        np.testing.assert_allclose(same["a"], constant["a"], rtol=0, atol=1e-13)


@pytest.mark.parametrize("solver", ["direct", "lagged"])
def test_different_matrices_are_solved_like_single_runs(solver):
    some = {"a": 1.0, "b": lambda at: 1 + at["b"] / 4, "c": 0.0}
    several, _ = run(species(**some), solver)
    for name, D in some.items():
        alone, _ = run(species(**{name: D}), solver)
        close = 1e-13 if solver == "direct" else 1e-10
        np.testing.assert_allclose(several[name], alone[name], rtol=0, atol=close)


def test_components_and_species_are_the_same():
    """One species of two components with D of their own, or two species."""
    separate, _ = run(species(a=1.0, b=0.1), "direct")

    def initial(x):
        return np.column_stack([1 + x[:, 0] * x[:, 1], 2 + x[:, 2]])

    together, _ = run(
        {"u": ec.Species(initial, lambda at: -at.u, diffusivity=np.array([1.0, 0.1]))}, "direct"
    )
    for column, name in enumerate("ab"):
        np.testing.assert_allclose(together.u[:, column], separate[name], rtol=0, atol=1e-13)


def test_without_species_the_surface_moves_alone():
    """Mean curvature flow, regularised, with the radius of the shrinking sphere."""
    exact = ec.problems.shrinking_sphere(0.5, 1.0)
    problem = ec.Problem(alpha=0.5, beta=1.0)
    statistics = ec.Statistics()
    states = list(ec.evolve(SPACE, problem, 3, 1 / 40, 0.5, statistics=statistics))
    assert dict(problem.species) == {}
    assert all(dict(state.fields) == dict(state.products) == {} for state in states)
    assert set(statistics.solves) == {"law 1"}
    radius = np.linalg.norm(exact.exact.x(SPACE.nodes, 0.5), axis=1)
    assert np.linalg.norm(states[-1].x, axis=1) == pytest.approx(radius, rel=2e-3)
    *_, carrying = ec.evolve(SPACE, exact, 3, 1 / 40, 0.5, start="euler")
    np.testing.assert_array_equal(states[-1].x, carrying.x)


def test_a_number_is_a_constant_initial_value():
    for value in (2, 2.0, np.float32(2)):
        number = final(ec.evolve(SPACE, ec.Problem(value, law=law()), 2, 0.05, 0.2))
        function = ec.Problem(lambda x: np.full(len(x), 2.0), law=law())
        same = final(ec.evolve(SPACE, function, 2, 0.05, 0.2))
        np.testing.assert_array_equal(number.u, same.u)


@pytest.mark.parametrize("number", [Fraction(1, 4), np.array(0.25), np.float32(0.25)])
def test_coefficients_are_numbers_of_any_library(number):
    def last(a):
        species = ec.Species(lambda x: 1 + x[:, 0], rate=a, diffusivity=a)
        carried = ec.Problem(species={"u": species}, law=ec.laws.Regularised(a, a))
        others = (ec.laws.Dynamic(a, a, a), ec.laws.MeanCurvature(a))
        problems = (carried, *(ec.Problem(species={}, law=law) for law in others))
        return [final(ec.evolve(SPACE, problem, 1, 0.01, 0.02)) for problem in problems]

    for found, expected in zip(last(number), last(0.25), strict=True):
        for name, w in {"x": expected.x, **expected.fields}.items():
            np.testing.assert_array_equal({"x": found.x, **found.fields}[name], w)


def test_a_species_of_a_problem_without_initial_values_is_refused():
    problem = ec.Problem(species={"u": ec.Species(None)}, law=law())
    with pytest.raises(ValueError, match="'u' must have initial values, but its Species has None"):
        ec.evolve(SPACE, problem, 1, 0.1, 0.2)


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("solver", ["lagged", "direct"])
def test_amounts_of_two_species_are_kept_starting_states_included(p, solver):
    """1' M(x^n) w with updated mass matrices, 1' M(x~^n) w with extrapolated ones.

    The species diffuse with a D of u and have fluxes, and the surface moves with both.
    """
    some = {
        "u": ec.Species(
            lambda x: 1 + x[:, 0] * x[:, 1],
            lambda at: (None, 0.1 * at["w"][..., None] * at.points),
            diffusivity=lambda at: 1 + at.u / 2,
        ),
        "w": ec.Species(
            lambda x: 2 + x[:, 2],
            lambda at: (None, -0.1 * at.grad_u),
            diffusivity=lambda at: np.eye(3) * at.u[..., None, None] ** 2,
        ),
    }
    problem = ec.Problem(
        species=some,
        law=ec.laws.Regularised(1.0, 1.0, lambda at: at.u + at["w"] + at.points[..., 2]),
    )
    gamma, first = ec.bdf.gamma(p), SPACE.mass(SPACE.nodes).sum(axis=0)
    for mass in ("updated", "extrapolated"):
        run = ec.evolve(SPACE, problem, p, 0.02, 0.4, mass=mass, start="euler", solver=solver)
        states = list(run)
        assert np.abs(states[-1].x - SPACE.nodes).max() > 0.05
        for n, state in enumerate(states):
            x = state.x
            if mass == "extrapolated" and n >= p:
                x = sum(gamma[j] * states[n - 1 - j].x for j in range(p))
            ones = SPACE.mass(x).sum(axis=0)
            for name in some:
                initial = first @ states[0][name]
                assert ones @ state[name] == pytest.approx(initial, rel=1e-13), (mass, n, name)


def test_a_source_without_return_is_refused():
    def forgetful(at):
        at.u**2

    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    problem = ec.Problem(1.0, forgetful, motion=lambda p, t: p)
    with pytest.raises(
        TypeError, match="source f of 'u' must return numbers, but returned None: is a return"
    ):
        list(ec.evolve(space, problem, 1, 0.1, 0.2))


def test_arrays_of_a_species_are_its_own():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    u0 = np.ones(len(space.nodes))
    problem = ec.Problem(u0, motion=lambda p, t: p)
    u0 *= 7
    assert next(ec.evolve(space, problem, 1, 0.1, 0.1)).u.max() == 1.0
