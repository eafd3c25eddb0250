"""Tables of errors and observed orders."""

import copy
import pickle
import warnings

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.errors import Errors
from esfem_core.study import (
    ConvergenceTable,
    final,
    observed_orders,
    space_study,
    time_study,
)


def test_observed_orders_of_powers():
    h = np.array([1, 0.5, 0.3, 0.1])
    np.testing.assert_allclose(observed_orders(h, 7 * h**2.5), 2.5, rtol=1e-12)


def test_zero_missing_and_infinite_errors_have_no_order_and_no_warning():
    orders = observed_orders([0.8, 0.4, 0.2, 0.1, 0.05], [4, 1, 0, np.nan, 1])
    np.testing.assert_array_equal(orders, [2, np.nan, np.nan, np.nan])
    assert np.isnan(observed_orders([0.2, 0.1], [0, 0])).all()
    orders = observed_orders([0.8, 0.4, 0.2, 0.1], [np.inf, np.inf, 4, 1])
    np.testing.assert_allclose(orders, [np.nan, np.nan, 2], rtol=1e-14)
    table = ConvergenceTable("h", [0.2, 0.1], {"x": [0.0, 0.0], "v": [np.nan, 1.0]})
    assert [line.split() for line in str(table).split("\n")[1:]] == [
        ["0.2", "0.00e+00", "–"],
        ["0.1", "0.00e+00", "–", "1.00e+00", "–"],
    ]


@pytest.mark.parametrize(
    ("sizes", "values", "message"),
    [
        ([0.2, 0.1], [1.0], r"must have shape \(2,\), got \(1,\)"),
        ([0.2, 0.1], [[1.0], [2.0]], r"must have shape \(2,\), got \(2, 1\)"),
        ([0.2, 0.2], [1.0, 2.0], "sizes must be positive, neighbours different"),
        ([0.2, 0.0], [1.0, 2.0], "sizes must be positive"),
        ([0.2, np.nan], [1.0, 2.0], r"sizes must be finite, but sizes\[1\] is nan"),
        ([0.2, 0.1], [1.0, -1.0], "values must not be negative"),
    ],
)
def test_sizes_and_values_without_orders_are_refused(sizes, values, message):
    with pytest.raises(ValueError, match=message):
        observed_orders(sizes, values)


def test_a_table_shows_values_that_have_no_order():
    rows = [{"volume": v} for v in (4e-2, -1e-2, 4e-3, 1e-3, 1e-3)]
    table = ec.study.ConvergenceTable.of("h", [0.4, 0.2, 0.1, 0.05, 0.05], rows)
    np.testing.assert_allclose(table.orders("volume"), [np.nan, np.nan, 2, np.nan], rtol=1e-12)
    assert [line.split()[1:] for line in str(table).splitlines()[1:]] == [
        ["4.00e-02"],
        ["-1.00e-02", "–"],
        ["4.00e-03", "–"],
        ["1.00e-03", "2.00"],
        ["1.00e-03", "–"],
    ]


def test_long_names_stand_above_their_columns():
    rows = [{"volume of the inside": 4e-2}, {"volume of the inside": 1e-2}]
    lines = str(ec.study.ConvergenceTable.of("refinements", [0.4, 0.2], rows)).splitlines()
    assert lines == [
        "refinements  volume of the inside      order",
        "        0.4              4.00e-02           ",
        "        0.2              1.00e-02       2.00",
    ]


def test_the_final_state_is_the_last_of_a_run():
    assert final(ec.State(t, np.zeros((4, 3))) for t in range(3)).t == 2
    with pytest.raises(ValueError, match="states must hold at least one"):
        final([])


def test_table_shows_sizes_errors_and_orders():
    table = ConvergenceTable("h", np.array([0.2, 0.1]), {"u_l2": np.array([4e-3, 1e-3])})
    assert str(table).split() == [
        "h",
        "u_l2",
        "order",
        "0.2",
        "4.00e-03",
        "0.1",
        "1.00e-03",
        "2.00",
    ]
    html = table._repr_html_()
    assert html.count("<tr>") == 3
    assert "<td>2.00</td>" in html
    assert table.select("u_l2").errors.keys() == {"u_l2"}
    with pytest.raises(KeyError):
        table.select("w")


