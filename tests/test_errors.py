"""Norms and errors of known functions."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import csr_array

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("icosahedron", 3), 2, ec.to_unit_sphere)
PROBLEM = ec.problems.expanding_sphere()


def with_u(state, u, **changes):
    return dataclasses.replace(state, fields={"u": u}, **changes)


def exact_state(t):
    x = PROBLEM.exact.x(SPACE.nodes, t)
    return ec.State(t, x, PROBLEM.exact.v(SPACE.nodes, t), PROBLEM.exact.u(x, t))


def test_exact_values_have_no_error():
    assert max(ec.errors.compare(SPACE, PROBLEM, exact_state(0.3))) < 1e-15


def test_what_is_not_there_has_no_error_that_could_be_taken_for_none():
    state = ec.State(0.3, exact_state(0.3).x, None, fields={})
    lifted = ec.errors.lifted(SPACE, PROBLEM, state)
    assert np.isnan([lifted.v_l2, lifted.v_h1, lifted.u_l2, lifted.u_h1]).all()
    assert 0 <= lifted.x_l2 < 1e-3


def test_a_known_perturbation():
    """Norms of eps x1 on a sphere of radius r: eps sqrt(4 pi/3) r^2 and eps sqrt(8 pi/3) r."""
    state, eps = exact_state(0.3), 1e-3
    r = np.linalg.norm(state.x[0])
    errors = ec.errors.compare(
        SPACE,
        PROBLEM,
        ec.State(
            0.3, state.x + eps * state.x[:, :1] * [[0, 0, 1]], None, state.u + eps * state.x[:, 0]
        ),
    )
    for name in ("x", "u"):
        assert getattr(errors, f"{name}_l2") == pytest.approx(
            eps * np.sqrt(4 * np.pi / 3) * r**2, rel=1e-4
        )
        assert getattr(errors, f"{name}_h1") == pytest.approx(
            eps * np.sqrt(8 * np.pi / 3) * r, rel=1e-3
        )
    assert np.isnan([errors.v_l2, errors.v_h1]).all()


def test_errors_are_measured_on_the_exact_surface_however_far_the_state_is():
    """e_x = id and e_u = x3 on the unit sphere; the state is a sphere of radius two."""
    x = SPACE.nodes
    state, exact = ec.State(0.0, 2 * x, None, x[:, 2]), ec.State(0.0, x, None, 0 * x[:, 2])
    resting = ec.Exact(lambda p, t: p.copy(), lambda p, t: 0 * p, lambda x, t: 0 * x[:, 0])
    problem = ec.Problem(0.0, exact=resting)
    for e in (ec.errors.difference(SPACE, state, exact), ec.errors.compare(SPACE, problem, state)):
        assert [e.x_l2, e.x_h1] == pytest.approx(np.sqrt([4 * np.pi, 8 * np.pi]), rel=1e-4)
        assert [e.u_l2, e.u_h1] == pytest.approx(np.sqrt([4 * np.pi / 3, 8 * np.pi / 3]), rel=1e-4)


def test_several_components_add_up():
    M, _ = SPACE.mass_stiffness(SPACE.nodes)
    w = np.random.default_rng(0).standard_normal((len(SPACE.nodes), 3))
    single = [ec.errors.seminorm(M, w[:, i]) for i in range(3)]
    assert ec.errors.seminorm(M, w) == pytest.approx(np.linalg.norm(single), rel=1e-14)


def test_a_seminorm_of_a_constant_is_zero_and_not_nan():
    """Rounding, which is of either sign, is that of the constant and not of the small products."""
    for refinements in (1, 2, 3):
        space = ec.SurfaceSpace(ec.sphere("icosahedron", refinements), 2, ec.to_unit_sphere)
        _, A = space.mass_stiffness(space.nodes)
        for c in (*np.linspace(0.1, 3, 40), 7.0):
            assert 0 <= ec.errors.seminorm(A, np.full(len(space.nodes), c)) < 1e-5


def test_only_rounding_makes_a_negative_square_zero():
    matrix = csr_array(np.diag([1.0, -1.0]))
    assert ec.errors.seminorm(matrix, np.array([1.0, 1 + 1e-10])) == 0
    with pytest.raises(ValueError, match="matrix must be positive semidefinite"):
        ec.errors.seminorm(matrix, np.array([1.0, 1 + 1e-6]))


def test_problems_without_what_an_error_needs_are_refused():
    problem = ec.Problem(u0=lambda x: x[:, 0])
    with pytest.raises(ValueError, match="problem must have an exact solution"):
        ec.errors.compare(SPACE, problem, exact_state(0.0))
    with pytest.raises(ValueError, match="closest points and origins"):
        ec.errors.lifted(SPACE, problem, exact_state(0.0))
    without = dataclasses.replace(PROBLEM, exact=PROBLEM.exact._replace(origin=None))
    with pytest.raises(ValueError, match="closest points and origins"):
        ec.errors.lifted(SPACE, without, exact_state(0.0))


def test_a_space_that_is_not_the_initial_surface_is_refused():
    """Nodes of new triangles lie on the present surface, those of a larger sphere nowhere."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    new = ec.remeshed(ec.State(0.3, PROBLEM.exact.x(space.nodes, 0.3), None, space=space), 0.4)
    large = ec.SurfaceSpace(ec.sphere("octahedron", 1).apply_scale(2))
    for state in (new, ec.State(0.3, large.nodes, None, space=large)):
        for measure in (ec.errors.compare, ec.errors.lifted):
            with pytest.raises(ValueError, match=r"exact must belong .* new .* remeshed\(states"):
                measure(state.space, PROBLEM, state)


