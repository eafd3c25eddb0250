"""Facts that the cases of the expanding sphere's experiments must agree with."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.experiments.expanding_sphere import make_space, run, theorem, time_errors


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_turning_keeps_the_sphere_and_only_turning_leaves_the_planes(angle):
    space = make_space("octahedron", 2, 2, angle)
    np.testing.assert_allclose(np.linalg.norm(space.nodes, axis=1), 1, rtol=1e-14)
    signs = np.sign(np.round(space.nodes[space.cells], 12))
    crossed = (signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)  # by the planes, inside an element
    assert crossed.any() == (angle > 0)


def test_the_smooth_coupling_hardly_notices_a_turn():
    straight, turned = (run("icosahedron", 1, 2, 3, 1 / 20, angle=angle) for angle in (0.0, 0.7))
    assert straight["h"] == pytest.approx(turned["h"], rel=1e-12)
    assert straight["x_l2"] == pytest.approx(turned["x_l2"], rel=0.05)


def test_the_lifted_error_contains_that_of_interpolation():
    problem = ec.problems.expanding_sphere()
    space = make_space("octahedron", 2, 2)
    x = problem.exact.x(space.nodes, 1.0)
    v = problem.exact.v(space.nodes, 1.0)
    interpolant = ec.State(1.0, x, v, problem.exact.u(x, 1.0))
    alone = ec.errors.lifted(space, problem, interpolant)
    e = run("octahedron", 2, 2, 5, 1 / 80)
    assert abs(e["u_h1_lifted"] - alone.u_h1) <= 1.1 * e["u_h1"]
    assert e["u_h1_lifted"] > 2 * e["u_h1"]


def test_a_run_that_stops_says_when_and_has_no_errors():
    e = run("icosahedron", 2, 2, 2, 1 / 20, "printed")  # quadrature points on the circles
    assert 0 < e["t"] < 1
    assert np.isnan([e["x_l2"], e["u_h1_lifted"], e["slope"]]).all()


def test_the_slope_bounds_the_seminorm():
    e = run("octahedron", 1, 2, 3, 1 / 20)
    assert e["x_h1"] ** 2 <= 1.05 * 4 * np.pi * e["slope"] ** 2


def test_the_sides_of_the_theorem_bound_the_errors_at_the_end():
    sides, end = theorem("octahedron", 1, 2, 3, 1 / 20), run("octahedron", 1, 2, 3, 1 / 20)
    assert sides["u"] > end["u_l2_lifted"]
    for q in "vx":
        assert sides[q] >= np.hypot(end[f"{q}_l2_lifted"], end[f"{q}_h1_lifted"]) * (1 - 1e-12)


def test_sampling_in_time_hardly_changes_the_sides(monkeypatch):
    sampled = theorem("octahedron", 1, 2, 3, 1 / 80)
    monkeypatch.setattr("esfem_core.companion.experiments.expanding_sphere.SAMPLES", 80)
    every = theorem("octahedron", 1, 2, 3, 1 / 80)
    for q in "uvx":
        assert sampled[q] == pytest.approx(every[q], rel=0.05)
    assert sampled["u"] != every["u"]


def test_the_fine_run_is_at_distance_zero_from_itself():
    e = time_errors("octahedron", 0, 2, 1 / 40, [(5, [1 / 40])])
    assert set(e) == {f"p5_{q}" for q in ec.errors.Errors._fields}
    assert all(value == [0.0] for value in e.values())