def test_a_table_is_made_of_rows():
    rows = [Errors(*range(6)), Errors(*range(1, 7))]
    table = ConvergenceTable.of("tau", [0.2, 0.1], rows)
    assert list(table.errors) == list(Errors._fields)
    np.testing.assert_array_equal(table["v_l2"], [2, 3])
    table = ConvergenceTable.of("tau", [0.2, 0.1], [{"a": 1, "b": 2}, {"a": 3, "b": 4}])
    np.testing.assert_array_equal(table["b"], [2, 4])
    with pytest.raises(ValueError, match=r"must have shape \(3,\), got \(2,\)"):
        ConvergenceTable.of("tau", [0.4, 0.2, 0.1], rows)
    with pytest.raises(ValueError, match=r"rows must all have the names \['a', 'b'\]"):
        ConvergenceTable.of("tau", [0.2, 0.1], [{"a": 1, "b": 2}, {"b": 4, "a": 3}])
    with pytest.raises(ValueError, match="at least one row"):
        ConvergenceTable.of("tau", [], [])


def test_sizes_of_a_table_are_positive_and_none_is_masked():
    for size in (-1.0, 0.0):
        with pytest.raises(ValueError, match=r"sizes must be positive, got \[1.0, "):
            ConvergenceTable("h", [1.0, size], {"a": [1.0, 2.0]})
    with pytest.raises(TypeError, match="sizes must hold real numbers, got a masked array"):
        ConvergenceTable.of("h", np.ma.masked_array([1.0, 2.0], [0, 1]), [{"a": 1}, {"a": 2}])


def test_one_error_of_several_tables_stands_side_by_side():
    one = ConvergenceTable("tau", [0.2, 0.1], {"x": [4, 2], "u": [1, 1]})
    two = ConvergenceTable("tau", [0.2, 0.1], {"x": [4, 1]})
    joined = ConvergenceTable.join({"p = 1": one, "p = 2": two}, "x")
    assert list(joined.errors) == ["p = 1", "p = 2"]
    assert [joined.orders(name)[0] for name in joined.errors] == pytest.approx([1, 2])
    assert ConvergenceTable.join({"": one}, "u").parameter == "tau"
    with pytest.raises(KeyError, match="u"):
        ConvergenceTable.join({"p = 1": one, "p = 2": two}, "u")
    others = ConvergenceTable("tau", [0.2, 0.05], {"x": [4, 1]})
    for table in (others, ConvergenceTable("h", [0.2, 0.1], {"x": [4, 1]})):
        with pytest.raises(ValueError, match="must have the same sizes, 'p = 2' has others"):
            ConvergenceTable.join({"p = 1": one, "p = 2": table}, "x")
    with pytest.raises(ValueError, match="tables must hold at least one table to join, got none"):
        ConvergenceTable.join({}, "x")


SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
GROWING = ec.problems.growing_sphere()
FINE = list(ec.evolve(SPACE, GROWING, 4, 1 / 160, 0.5, start="euler", solver="direct"))