def test_whether_a_space_is_the_initial_surface_is_asked_once():
    asked = []

    def closest(x, t):
        asked.append(t)
        return PROBLEM.exact.closest(x, t)

    exact = ec.Exact(*PROBLEM.exact[:3], closest)
    problem = ec.Problem(0.0, exact=exact)
    for t in (0.1, 0.2, 0.3):
        ec.errors.compare(SPACE, problem, exact_state(t))
    assert asked == [0.0]


def test_states_at_different_times_are_refused():
    with pytest.raises(ValueError, match=r"at the time of state, t = 0\.1, but is at 0\.2"):
        ec.errors.difference(SPACE, exact_state(0.1), exact_state(0.2))


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_states_are_at_the_same_time_in_any_unit(unit):
    state = exact_state(0.3)
    one, same, other = (
        dataclasses.replace(state, t=unit * t) for t in (0.3, 0.1 + 0.1 + 0.1, 0.3 + 1e-9)
    )
    assert max(ec.errors.difference(SPACE, one, same)) == 0
    with pytest.raises(ValueError, match="reference must be at the time of state"):
        ec.errors.difference(SPACE, one, other)


def test_a_column_is_not_broadcast_against_a_vector():
    state, n = exact_state(0.3), len(SPACE.nodes)
    column = with_u(state, state.u[:, None])
    exact_column = PROBLEM.exact._replace(u=lambda x, t: PROBLEM.exact.u(x, t)[:, None])
    problem = dataclasses.replace(PROBLEM, exact=exact_column)
    with pytest.raises(ValueError, match=rf"got \({n},\) and \({n}, 1\)"):
        ec.errors.compare(SPACE, problem, state)
    with pytest.raises(ValueError, match=rf"got \({n}, 1\) and \({n},\)"):
        ec.errors.compare(SPACE, PROBLEM, column)
    with pytest.raises(ValueError, match=rf"of reference .*, got \({n},\) and \({n}, 1\)"):
        ec.errors.difference(SPACE, state, column)
    with pytest.raises(
        ValueError, match=r"exact\.u\(x, t\) must have shape \(\d+,\), got \(\d+, 1\)"
    ):
        ec.errors.lifted(SPACE, problem, state)
    with pytest.raises(ValueError, match=r"exact\.u\(x, t\) must have shape \(\d+, 1\)"):
        ec.errors.lifted(SPACE, PROBLEM, column)


