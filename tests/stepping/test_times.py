"""Times of the steps: rounded once, the same from wherever one counts."""

from fractions import Fraction
from itertools import islice, pairwise

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.stepping.times import count_steps, following, later

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 0))
AT_REST = ec.Problem(motion=lambda p, t: p)


def chain(t, step, n):
    times = [t]
    for _ in range(n):
        times.append(later(times[-1], step))
    return times


@pytest.mark.parametrize("denominator", [3, 7, 10, 40, 160, 1280, 999])
def test_multiples_of_a_fraction_are_the_nearest_numbers_to_them(denominator):
    times = chain(0.0, 1 / denominator, 3 * denominator)
    assert times == [float(Fraction(n, denominator)) for n in range(3 * denominator + 1)]
    assert times[-1] == 3.0


def test_three_tenths():
    assert 0.1 + 0.1 + 0.1 != 0.3
    assert chain(0.0, 0.1, 3)[-1] == 0.3
    assert chain(-0.3, 0.1, 3)[-1] == 0.0


@pytest.mark.parametrize(
    ("start", "step"),
    [
        ("1700000000", "1/1000"),  # seconds since 1970: neighbouring floats are 2.4e-7 apart
        ("-1700000000", "1/3000"),
        ("3400000001/2", "1/10"),
        ("1000000", "1/1000000"),
        ("100000", "1/24"),
    ],
)
def test_late_times_do_not_drift_away_from_those_multiples(start, step):
    start, step = Fraction(start), Fraction(step)
    times = list(islice(following(float(start), float(step)), 3000))
    assert times == [float(start + n * step) for n in range(1, 3001)]
    assert chain(times[1999], float(step), 3)[1:] == times[2000:2003]


@pytest.mark.parametrize("step", [0.1 / 3, np.pi / 100, 1e-9, 2.0**-40, 12345.678])
@pytest.mark.parametrize("start", [0.0, 0.0171, -np.e, 1e6])
def test_each_is_the_last_one_and_a_step_rounded_once(start, step):
    """Never further from the exact sum of both numbers than half the spacing of floats."""
    times = chain(start, step, 100)
    for before, after in pairwise(times):
        assert abs(Fraction(after) - Fraction(before) - Fraction(step)) <= (
            Fraction(np.spacing(abs(before))) / 2
            + Fraction(np.spacing(step)) / 2
            + Fraction(np.spacing(abs(after))) / 2
        )
    assert times[-1] == pytest.approx(start + 100 * step, rel=1e-14)


@pytest.mark.parametrize("step", [0.1, 1 / 3, 1 / 999_983, 0.1 / 3, np.pi / 100, 2.0**-40, 123.456])
@pytest.mark.parametrize("start", [0.0, 0.0171, 0.3, -np.e, 999.9, 1e6, 1e9])
def test_all_that_follow_are_later_one_by_one(start, step):
    assert list(islice(following(start, step), 300)) == chain(start, step, 300)[1:]


@pytest.mark.parametrize(
    ("step", "end"),
    [(0.1, 0.3), (0.1, 0.1 + 0.1 + 0.1), (0.1 / 3, 1.0), (np.pi / 7, np.pi), (0.1, 0.7 + 1e-11)],
)
def test_the_last_time_of_a_run_is_its_end_itself(step, end):
    times = [state.t for state in ec.evolve(SPACE, AT_REST, 2, step, end)]
    assert times[-1] == end
    assert times[:-1] == chain(0.0, step, len(times) - 2)


def test_an_end_at_the_last_starting_state_takes_no_step():
    states = list(ec.evolve(SPACE, AT_REST, 3, 0.1, 0.2))
    assert [state.t for state in states] == [0.0, 0.1, 0.2]
    again = list(ec.evolve(SPACE, AT_REST, 3, 0.1, 0.2, start=states))
    assert [state.t for state in again] == [0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ("start", "step", "end", "expected"),
    [(0.0, 0.1, 0.3, 3), (0.25, 0.05, 1.0, 15), (0.0, 1 / 3, 1.0, 3), (-1.0, 0.5, 1.0, 4)],
)
def test_numbers_of_steps(start, step, end, expected):
    for nudge in (0, 0.5e-9, -0.5e-9):
        assert count_steps(start, step, end * (1 + nudge)) == expected


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((0.0, 0.1, 1.05), ValueError, r"end/step must be an integer, got 1\.05/0\.1 = 10\.5"),
        (
            (0.5, 0.1, 1.05),
            ValueError,
            r"end/step must be an integer, got \(1\.05 - 0\.5\)/0\.1 = 5\.5",
        ),
        ((0.0, 0.1, 1 + 1e-7), ValueError, "end/step must be an integer"),
        ((0.5, 0.1, 0.4), ValueError, r"end must not be before the start at t = 0\.5, got 0\.4"),
        ((0.0, -0.1, 0.4), ValueError, r"step must be a finite number > 0, got -0\.1"),
        (
            (0.0, 1e-300, 1.0),
            ValueError,
            r"step must be larger: end/step is 1e\+300, too many steps, got 1e-3",
        ),
        ((0.0, 0.1, np.inf), ValueError, "end must be a finite number, got inf"),
        ((0.0, 0.1, "1"), TypeError, "end must be a finite number, got '1'"),
        ((0.0, None, 1.0), TypeError, "step must be a finite number > 0, got None"),
    ],
)
def test_numbers_of_steps_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        count_steps(*arguments)


@pytest.mark.parametrize("step", [0.1, 1 / 7, 1e-3])
def test_steps_to_an_end_that_is_rounded_are_counted(step):
    """Seconds since 1970: neighbouring floats are 2.4e-7 apart."""
    assert count_steps(1.7e9, step, 1.7e9 + 20 * step) == 20
    with pytest.raises(ValueError, match="end/step must be an integer"):
        count_steps(1.7e9, step, 1.7e9 + 20.01 * step)


@pytest.mark.parametrize(("start", "step"), [(1e15, 0.1), (1.7e9, 1e-7), (-1e15, 0.1), (0.0, 0.1)])
def test_steps_that_the_times_cannot_hold_are_refused_at_either_end(start, step):
    """Any end would be a whole number of them away, and times would repeat."""
    with pytest.raises(ValueError, match=r"step must be larger against the time, t = -?1.*e\+"):
        count_steps(start, step, start + 2.5 * step if start else 1e14)
    assert count_steps(1e15, 0.25, 1e15 + 1) == 4  # these it holds


def test_a_run_from_a_late_state_with_short_steps_is_refused():
    late = ec.State(1.7e9, SPACE.nodes, None, space=SPACE)
    with pytest.raises(ValueError, match=r"t = 1\.7e\+09, got 1e-07: the times .* not told apart"):
        ec.evolve(SPACE, AT_REST, 1, 1e-7, 1.7e9 + 3e-7, start=[late])


def test_an_end_that_is_later_than_rounding_is_reached_by_no_step():
    """However long the step."""
    assert count_steps(1.0, 1e6, 1 + 0.5e-12) == 0
    with pytest.raises(ValueError, match="end/step must be an integer"):
        count_steps(1.0, 1e6, 1 + 1.5e-12)


@pytest.mark.parametrize("step", [1e-300, 1e-320])
def test_a_step_whose_square_is_no_number_is_refused(step):
    with pytest.raises(ValueError, match="step must be at least 1e-140"):
        count_steps(0.0, step, 2 * step)