class TestAStudyAgainstAFineRun:
    STEPS = (1 / 20, 1 / 40)

    def study(self, fine=FINE, steps=STEPS, end=0.5, **options):
        return time_study(SPACE, GROWING, 2, steps, end, fine=fine, solver="direct", **options)

    def test_each_run_starts_with_states_of_it_and_is_compared_with_its_last(self):
        table = self.study()
        for n, tau in enumerate(self.STEPS):
            every = round(160 * tau)
            start = [FINE[0], FINE[every]]
            run = ec.evolve(SPACE, GROWING, 2, tau, 0.5, start=start, solver="direct")
            row = ec.errors.difference(SPACE, final(run), FINE[-1])
            assert [table[name][n] for name in Errors._fields] == list(row)
        assert table.orders("x_l2") == pytest.approx([2], abs=0.1)

    def test_runs_begin_where_it_begins(self):
        late = self.study(FINE[16:])
        assert (late["x_l2"] != self.study()["x_l2"]).all()
        start = FINE[16::8][:2]
        run = ec.evolve(SPACE, GROWING, 2, 1 / 20, 0.5, start=start, solver="direct")
        assert late["x_l2"][0] == ec.errors.difference(SPACE, final(run), FINE[-1]).x_l2

    def test_nothing_is_left_of_the_same_method_with_the_same_step(self):
        table = time_study(SPACE, GROWING, 4, [1 / 160], 0.5, fine=FINE, solver="direct")
        assert max(e.max() for e in table.errors.values()) == 0

    def test_what_does_not_fit_is_refused(self):
        for bad in (0.01, 0.5 / 27):  # 2.96 steps
            with pytest.raises(
                ValueError, match=rf"multiples of the step 0\.00625 of fine, got {bad:g}"
            ):
                self.study(steps=[0.05, bad])
        with pytest.raises(ValueError, match=r"fine must end at t = 1, but ends at t = 0\.5"):
            self.study(end=1.0)
        with pytest.raises(ValueError, match="fine must hold at least 2"):
            self.study(fine=[])
        with pytest.raises(ValueError, match="fine must hold at least 2"):
            self.study(fine=FINE[-1:])
        for options in ({"start": "euler"}, {"reference": FINE[-1]}):
            with pytest.raises(ValueError, match="gives the reference and the starting values"):
                self.study(**options)


def test_studies_of_nothing_are_refused():
    with pytest.raises(ValueError, match="steps must hold at least one"):
        time_study(SPACE, GROWING, 2, [], 0.5)
    with pytest.raises(ValueError, match="spaces must hold at least one"):
        space_study([], GROWING, 2, 0.1, 0.5)
    with pytest.raises(ValueError, match=r"steps must have shape \(n,\), got \(\)"):
        time_study(SPACE, GROWING, 2, 0.1, 0.5)


def test_warnings_of_the_runs_of_a_study_show_the_line_that_calls_it():
    small = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    without_alpha = ec.Problem(law=ec.laws.Regularised(alpha=0.0, beta=0.01))
    fast = ec.Problem(1.0, diffusivity=1e12, motion=lambda p, t: p)
    still = 0 * small.nodes
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        time_study(small, GROWING, 6, [1 / 16], 0.5)
        for problem, order in ((without_alpha, 4), (fast, 1)):
            values = dict.fromkeys(problem.species, still[:, 0])
            last = ec.State(0.25, small.nodes, still, **values)
            time_study(small, problem, order, [1 / 16], 0.25, last, start="euler")
    said = " ".join(str(one.message) for one in found)
    assert all(text in said for text in ("BDF6", "unstable for p = 4", "rounding takes"))
    assert {one.filename for one in found} == {__file__}


def test_studies_refuse_before_they_compute():
    def solver():
        raise AssertionError("a run has begun")

    bat = ec.problems.baseball_bat()
    with pytest.raises(ValueError, match="problem must have an exact solution to compare with"):
        time_study(SPACE, bat, 2, [0.1], 0.5, solver=solver)
    with pytest.raises(ValueError, match="problem must have an exact solution to compare with"):
        space_study([SPACE], bat, 2, 0.1, 0.5, solver=solver)
    with pytest.raises(ValueError, match="end/step must be an integer"):
        time_study(SPACE, GROWING, 2, [0.1, 0.3], 0.5, solver=solver)
    with pytest.raises(ValueError, match="mesh sizes of spaces must be positive, neighbours diff"):
        space_study([SPACE, SPACE], ec.problems.expanding_sphere(), 2, 0.1, 0.5, solver=solver)
    with pytest.raises(ValueError, match=r"reference must end at t = 0\.5, but ends at t = 0\.3"):
        time_study(SPACE, GROWING, 2, [0.1], 0.5, reference=FINE[48], solver=solver)
    later = ec.State(9e-10, SPACE.nodes, None, SPACE.nodes[:, 0])
    with pytest.raises(ValueError, match=r"reference must end at t = 5e-10, but ends at t = 9e-10"):
        time_study(SPACE, GROWING, 2, [1e-10], 5e-10, reference=later, solver=solver)
    coarse = ec.SurfaceSpace(ec.sphere("icosahedron", 0))
    other = ec.State(0.5, coarse.nodes, None, coarse.nodes[:, 0], space=coarse)
    with pytest.raises(ValueError, match="reference must be a state of this space"):
        time_study(SPACE, GROWING, 2, [0.1], 0.5, reference=other, solver=solver)
    for given in ({"reference": FINE[-1]}, {"fine": FINE}):
        with pytest.raises(ValueError, match="measure compares with the exact solution: leave it"):
            time_study(SPACE, GROWING, 2, [0.1], 0.5, measure=print, solver=solver, **given)
    uneven = [FINE[0], FINE[16], *FINE[24:]]
    with pytest.raises(ValueError, match=r"fine must have a constant step, but t = 0\.15 is no mu"):
        time_study(SPACE, GROWING, 2, [0.1], 0.5, fine=uneven, solver=solver)