@pytest.mark.parametrize("measure", [ec.errors.compare, ec.errors.lifted])
def test_what_is_no_state_of_the_space_is_refused(measure):
    state, n = exact_state(0.3), len(SPACE.nodes)
    for other, message in [
        (
            ec.State(state.t, state.x[1:]),
            rf"state\.x must have shape \({n}, 3\), got \({n - 1}, 3\)",
        ),
        (
            with_u(state, np.zeros((n, 2, 2))),
            rf"state\.u must have shape \({n},\) or \({n}, m\), got \({n}, 2, 2\)",
        ),
        (with_u(state, np.where(np.arange(n) == 7, np.nan, 1.0)), r"state\.u\[7\] is nan"),
    ]:
        with pytest.raises(ValueError, match=message):
            measure(SPACE, PROBLEM, other)
    with pytest.raises(TypeError, match="state must be a State, got 0"):
        measure(SPACE, PROBLEM, 0)


def test_a_square_that_is_positive_needs_no_product_to_judge_its_rounding(monkeypatch):
    M, _ = SPACE.mass_stiffness(SPACE.nodes)
    monkeypatch.setattr(csr_array, "__abs__", None)
    for w in (SPACE.nodes, 0 * SPACE.nodes):
        assert ec.errors.seminorm(M, w) == pytest.approx(np.sqrt(np.sum(w * (M @ w))))


def test_a_seminorm_wants_a_row_for_each_of_the_matrix():
    M, _ = SPACE.mass_stiffness(SPACE.nodes)
    with pytest.raises(ValueError, match=r"w must have shape \(2562, \.\.\.\), got \(3, 2562\)"):
        ec.errors.seminorm(M, SPACE.nodes.T)


@pytest.mark.parametrize("size", [2.0**300, 2.0**1000, 2.0**1023])
def test_seminorms_of_huge_vectors_are_those_of_small_ones(size):
    M, A = SPACE.mass_stiffness(SPACE.nodes)
    w = SPACE.nodes[:, 0] / 8
    for matrix in (M, A):
        assert ec.errors.seminorm(matrix, size * w) == size * ec.errors.seminorm(matrix, w)


