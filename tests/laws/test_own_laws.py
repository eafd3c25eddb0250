"""A velocity law of one's own: a class with species and velocity, without any private name."""

import numpy as np
import pytest

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)


class MyLaw:
    """v - alpha lap v + beta H nu = g nu, written by a reader."""

    def __init__(self, alpha, beta, g):
        self.alpha, self.beta, self.g, self.species = alpha, beta, g, {}

    def velocity(self, at, new, tau, past, solve):
        b = self.beta * (at.A @ past)
        b += at.load(self.g(at)[..., None] * at.normal)
        return solve(at.matrix(1.0, self.alpha + self.beta * tau), b)


def g(at):
    return 1 + at.u + at.points[..., 2] * np.cos(3 * at.t)


@pytest.mark.parametrize("solver", ["direct", "lagged"])
@pytest.mark.parametrize("mass", ["updated", "extrapolated"])
@pytest.mark.parametrize("p", [1, 3, 5])
def test_ten_lines_are_the_regularised_law_bit_for_bit(p, mass, solver):
    species = {"u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])}
    runs = [
        ec.evolve(
            SPACE, ec.Problem(species=species, law=law), p, 0.02, 0.2, mass=mass, solver=solver
        )
        for law in (MyLaw(0.7, 0.3, g), ec.laws.Regularised(0.7, 0.3, g))
    ]
    for mine, built_in in zip(*runs, strict=True):
        np.testing.assert_array_equal(mine.x, built_in.x)
        np.testing.assert_array_equal(mine.u, built_in.u)
        if mine.v is None:
            assert built_in.v is None
        else:
            np.testing.assert_array_equal(mine.v, built_in.v)


STILL = np.zeros_like(SPACE.nodes)


class Rest:
    species: dict = {}  # noqa: RUF012 - what a reader would write

    def __init__(self, v):
        self.v = v

    def velocity(self, at, new, tau, past, solve):
        return self.v


def test_what_a_law_returns_is_checked():
    good = ec.Problem(law=Rest(np.zeros_like(SPACE.nodes)))
    *_, last = ec.evolve(SPACE, good, 1, 0.1, 0.2)
    np.testing.assert_array_equal(last.x, SPACE.nodes)
    for v, error, message in (
        (SPACE.nodes[:, 0], ValueError, r"velocity of the law must have shape \(258, 3\), got"),
        (None, TypeError, "velocity of the law must hold real numbers"),
    ):
        with pytest.raises(error, match=message):
            list(ec.evolve(SPACE, ec.Problem(law=Rest(v)), 1, 0.1, 0.2))


class Carrying(Rest):
    def __init__(self, species):
        self.v, self.species = STILL, species


@pytest.mark.parametrize(
    ("species", "error", "message"),
    [
        ({"x": ec.Species(1.0)}, ValueError, "a species of the law must have a name other than"),
        ({"v": ec.Species(1.0)}, ValueError, "other than x and v, got 'v'"),
        ({"q": 1.0}, TypeError, r"species of the law\['q'\] must be a Species, got 1\.0"),
        ([ec.Species(1.0)], TypeError, "species of the law must be a mapping from names to Spec"),
        (lambda self: {}, TypeError, "species of the law must be a mapping .*, got <function"),
    ],
    ids=["x", "v", "number", "list", "method"],
)
def test_functions_of_a_law_are_species_with_names_of_their_own(species, error, message):
    with pytest.raises(error, match=message):
        ec.Problem(law=Carrying(species))


class Changing(Rest):
    """What its function solves in a step is not what it solves at the start."""

    def __init__(self, kept, **changed):
        self.v, self.kept, self.changed = STILL, kept, changed

    @property
    def species(self):
        return {"q": ec.Species(1.0, **self.kept)}

    def equations(self, tau, past):
        return {"q": ec.Species(1.0, **(self.kept | self.changed))}


WEST = SPACE.nodes[:, 0] < -0.9


@pytest.mark.parametrize(
    ("kept", "changed", "message"),
    [
        ({}, {"conserved": False}, "'q' must have conserved=True as in the species of law, got F"),
        ({"conserved": False}, {"conserved": True}, "'q' must have conserved=False as in the"),
        ({}, {"fixed": (WEST, 1.0)}, "'q' must have the fixed of the species of law or none"),
        ({"fixed": (WEST, 1.0)}, {"fixed": (WEST, 2.0)}, "the fixed of the species of law or none"),
        ({"fixed": (WEST, 1.0)}, {"fixed": (~WEST, 1.0)}, "the fixed of the species of law or "),
    ],
)
def test_a_step_does_not_change_what_is_kept_from_one_to_the_next(kept, changed, message):
    run = ec.evolve(SPACE, ec.Problem(law=Changing(kept, **changed)), 1, 0.1, 0.2)
    with pytest.raises(ValueError, match=f"law.equations: .*{message}"):
        list(run)


@pytest.mark.parametrize("changed", [{}, {"rate": 0.0, "diffusivity": 2.0}, {"fixed": None}])
def test_a_step_may_change_the_rest(changed):
    kept = {"conserved": False, "fixed": (WEST, lambda x, t: 1.0)}
    *_, last = ec.evolve(SPACE, ec.Problem(law=Changing(kept, **changed)), 1, 0.1, 0.2)
    np.testing.assert_allclose(last["q"], 1.0, rtol=1e-12)


class Placed(Rest):
    def __init__(self, places):
        self.v, self.places = STILL, places

    def position(self, nodes, t, before):
        return self.places(nodes, t)


def test_positions_of_a_law_are_checked_and_copied():
    kept = SPACE.nodes.copy()
    problem = ec.Problem(law=Placed(lambda nodes, t: kept))
    *_, last = ec.evolve(SPACE, problem, 1, 0.1, 0.2)
    assert kept.flags.writeable
    assert not np.shares_memory(last.x, kept)
    for places, error, message in (
        (lambda p, t: p[:, :2], ValueError, r"what law.position returns must have shape \(258, 3"),
        (lambda p, t: None, TypeError, "what law.position returns must hold real numbers"),
    ):
        with pytest.raises(error, match=message):
            ec.evolve(SPACE, ec.Problem(law=Placed(places)), 1, 0.1, 0.2)
    *_, last = ec.evolve(SPACE, ec.Problem(law=Placed(lambda p, t: p.tolist())), 1, 0.1, 0.2)
    np.testing.assert_array_equal(last.x, SPACE.nodes)


def bad(t):
    return np.nan if t > 0.25 else 0.0


class Failing(Rest):
    def velocity(self, at, new, tau, past, solve):
        return self.v + bad(at.t)


REST = ec.laws.Prescribed(velocity=lambda x, t: 0 * x)


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (Failing(STILL), "the velocity of the law"),
        (ec.laws.with_slip(REST, lambda at: 0 * at.x + bad(at.t)), r"the slip w\(at\)"),
        (
            ec.laws.with_slip(
                ec.laws.Prescribed(velocity=lambda x, t: 0 * x + bad(t)), ec.laws.Elastic(1.0)
            ),
            r"velocity\(x, t\)",
        ),
        (ec.laws.MeanCurvature(g=lambda x, t: 2 + bad(t) + 0 * x[:, 0]), r"g\(x, t\)"),
    ],
    ids=["own law", "slip", "velocity with a slip", "forcing"],
)
def test_numbers_that_go_bad_end_a_run_with_step_and_time(law, text):
    states = []
    with pytest.raises(ec.EvolutionError, match=f"step 3, t = 0.3: {text} must be finite, but "):
        states.extend(ec.evolve(SPACE, ec.Problem(law=law), 1, 0.1, 1.0))
    run = ec.evolve(SPACE, ec.Problem(law=law), 1, 0.1, 1.0)
    assert [next(run).t for _ in range(3)] == [0.0, 0.1, 0.2]