def test_a_fine_run_may_come_as_it_is_computed():
    given = time_study(SPACE, GROWING, 2, [1 / 20], 0.5, fine=FINE)
    assert (
        time_study(SPACE, GROWING, 2, [1 / 20], 0.5, fine=iter(FINE))["u_l2"] == given["u_l2"]
    ).all()


def test_a_measure_that_returns_no_errors_is_told():
    with pytest.raises(TypeError, match="what measure returns must be a mapping from names to num"):
        time_study(SPACE, GROWING, 1, [0.25], 0.5, measure=lambda *given: None, reference=None)


def test_no_caller_changes_a_table():
    sizes, errors = np.array([0.2, 0.1]), np.array([4.0, 1.0])
    table = ConvergenceTable("h", sizes, {"x": errors})
    sizes[0] = errors[0] = 7
    assert str(table).splitlines()[1].split() == ["0.2", "4.00e+00"]
    for again in (table, copy.deepcopy(table)):
        for array in (again.sizes, again["x"]):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 7
        with pytest.raises(TypeError, match="does not support item assignment"):
            again.errors["x"] = array


def test_a_table_is_equal_to_itself_only_and_can_be_pickled():
    table, other = (ConvergenceTable("h", [0.2, 0.1], {"x": [4, 1]}) for _ in range(2))
    assert table != other
    assert len({table, other, table}) == 2
    for again in (pickle.loads(pickle.dumps(table)), copy.copy(table), copy.deepcopy(table)):
        assert str(again) == str(table)
        assert not again.sizes.flags.writeable


def test_rows_tables_and_names_that_are_none_are_told():
    table = ConvergenceTable("h", [0.2, 0.1], {"x": [4, 1]})
    for row in (3, Errors):
        message = r"rows\[0\] must be a mapping from names to numbers, got (3|the class Errors)"
        with pytest.raises(TypeError, match=message):
            ConvergenceTable.of("h", [1], [row])
    with pytest.raises(TypeError, match=r"tables\['a'\] must be a ConvergenceTable, got 3"):
        ConvergenceTable.join({"a": 3}, "x")
    for ask in (table.select, table.orders, table.__getitem__):
        with pytest.raises(KeyError, match="the table has no error 'y', only 'x'"):
            ask("y")


def test_an_order_that_rounds_to_zero_has_no_sign():
    table = ConvergenceTable.of("h", [0.2, 0.1], [{"area": 1.0}, {"area": 1.001}])
    assert str(table).split()[-1] == "0.00"
    assert table.orders("area")[0] < 0


def test_lifted_errors_without_closest_points_are_refused_before_a_run():
    called = []

    def f(at):
        called.append(at.t)
        return np.zeros(at.density.shape)

    exact = ec.Exact(lambda p, t: p.copy(), lambda p, t: 0 * p, lambda x, t: np.ones(len(x)))
    rest = ec.laws.Prescribed(motion=lambda p, t: p.copy())
    problem = ec.Problem(1.0, f=f, law=rest, exact=exact)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    for refused in (
        lambda: ec.study.time_study(space, problem, 1, [0.5, 0.25], 1.0, measure=ec.errors.lifted),
        lambda: ec.study.space_study([space], problem, 1, 0.5, 1.0, measure=ec.errors.lifted),
    ):
        with pytest.raises(ValueError, match=r"measure=lifted needs .* closest points and origins"):
            refused()
    assert called == []