class TestNormsOverARun:
    RUN = tuple(exact_state(t) for t in (0.0, 0.1, 0.2, 0.3))

    def norms(self, states, window=(0.0, 0.3), measure=ec.errors.compare):
        return ec.errors.time_norms(SPACE, PROBLEM, states, window, measure)

    def test_they_are_the_largest_error_and_a_sum_of_squares(self):
        errors = iter([1.0, 3.0, 2.0, 5.0])

        def measure(space, problem, state):
            return ec.errors.Errors(0, 0, 0, 0, u_l2=(e := next(errors)), u_h1=2 * e)

        found = self.norms(self.RUN, (0.0, 0.25), measure)
        assert found == pytest.approx((3.0, np.sqrt(0.1 * 4 * (1 + 9 + 4))))

    def test_starting_states_are_not_counted(self):
        start = with_u(self.RUN[0], self.RUN[0].u + 1, v=None)
        assert max(self.norms([start, *self.RUN[1:]])) < 1e-15

    @pytest.mark.parametrize("where", [1, 3])
    def test_nan_is_not_hidden(self, where):
        def measure(space, problem, state):
            bad = state is self.RUN[where]
            return ec.errors.Errors(*[np.nan if bad else 1.0] * 6)

        assert np.isnan(self.norms(self.RUN, measure=measure)).all()
        states = list(self.RUN)
        states[where] = with_u(states[where], np.nan * states[where].u)
        with pytest.raises(ValueError, match="must be finite, but state"):
            self.norms(states)

    @pytest.mark.parametrize(
        ("states", "message"),
        [
            ((RUN[0], RUN[1], RUN[3]), "got steps of 0.1 and 0.2"),
            ((*RUN[:2], dataclasses.replace(RUN[2], t=0.201)), "got steps of 0.1 and 0.101"),
            (RUN[::-1], "got steps of -0.1 and -0.1"),
            ((RUN[1], RUN[1]), "got steps of 0 and 0"),
            (RUN[1:2], "states must hold two states or more, got one"),
            ((), "window must hold a step after the starting states"),
        ],
    )
    def test_what_is_no_run_is_refused(self, states, message):
        with pytest.raises(ValueError, match=message):
            self.norms(states)

    def test_squares_that_no_float_can_hold_are_infinite(self):
        huge = ec.errors.Errors(*[1e200] * 6)
        assert self.norms(self.RUN, measure=lambda *given: huge) == (1e200, np.inf)

    @pytest.mark.parametrize("found", [1.0, None, (1.0, 2.0), np.ones(6)])
    def test_a_measure_returns_errors(self, found):
        message = "what measure returns must be an Errors, got "
        with pytest.raises(TypeError, match=message):
            self.norms(self.RUN, measure=lambda space, problem, state: found)

    @pytest.mark.parametrize(("t", "step"), [(0.0, 1e-10), (1.7e9, 0.1), (1.7e9, 1 / 7)])
    def test_a_window_holds_its_steps_however_short_and_late_they_are(self, t, step):
        run = [dataclasses.replace(self.RUN[1], t=t + n * step) for n in range(11)]
        ones = ec.errors.Errors(*[1.0] * 6)
        found = self.norms(run, (t + 5 * step, t + 6 * step), lambda *given: ones)
        assert found == pytest.approx((1, np.sqrt(2 * step)), rel=1e-5)

    @pytest.mark.parametrize(("window", "steps"), [((0.0, 0.3), 4), ((0.3, 0.7), 5)])
    def test_a_window_ends_with_its_last_step_in_spite_of_rounding(self, window, steps):
        """3 * 0.1 and 7 * 0.1 are larger than the numbers that are meant."""
        run = [dataclasses.replace(self.RUN[1], t=n * 0.1) for n in range(11)]
        assert run[3].t > 0.3
        ones = ec.errors.Errors(*[1.0] * 6)
        assert self.norms(run, window, lambda *given: ones) == pytest.approx(
            (1, np.sqrt(0.1 * steps))
        )

    def test_an_empty_window_is_refused(self):
        with pytest.raises(ValueError, match="window must hold a step after the starting states"):
            self.norms(self.RUN, (0.31, 0.39))
        with pytest.raises(ValueError, match=r"window must have shape \(2,\), got \(3,\)"):
            self.norms(self.RUN, (0.0, 0.1, 0.2))


@pytest.mark.parametrize("value", ["a", np.ones(2), -1.0])
def test_entries_of_what_measure_returns_are_numbers(value):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    problem = ec.problems.growing_sphere()
    states = ec.evolve(space, problem, order=1, step=0.1, end=0.2)

    def measure(space, problem, state):
        return ec.errors.Errors(*5 * [0.0], value)

    with pytest.raises((TypeError, ValueError), match="u_h1 of what measure returns must be"):
        ec.errors.time_norms(space, problem, states, (0.0, 1.0), measure)


def test_runs_on_two_meshes_are_compared_at_points():
    coarse = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    ends = [list(ec.evolve(space, PROBLEM, 2, 0.05, 0.1))[-1] for space in (SPACE, coarse)]
    with pytest.raises(ValueError, match=r"two meshes .*state\.space\.probe\(state\.x, state\.u, "):
        ec.errors.difference(SPACE, *ends)
    points = ends[1].x[:20]
    one, other = (s.space.probe(s.x, s.u, points) for s in ends)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-3)
