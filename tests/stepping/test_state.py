"""States: what they hold, that nobody can change it, and what is no state of a space."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.stepping import check_state

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
X = SPACE.nodes
N = len(X)
PROBLEM = ec.Problem(
    species={"a": ec.Species(1.0), "b": ec.Species(lambda x: x, conserved=False)},
    law=ec.laws.Regularised(g=lambda at: at["a"]),
)
RUN = list(ec.evolve(SPACE, PROBLEM, 2, 0.1, 0.4))


def arrays(state):
    yield from (("x", state.x), ("v", state.v))
    yield from state.fields.items()
    yield from ((f"products of {name}", w) for name, w in state.products.items())


def test_runs_yield_all_functions_and_the_products_of_conserved_ones():
    last = RUN[-1]
    assert list(last.fields) == ["a", "b"]
    assert list(last.products) == ["a"]
    np.testing.assert_array_equal(last.products["a"], SPACE.mass(last.x) @ last["a"])
    assert last.space is SPACE
    assert repr(last) == "State(t=0.4, nodes=66, fields: a, b)"
    assert [state.v is None for state in RUN] == [True, True, False, False, False]
    assert all(not state.products for state in RUN[:2])


@pytest.mark.parametrize("start", ["exact", "euler"])
@pytest.mark.parametrize("mass", ["updated", "extrapolated", "reassembled"])
def test_what_a_run_yields_cannot_be_written_to(start, mass):
    problem = ec.problems.growing_sphere()
    for state in ec.evolve(SPACE, problem, 3, 0.1, 0.5, start=start, mass=mass):
        for name, array in arrays(state):
            if array is None:
                continue
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
            with pytest.raises(ValueError, match="read-only"):
                array += 1
            base = array
            while isinstance(base, np.ndarray):  # nor through what it is a view of
                assert not base.flags.writeable, name
                base = base.base
        for mapping in (state.fields, state.products):
            with pytest.raises(TypeError, match="does not support item assignment"):
                mapping["u"] = X[:, 0]
        with pytest.raises(dataclasses.FrozenInstanceError):
            state.t = 2.0
        with pytest.raises(AttributeError):
            state.u = X[:, 0]


def test_the_first_state_is_not_the_space():
    first = RUN[0]
    np.testing.assert_array_equal(first.x, X)
    with pytest.raises(ValueError, match="read-only"):
        first.x[0] = 1


def test_given_arrays_are_copied_if_somebody_could_write_to_them():
    x, u, product = X.copy(), np.ones(N), np.ones(N)
    view = x.view()
    view.setflags(write=False)
    for given in (x, view, x[:]):
        state = ec.State(0.0, given, given, u, products={"u": product})
        x[0] += 1
        u[0] = product[0] = 7
        assert not np.array_equal(state.x, x)
        assert not np.array_equal(state.v, x)
        assert (state.u[0], state.products["u"][0]) != (7, 7)
        u[0] = product[0] = 1
    assert x.flags.writeable
    assert u.flags.writeable
    x.setflags(write=False)
    assert ec.State(0.0, x).x is x  # nothing is copied twice
    assert ec.State(0.0, X).x is X


def test_the_species_u_is_short_for_a_field():
    state = ec.State(0.5, X, u=X[:, 0], fields={"w": X})
    assert list(state.fields) == ["w", "u"]
    assert state.u is state["u"] is state.fields["u"]
    assert (state.v, state.space, dict(state.products)) == (None, None, {})
    np.testing.assert_array_equal(state["w"], X)
    assert repr(ec.State(1, X)) == "State(t=1, nodes=66, fields: none)"
    given = {"w": X}
    state = ec.State(0.5, X, fields=given)
    given["z"] = X
    assert list(state.fields) == ["w"]


def test_replaced_fields():
    last = RUN[-1]
    other = dataclasses.replace(last, t=3.0, fields=last.fields | {"a": np.zeros(N)})
    assert (other.t, last.t) == (3.0, 0.4)
    assert not other["a"].any()
    assert other["b"] is last["b"]
    assert other.x is last.x


def test_pickles_keep_every_bit_and_are_read_only():
    for state in (RUN[0], RUN[-1]):
        kept = {"fields": state.fields, "products": state.products, "method": state.method}
        again = pickle.loads(pickle.dumps(ec.State(state.t, state.x, state.v, **kept)))
        assert again.method == state.method
        assert again.t == state.t
        assert again.space is None
        assert list(again.fields) == list(state.fields)
        assert list(again.products) == list(state.products)
        for (name, ours), (_, theirs) in zip(arrays(again), arrays(state), strict=True):
            np.testing.assert_array_equal(ours, theirs, err_msg=name)
            assert ours is None or not ours.flags.writeable


def test_copies_are_states_with_the_same_values():
    for state in RUN[0], RUN[-1]:
        flat, deep = copy.copy(state), copy.deepcopy(state)
        for again in (flat, deep):
            assert (again.t, again.method) == (state.t, state.method)
            for (name, ours), (_, theirs) in zip(arrays(again), arrays(state), strict=True):
                np.testing.assert_array_equal(ours, theirs, err_msg=name)
                assert ours is None or not ours.flags.writeable
            with pytest.raises(TypeError, match="does not support item assignment"):
                again.fields["u"] = X[:, 0]
        assert (flat.x is state.x, flat.space is state.space) == (True, True)
        assert not np.shares_memory(deep.x, state.x)
        assert not np.shares_memory(deep["a"], state["a"])
        assert deep.space is not state.space
        np.testing.assert_array_equal(deep.space.nodes, SPACE.nodes)


def test_pickles_and_copies_keep_the_class():
    class Own(ec.State):
        """A state with something more to tell."""

    own = Own(0.5, X, u=X[:, 0])
    assert type(copy.deepcopy(own)) is Own
    assert copy.copy(own).u is own.u


def test_measures_come_back_from_another_process_and_are_read_only():
    m = ec.measure(RUN[-1])
    again = pickle.loads(pickle.dumps(m))
    assert (again.area, list(again.amounts)) == (m.area, list(m.amounts))
    np.testing.assert_array_equal(again.centre, m.centre)
    with pytest.raises(TypeError, match="does not support item assignment"):
        again.amounts["u"] = 0.0


def test_pickles_keep_the_space():
    again = pickle.loads(pickle.dumps(RUN[-1]))
    np.testing.assert_array_equal(again.space.cells, SPACE.cells)
    start = pickle.loads(pickle.dumps(RUN[-2:]))
    one, two = (
        list(ec.evolve(space, PROBLEM, 2, 0.1, 0.6, start=states, solver="direct"))[-1]
        for space, states in ((SPACE, RUN[-2:]), (start[0].space, start))
    )
    for (name, ours), (_, theirs) in zip(arrays(two), arrays(one), strict=True):
        np.testing.assert_array_equal(ours, theirs, err_msg=name)


def test_its_surface_has_all_functions():
    last = RUN[-1]
    at = last.surface()
    assert (at.space, at.t) == (SPACE, 0.4)
    np.testing.assert_array_equal(at.x, last.x)
    np.testing.assert_array_equal(at["b"], SPACE.evaluate(last["b"]))
    assert at.integral(at["a"]) == pytest.approx(RUN[0].surface().integral(1.0), rel=1e-12)
    with pytest.raises(
        ValueError, match=r"state must know its space, but has none: State\(\.\.\., space=space"
    ):
        ec.State(0.0, X).surface()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"t": None}, TypeError, "t must be a finite number, got None"),
        ({"t": np.nan}, ValueError, "t must be a finite number, got nan"),
        ({"x": X[:, :2]}, ValueError, r"x must have shape \(N, 3\), got \(66, 2\)"),
        ({"x": None}, TypeError, r"x must hold real numbers, got object \(None\)"),
        ({"v": X[:, 0]}, ValueError, r"v must have shape \(66, 3\), got \(66,\)"),
        ({"v": 1j * X}, TypeError, "v must hold real numbers, got complex128"),
        ({"u": 1.0}, ValueError, r"u must have shape \(66, \.\.\.\), got \(\)"),
        ({"u": X[:, :0]}, ValueError, r"u must have at least one component, got shape \(66, 0\)"),
        ({"fields": {"w": ["a"]}}, TypeError, "w must hold real numbers, got <U1"),
        (
            {"products": {"w": 2.0}},
            ValueError,
            r"products\['w'\] must have shape \(66, \.\.\.\), got \(\)",
        ),
        (
            {"u": X, "fields": {"u": X}},
            ValueError,
            "u must be given once, but is given as u and in fields",
        ),
    ],
)
def test_arrays_that_make_no_state_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.State(**({"t": 0.0, "x": X} | arguments))


def test_lists_are_arrays_too():
    state = ec.State(0.0, X.tolist(), u=[1] * N, products={"u": [1.0] * N})
    np.testing.assert_array_equal(state.x, X)
    assert state.u.dtype == state.products["u"].dtype == float


def test_functions_that_are_not_there_are_named():
    with pytest.raises(KeyError, match="the state has no function 'u', only 'a', 'b'"):
        RUN[-1].u  # noqa: B018
    with pytest.raises(KeyError, match="the state has no function 'w', only none"):
        ec.State(0.0, X)["w"]


@pytest.mark.parametrize(
    ("state", "error", "message"),
    [
        ({"t": 0.0}, TypeError, r"start\[0\] must be a State, got \{'t': 0\.0\}"),
        (
            ec.State(0.0, X[1:]),
            ValueError,
            r"start\[0\]\.x must have shape \(66, 3\), got \(65, 3\)",
        ),
        (
            ec.State(0.0, np.full((N, 3), np.inf)),
            ValueError,
            r"start\[0\]\.x must be finite, but .* is inf",
        ),
        (
            ec.State(0.0, X, fields={"w": np.zeros((N, 2, 2))}),
            ValueError,
            r"start\[0\]\['w'\] must have shape \(66,\) or \(66, m\), got \(66, 2, 2\)",
        ),
        (
            ec.State(0.0, X, fields={"w": np.full(N, np.nan)}),
            ValueError,
            r"start\[0\]\['w'\] must be finite, but start\[0\]\['w'\]\[0\] is nan",
        ),
        (
            ec.State(0.0, 1e160 * X),
            ValueError,
            r"start\[0\]\.x must have coordinates up to 1e\+75, but point 0 is \[.*1e\+160",
        ),
        (
            ec.State(0.0, X, u=X[:, 0], products={"u": np.full(N, np.inf)}),
            ValueError,
            r"start\[0\]\.products\['u'\] must be finite, but .*\[0\] is inf",
        ),
        (
            ec.State(0.0, X, u=X[:, 0], products={"u": X}),
            ValueError,
            r"start\[0\]\.products\['u'\] belongs to no function",
        ),
        (
            ec.State(0.0, X, u=X[:, 0], products={"w": X[:, 0]}),
            ValueError,
            r"start\[0\]\.products\['w'\] belongs to no function",
        ),
    ],
)
def test_what_is_no_state_of_the_space_is_refused(state, error, message):
    with pytest.raises(error, match=message):
        check_state(SPACE, state, "start[0]")


def test_errors_of_runs_say_when_and_keep_what_they_know():
    error = ec.EvolutionError("it broke", 7, 0.35, 12)
    assert str(error) == "step 7, t = 0.35: it broke"
    assert (error.reason, error.step, error.t, error.element) == ("it broke", 7, 0.35, 12)
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.element) == (str(error), 12)
    assert ec.EvolutionError("it broke", 7, 0.35).element is None


def test_a_changed_state_has_no_products_of_the_old_one():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    *_, last = ec.evolve(space, ec.problems.growing_sphere(), 1, 0.1, 0.2)
    assert set(last.products) == {"u"}
    doubled = dataclasses.replace(last, fields={"u": 2 * last.u})
    assert (dict(doubled.products), doubled.method) == ({}, None)
    assert doubled.space is space


def test_a_state_with_further_functions_keeps_all_else():
    last = RUN[-1]
    more = last.with_functions({"w": X[:, 0]})
    assert list(more.fields) == ["a", "b", "w"]
    assert (more.t, more.method, more.space) == (last.t, last.method, last.space)
    np.testing.assert_array_equal(more.products["a"], last.products["a"])
    np.testing.assert_array_equal(more.v, last.v)
    other = more.with_functions({"a": X[:, 1]})
    assert list(other.fields) == ["a", "b", "w"]
    assert not other.products
    with pytest.raises(TypeError, match="functions must be a mapping from names"):
        last.with_functions(X)
    with pytest.raises(ValueError, match=r"w must have shape \(66, \.\.\.\), got \(65,\)"):
        last.with_functions({"w": X[1:, 0]})


def test_arrays_of_a_state_have_one_row_for_each_node():
    with pytest.raises(ValueError, match=r"^v must have shape \(66, 3\), got \(5, 3\)"):
        ec.State(0.0, X, X[:5])
    with pytest.raises(ValueError, match=r"^u must have shape \(66, \.\.\.\), got \(5, 3\)"):
        ec.State(0.0, X, u=X[:5])


def test_the_mesh_size_is_that_of_the_present_surface():
    state = ec.State(0.0, 2 * X, space=SPACE)
    assert ec.measure(state).h == pytest.approx(2 * SPACE.mesh_size(X), rel=1e-14)
