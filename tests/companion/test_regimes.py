"""Curves of rows, and where the temporal error dominates, for errors that are known."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from esfem_core.companion.campaign import convergence
from esfem_core.companion.figures import error_curves, slope_fan
from esfem_core.companion.regimes import MARGIN, curve, floor, orders_in_time, where_space_begins
from esfem_core.output import COLOURS
from esfem_core.study import Row

SPACE = 1e-6
STEPS = [4 * 2**i for i in range(8)]
ROWS = [
    Row({"order": p, "steps_per_unit": n}, {"l2": n**-p + SPACE}, {})
    for p in (1, 5)
    for n in reversed(STEPS)
]


def test_a_curve_begins_with_the_largest_step_whatever_the_order_of_the_rows():
    steps, errors = curve(ROWS, "l2", order=1)
    assert steps.tolist() == [1 / n for n in STEPS]
    assert np.all(np.diff(errors) < 0)
    assert [a.size for a in curve(ROWS, "l2", order=2)] == [0, 0]


def test_orders_are_read_only_where_the_temporal_error_dominates():
    assert floor(ROWS, "l2") == pytest.approx(SPACE, rel=1e-3)
    orders = orders_in_time(ROWS, "l2", 5)
    assert len(orders) == sum(n**-5 > MARGIN * SPACE for n in STEPS) - 1
    assert np.all(abs(orders - 5) < 0.1)
    assert len(orders_in_time(ROWS, "l2", 1)) == len(STEPS) - 1


def test_space_begins_where_it_has_half_of_the_error():
    assert where_space_begins(ROWS, "l2", 1) is None
    assert where_space_begins(ROWS, "l2", 5) == max(1 / n for n in STEPS if n**-5 < SPACE)


def test_the_floor_needs_a_row_of_bdf5():
    with pytest.raises(LookupError, match=r"there is no row of BDF5 with \{'degree': 3\}"):
        floor(ROWS, "l2", degree=3)


def test_rows_of_two_curves_are_not_taken_for_one():
    with pytest.raises(ValueError, match=r"one for each step, but two have step 0\.25: another"):
        curve(ROWS, "l2")
    two = [Row({**row.parameters, "mesh": m}, row.results, {}) for m in "ab" for row in ROWS]
    with pytest.raises(ValueError, match=r"but two have order = 5, step 0\.25: another parameter"):
        floor(two, "l2")
    assert floor(two, "l2", mesh="a") == floor(ROWS, "l2")
    with pytest.raises(KeyError, match="rows have no result 'h1', only 'l2'"):
        curve(ROWS, "h1", order=1)


def test_every_curve_is_drawn_also_where_the_colours_come_to_their_end():
    ax = Figure().subplots()
    many = {f"curve {i}": {"order": 1} for i in range(len(COLOURS) + 2)}
    error_curves(ax, ROWS, "l2", many)
    assert [line.get_label() for line in ax.get_lines()] == list(many)


def test_lines_of_reference_need_a_curve():
    with pytest.raises(ValueError, match="axes must have curves already"):
        slope_fan([Figure().subplots()], 1e-3, [(1, 2)])


def test_a_table_takes_its_sizes_from_parameters_or_results():
    rows = [Row({"step": 0.5}, {"h": h, "u": h**2, "x": h**3}, {}) for h in (0.2, 0.1)]
    table = convergence(rows, "h", "x")
    assert list(table.errors) == ["x"]
    assert table.orders("x") == pytest.approx([3])
    with pytest.raises(ValueError, match="rows must hold at least one row, got none"):
        convergence([], "h")