def test_a_perturbation_that_goes_bad_does_so_too():
    with pytest.raises(ec.EvolutionError, match=r"step 2, t = 0.2: perturbation\(2\)\['x'\] must"):
        list(
            ec.evolve(
                SPACE,
                ec.Problem(law=Rest(STILL)),
                1,
                0.1,
                1.0,
                perturbation=lambda n: {"x": np.nan if n == 2 else 0.0},
            )
        )


def test_a_velocity_may_change_what_it_is_given_with_a_slip_as_well():
    law = ec.laws.with_slip(
        ec.laws.Prescribed(velocity=lambda x, t: x.__imul__(0.1)), ec.laws.Elastic(1.0)
    )
    *_, last = ec.evolve(SPACE, ec.Problem(law=law), 2, 0.1, 0.5)
    np.testing.assert_allclose(np.linalg.norm(last.x, axis=1), np.exp(0.05), rtol=1e-3)


def test_what_is_no_law_is_refused():
    takers = (lambda law: ec.Problem(law=law), lambda law: ec.laws.with_slip(law, "elastic"))
    for take in takers:
        for law in (object(), lambda at: at.normal, 1.0):
            with pytest.raises(
                TypeError, match=r"law must have a method velocity, as .* esfem_core\.laws .*; got"
            ):
                take(law)
        for law in (ec.laws.Fixed, ec.laws.Fixed(0.0)):
            with pytest.raises(
                TypeError, match=r"; Prescribed\(lambda x, t: x\) is rest, Fixed is"
            ):
                take(law)
        with pytest.raises(
            TypeError, match=r"law must be an object, got the class Rest: write Rest\(\.\.\.\)"
        ):
            take(Rest)
