"""Facts that the cases of the expanding sphere's experiments must agree with."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.campaign import stored
from esfem_core.companion.experiments.expanding_sphere import (
    errors_at_end,
    lifted_sides,
    make_space,
    time_errors,
)
from esfem_core.companion.experiments.theorem import Norms, left_hand_sides
from esfem_core.stepping import exact_state
from esfem_core.study import observed_orders


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_turning_keeps_the_sphere_and_only_turning_leaves_the_planes(angle):
    space = make_space("octahedron", 2, 2, angle)
    np.testing.assert_allclose(np.linalg.norm(space.nodes, axis=1), 1, rtol=1e-14)
    signs = np.sign(np.round(space.nodes[space.cells], 12))
    crossed = (signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)  # by the planes, inside an element
    assert crossed.any() == (angle > 0)


def test_the_smooth_coupling_hardly_notices_a_turn():
    straight, turned = (
        errors_at_end("icosahedron", 1, 2, 3, 1 / 20, angle=angle) for angle in (0.0, 0.7)
    )
    assert straight["h"] == pytest.approx(turned["h"], rel=1e-12)
    assert straight["x_l2"] == pytest.approx(turned["x_l2"], rel=0.05)


def test_the_lifted_error_contains_that_of_interpolation():
    problem = ec.problems.expanding_sphere()
    space = make_space("octahedron", 2, 2)
    alone = ec.errors.lifted(space, problem, exact_state(space, problem, 1.0))
    e = errors_at_end("octahedron", 2, 2, 5, 1 / 80)
    assert abs(e["u_h1_lifted"] - alone.u_h1) <= 1.1 * e["u_h1"]
    assert e["u_h1_lifted"] > 2 * e["u_h1"]


def test_a_run_that_stops_says_when_and_has_no_errors():
    e = errors_at_end("icosahedron", 2, 2, 2, 1 / 20, "printed")  # quadrature points on the circles
    assert 0 < e["t"] < 1
    assert np.isnan([e["x_l2"], e["u_h1_lifted"], e["slope"]]).all()


def test_the_slope_bounds_the_seminorm():
    e = errors_at_end("octahedron", 1, 2, 3, 1 / 20)
    assert e["x_h1"] ** 2 <= 1.05 * 4 * np.pi * e["slope"] ** 2


def test_the_sides_of_the_theorem_bound_the_errors_at_the_end():
    sides, end = (
        lifted_sides("octahedron", 1, 2, 3, 1 / 20),
        errors_at_end("octahedron", 1, 2, 3, 1 / 20),
    )
    assert sides["u"] > end["u_l2_lifted"]
    for q in "vx":
        assert sides[q] >= np.hypot(end[f"{q}_l2_lifted"], end[f"{q}_h1_lifted"]) * (1 - 1e-12)


def test_sampling_in_time_hardly_changes_the_sides(monkeypatch):
    sampled = lifted_sides("octahedron", 1, 2, 3, 1 / 80)
    monkeypatch.setattr("esfem_core.companion.experiments.expanding_sphere.SAMPLES", 80)
    every = lifted_sides("octahedron", 1, 2, 3, 1 / 80)
    for q in "uvx":
        assert sampled[q] == pytest.approx(every[q], rel=0.05)
    assert sampled["u"] != every["u"]


def test_the_fine_run_is_at_distance_zero_from_itself():
    e = time_errors("octahedron", 0, 2, 1 / 40, [(5, [1 / 40])])
    assert set(e) == {f"p5_{q}" for q in ec.errors.Errors._fields}
    assert all(value == [0.0] for value in e.values())


def test_errors_of_time_alone_are_those_of_the_coupling_that_is_named():
    smooth, printed = (
        time_errors("octahedron", 0, 2, 1 / 40, [(2, [1 / 20])], **named)["p2_v_l2"]
        for named in ({}, {"coupling": "printed"})
    )
    assert printed[0] < smooth[0] / 10  # u is zero on these 18 nodes, and the smooth g feels it


@pytest.mark.parametrize("refinements", [3, 4])
def test_with_the_printed_coupling_errors_of_time_alone_come_to_order_three(refinements):
    (row,) = stored("nick_table_time", coupling="printed", refinements=refinements)
    steps = row.parameters["runs"][0][1]
    for q in ("x_l2", "x_h1", "u_l2", "u_h1"):
        orders = observed_orders(steps, row.results[f"p3_{q}"])
        assert abs(orders[-1] - 3) < 0.25
        assert abs(orders[-1] - 3) < abs(orders[0] - 3)


def test_left_hand_sides_leave_out_starting_states_and_weigh_the_steps_they_look_at():
    space, problem = ec.SurfaceSpace(ec.sphere("octahedron", 0)), ec.problems.growing_sphere()
    states = list(ec.evolve(space, problem, 2, 1 / 8, 1.0))
    seen = []

    def norms(state):
        seen.append(state.t)
        return Norms(x=2 - state.t, v=state.t, u_l2=3.0, u_squared=2.0)

    every = left_hand_sides(states, norms, 1 / 8, 1.0)
    assert seen == [n / 8 for n in range(2, 9)]
    assert every == {"x": 1.75, "v": 1.0, "u": 3 + np.sqrt(7 / 8 * 2)}
    seen.clear()
    third = left_hand_sides(states, norms, 1 / 8, 1.0, every=3)
    assert seen == [2 / 8, 5 / 8, 1.0]
    assert third["u"] == pytest.approx(3 + np.sqrt(9 / 8 * 2), rel=1e-15)


def test_an_unknown_mesh_is_refused():
    with pytest.raises(ValueError, match='mesh must be "octahedron", "icosahedron" or "distance"'):
        make_space("cube", 1, 2)
