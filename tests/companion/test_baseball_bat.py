"""The experiments on the baseball bat, on small meshes."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.experiments import baseball_bat as bat
from esfem_core.study import observed_orders

PROBLEM = ec.problems.baseball_bat()


@pytest.fixture(scope="module")
def figure():
    return bat.figure_4(2, 1 / 500, 1 / 20, keep=[0.15, 1.0])


def test_meshes():
    """One family has vertices at the poles and edges on x1 = 0, the other neither."""
    for turned in (False, True):
        x = bat.bat_space(3, 2, turned).nodes
        np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1, atol=1e-14)
        assert (abs(x[:, 0]).max() == 1) is not turned
        assert (np.sum(x[:, 0] == 0) == 64) is not turned


def test_large_steps_start_from_the_reference_before_0_2():
    space = bat.bat_space(1)
    reference = bat.small_steps(space, PROBLEM, 1 / 100, 1 / 20)
    assert [round(20 * s.t, 9) for s in reference] == list(range(21))
    for order, first in [(1, 3), (2, 2), (4, 0), (5, 0)]:
        run = bat.large_steps(space, PROBLEM, order, 1 / 20, reference)
        assert round(20 * run[order].t, 9) == max(order, 4)
        assert round(20 * run[0].t, 9) == first
        assert run[-1].t == pytest.approx(1)
        np.testing.assert_array_equal(run[order - 1].u, reference[first + order - 1].u)


def test_figure_4_against_runs_by_hand(figure):
    space = bat.bat_space(2)
    reference = bat.small_steps(space, PROBLEM, 1 / 500, 1 / 20)
    run = bat.large_steps(space, PROBLEM, 2, 1 / 20, reference)
    M, _ = space.mass_stiffness(run[-1].x)
    e, u = run[-1].u - reference[-1].u, reference[-1].u
    assert figure["times"] == pytest.approx(np.arange(4, 21) / 20)
    assert figure["bdf2"][-1] == pytest.approx(np.sqrt(e @ (M @ e) / (u @ (M @ u))), rel=1e-6)
    assert figure["bdf5"][0] == 0
    assert figure["error_bdf5"][0] == figure["error_reference"][0] > 0
    assert max(figure["drift"], figure["drift_one"]) < 1e-12
    assert figure["mass_one"] == pytest.approx(12, abs=0.2)
    for t, state in [(0.15, reference[3]), (1.0, reference[-1])]:
        again = bat.reference_at(space, figure, t)
        np.testing.assert_array_equal(again.x, state.x)
        np.testing.assert_allclose(again.u, state.u, atol=1.01e-5 / 2 * abs(state.u).max())


def test_errors_have_their_orders():
    steps = [1 / 40, 1 / 80]
    for begin in (0.0, 0.25):
        errors = bat.time_errors(1, 2, steps, begin)
        assert observed_orders(steps, errors["l2"])[0] == pytest.approx(2, abs=0.15)
    coarse, fine = (bat.space_errors(1, True, r, 1 / 40) for r in (3, 4))
    assert coarse["l2"] / fine["l2"] == pytest.approx(4, abs=0.6)
    assert 0 < fine["waist"] < coarse["waist"] < 0.2
    assert 0 < fine["h1_waist"] < fine["h1"]
    assert bat.space_errors(1, False, 2, 1 / 20)["waist"] == 0


def test_run_times():
    result = bat.run_times(1, 1 / 200, 1 / 20, [1, 2], 4)
    assert (result["steps"], result["steps_large"]) == (200, 17)
    for name in ("bdf1", "bdf2"):
        low, middle, high = result[name]
        assert 0 < low <= middle <= high
    assert result["start"] > 0
    assert result["set_up"] > 0
