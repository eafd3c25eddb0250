"""A run that goes on with another step keeps its order and its amounts."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from coupled import SPACE, coupled
from scipy.interpolate import KroghInterpolator

import esfem_core as ec


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
def test_a_polynomial_in_time_of_degree_p_is_met_exactly(p):
    """Positions and a density on a sphere of constant size, at times that are no multiples."""

    def state(t):
        shift = np.array([1.0, 2.0, 3.0]) * t**p
        return ec.State(t, SPACE.nodes + shift, None, SPACE.nodes[:, 0] + t**p, space=SPACE)

    given = [state(1 + 0.1 * j) for j in range(p + 1)]
    made = ec.respaced(given, 0.1 / np.sqrt(3), order=p)
    assert len(made) == p
    assert made[-1] is given[-1]
    for one in made:
        same_at = state(one.t)
        np.testing.assert_allclose(one.x, same_at.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.u, same_at.u, rtol=0, atol=1e-12)


def amount(state):
    return state.space.mass(state.x).sum(axis=0) @ state.u


def test_amounts_stay_what_they_are_in_every_state():
    states = list(ec.evolve(SPACE, coupled(), 3, 0.05, 0.4, solver="direct"))
    first = amount(states[0])
    start = ec.respaced(states[-4:], 0.031, order=3)
    for state in ec.evolve(SPACE, coupled(), 3, 0.031, 0.4 + 0.31, start=start, solver="direct"):
        assert amount(state) == pytest.approx(first, rel=2e-13)


def test_of_what_is_not_conserved_the_values_are_interpolated():
    """On a growing sphere a value that rests stays what it is; its amount grows."""
    rest = ec.Species(lambda x: 2 + x[:, 2], conserved=False, diffusivity=0.0)
    law = ec.laws.Prescribed(velocity=lambda x, t: 0.5 * x)
    problem = ec.Problem(species={"u": ec.Species(1.0), "rest": rest}, law=law)
    states = list(ec.evolve(SPACE, problem, 1, 0.1, 0.5, solver="direct"))
    start = ec.respaced(states[-3:], 0.05, order=2)
    assert start[0].products.keys() == {"u"}
    np.testing.assert_allclose(start[0]["rest"], 2 + SPACE.nodes[:, 2], rtol=1e-12)


def test_where_nothing_is_conserved_nothing_becomes_so():
    """As in mean curvature flow alone; of products `remeshed` would keep the sums."""
    states = list(ec.evolve(SPACE, ec.Problem(law=ec.laws.MeanCurvature()), 1, 0.01, 0.03))
    start = ec.respaced(states[-2:], 0.005, order=2)
    assert [list(state.products) for state in start] == [[], []]
    np.testing.assert_array_equal(start[0]["H"], (states[-2]["H"] + states[-1]["H"]) / 2)


@pytest.mark.parametrize("step", [0.1, 0.01])
def test_where_products_are_those_of_extrapolated_positions_the_values_are_interpolated(step):
    """However near these positions are; and no step has computed a velocity."""
    states = list(ec.evolve(SPACE, coupled(), 3, step, 3 * step, mass="extrapolated"))
    made = ec.respaced(states, step / 2, order=3)[1]
    u = KroghInterpolator([s.t for s in states], [s.u for s in states])(made.t)
    np.testing.assert_allclose(made.u, u, rtol=1e-12)
    assert made.v is None


@pytest.fixture(scope="module")
def fine():
    return list(ec.evolve(SPACE, coupled(), 5, 1 / 400, 1.475, start="euler"))[-1]


@pytest.mark.parametrize(
    ("p", "mass"),
    [(1, "updated"), (2, "updated"), (3, "updated"), (3, "extrapolated"), (4, "updated")],
)
def test_a_run_goes_on_with_another_step_at_its_order(p, mass, fine):
    """Against small steps on the same mesh; the step shrinks to 0.7 of it, then grows to 1.5."""
    problem, errors = coupled(), []
    for n in (40, 80):
        states = list(ec.evolve(SPACE, problem, p, 1 / n, 0.5, mass=mass))
        for factor, end in ((0.7, 1.025), (1.5, 1.475)):
            step = factor / n
            start = ec.respaced(states, step, order=p)
            states += list(ec.evolve(SPACE, problem, p, step, end, mass=mass, start=start))[p:]
        errors.append(ec.errors.difference(SPACE, states[-1], fine))
    for name in ("x_l2", "u_l2"):
        rate = np.log2(getattr(errors[0], name) / getattr(errors[1], name))
        assert p - 0.35 < rate < p + 1.2, (name, rate)


def test_the_same_step_gives_the_same_states():
    states = list(ec.evolve(SPACE, coupled(), 3, 0.05, 0.4))
    made = ec.respaced(states, 0.05)
    assert all(one is other for one, other in zip(made, states[-6:], strict=True))
    twice = ec.respaced(states, 0.1, order=3)
    assert all(one.x is other.x for one, other in zip(twice, states[-5::2], strict=True))
    assert twice[-1].method == ("updated", 3, 0.1)  # whose products these are now


def test_states_for_another_order_say_so():
    """Products belong to a mass matrix, an order and a step."""
    states = list(ec.evolve(SPACE, coupled(), 3, 0.1, 0.5, mass="extrapolated"))
    for order, expected in ((2, 2), (None, 3)):
        start = ec.respaced(states[-4:], 0.05, order)
        assert {state.method for state in start} == {("extrapolated", expected, 0.05)}


def test_respaced_says_how_far_the_states_must_reach_back():
    states = list(ec.evolve(SPACE, coupled(), 3, 0.05, 0.4))
    with pytest.raises(
        ValueError, match=r"reach back to t = 0\.2 for order 3 and step 0\.1, .*0\.3"
    ):
        ec.respaced(states[-3:], 0.1, order=3)
    with pytest.raises(ValueError, match="step must be a finite number > 0"):
        ec.respaced(states, 0)
    with pytest.raises(ValueError, match=r"larger against the time, t = 0\.4, got 1e-17"):
        ec.respaced(states, 1e-17)
    with pytest.raises(ValueError, match="order must be an integer from 1 to 100, got 0"):
        ec.respaced(states, 0.1, order=0)
    with pytest.raises(ValueError, match="at least one State"):
        ec.respaced([], 0.1)


@pytest.fixture(scope="module")
def adaptive():
    """The recipe, from the script that the book shows."""
    return runpy.run_path(str(Path(__file__).parents[2] / "examples" / "adaptive.py"))["adaptive"]


@pytest.mark.parametrize("p", [1, 2, 3, 4])
def test_the_recipe_of_the_book_chooses_the_step(p, adaptive):
    """A motion that is fast around t = 1 and slow before and after."""

    def motion(q, t):
        return q * (2 + np.tanh(20 * (t - 1))) / (2 + np.tanh(-20))

    problem = ec.Problem(1.0, motion=motion)
    states = adaptive(SPACE, problem, p, 0.05, 2.0, 0.02)
    times = np.array([state.t for state in states])
    steps = np.diff(times)
    assert times[-1] == 2.0
    fast = abs(times[1:] - 1) < 0.1
    assert steps[fast].max() < steps[~fast].max() / 8
    exact = amount(states[0])
    for state in states:
        assert amount(state) == pytest.approx(exact, rel=1e-12)
        np.testing.assert_allclose(state.x, motion(SPACE.nodes, state.t), atol=0.02)


@pytest.mark.parametrize("p", [2, 3])
def test_the_recipe_sees_what_happens_on_a_surface_at_rest(p, adaptive):
    """Logistic growth to 1, explicit in time, which long steps would destroy."""
    problem = ec.Problem(0.1, lambda at: at.u * (1 - at.u), motion=lambda q, t: q)
    states = adaptive(SPACE, problem, p, 0.05, 20.0, 1e-3)
    steps = np.diff([state.t for state in states])
    assert steps.max() > 4 * steps[0]
    for state in states:
        exact = 1 / (1 + 9 * np.exp(-state.t))
        np.testing.assert_allclose(state.u, exact, rtol=0, atol=3e-3)
