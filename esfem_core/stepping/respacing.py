"""Runs that go on with another step or under another law: states to start from."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from esfem_core.checks import Array, items, number, object_of, whole_number
from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.solvers import DirectSolver, Solver, superlu
from esfem_core.stepping.bdf import MOST_STEPS, combine
from esfem_core.stepping.checkpoints import space_of
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.run import SolverName, check_functions, evolve
from esfem_core.stepping.state import Method, State, check_state, known_space
from esfem_core.stepping.times import check_told_apart, later

__all__ = ["respaced", "started_anew"]

MOST = 6  # states that are made for another step, unless an order asks for more
SAME_TIME = 1e-9  # relative to the step
OWN_MASS = 1e-10  # how well, relatively, a product is M(x) w for the positions x of its own state


def respaced(states: Sequence[State], step: float, order: int | None = None) -> list[State]:
    """States with another step between them, to go on with: the last one stays what it is.

    Positions and functions are interpolated in time by polynomials through the states nearest to
    each new time. Of conserved functions w it is the amounts M w that are interpolated, so that
    their sums stay exactly what they are; where M is the mass matrix of the state's own surface
    (mass="updated"), w then solves M(x) w = (interpolated amounts). So from p + 1 states, whose
    interpolation has an error O(tau^{p+1}), a run of order p goes on with its order; p states,
    with O(tau^p), do as well, with larger errors of v in the first steps.

    Parameters
    ----------
    states : sequence of State
        Of one space, in the order of time, not necessarily a step apart. They must reach back
        over the p - 1 new steps before the last one.
    step : float
        The new step.
    order : int, optional
        Order p of the run that goes on: exactly p states are made, from p + 1 of the given ones
        each. If not given, all that the given ones reach back for, six at most, from seven each;
        `evolve` takes the last p.

    Returns
    -------
    list of State
        For ``evolve(..., step=step, start=states)``; v is None in new ones.

    Raises
    ------
    TypeError, ValueError
        If the states do not fit together, or do not reach back far enough, or if the step is lost
        in the rounding of the times.

    Examples
    --------
    A run of order 2 goes on with a third of its step:

    >>> import esfem_core as ec
    >>> space, problem = ec.SurfaceSpace(ec.sphere("octahedron", 2)), ec.problems.growing_sphere()
    >>> states = list(ec.evolve(space, problem, order=2, step=0.3, end=0.9))
    >>> start = ec.respaced(states[-3:], 0.1, order=2)
    >>> [state.t for state in start]
    [0.8, 0.9]
    >>> *_, last = ec.evolve(space, problem, order=2, step=0.1, end=1.0, start=start)
    """
    given = items("states", states, State)
    space = space_of(given)
    step = number("step", step, above=0)
    check_told_apart(given[-1].t, step)
    p = None if order is None else whole_number("order", order, 1, MOST_STEPS)
    nearest = MOST + 1 if p is None else p + 1
    times = [given[-1].t]
    while len(times) < (p or MOST) and later(times[-1], -step) > given[0].t - SAME_TIME * step:
        times.append(later(times[-1], -step))
    if p is not None and len(times) < p:
        raise ValueError(
            f"states must reach back to t = {given[-1].t - (p - 1) * step:g} for order {p} and "
            f"step {step:g}, but the first is of t = {given[0].t:g}: give more of the last states, "
            "or take a smaller step"
        )
    found = [_at_time(space, given, t, step, nearest) for t in reversed(times)]
    return [_for_step(state, given[-1].method, p, step) for state in found]


def started_anew(
    state: State,
    problem: Problem,
    order: int,
    step: float,
    *,
    solver: SolverName | Callable[[], Solver] = "lagged",
    growth: float = 1e12,
) -> list[State]:
    """States to go on with where a law, a force or a coefficient has just changed.

    A run of order p needs p states that obey the same law. Where that changes at a time T, those
    before T do not, and errors are O(tau) for every p. So p - 1 states after T are made from the
    one at T, as at the start of a run: by linearly implicit Euler steps of step/1, ..., step/p,
    extrapolated to order p, with updated mass matrices; p (p + 1)/2 of them for each state. Given
    values, of ``Species(fixed=...)``, are put in place in each.

    Parameters
    ----------
    state : State
        The last one before the change, or any other that knows its space.
    problem : Problem
        What holds from then on. Functions that its law makes, such as the normal and curvature of
        mean curvature flow, are all made where the state lacks one of them: another that it has
        may be a species that is called alike.
    order : int
        Order p of the run that goes on.
    step : float
        Its step.
    solver, growth
        Of the Euler steps, see :func:`esfem_core.evolve`.

    Returns
    -------
    list of State
        At T, T + step, ..., T + (p - 1) step, for ``evolve(..., start=states)``, which yields all
        of them again, the first one included; v is None in new ones. They have the functions of the
        problem, others are left behind.

    Raises
    ------
    TypeError, ValueError, EvolutionError
        As :func:`esfem_core.evolve` does.

    Warns
    -----
    EvolutionWarning
        As :func:`esfem_core.evolve` does, but once, for the longest step.

    Examples
    --------
    A sphere grows like 1 + t until t = 1/2, and then shrinks by its mean curvature, to the radius
    sqrt(9/4 - 4/4) at t = 3/4:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> grows = ec.Problem(u0=1.0, motion=lambda p, t: p * (1 + t))
    >>> *_, state = ec.evolve(space, grows, order=2, step=1 / 80, end=1 / 2)
    >>> shrinks = ec.Problem(species={"u": ec.Species(1.0)}, law=ec.laws.MeanCurvature())
    >>> start = started_anew(state, shrinks, 2, 1 / 80)
    >>> *_, last = ec.evolve(space, shrinks, order=2, step=1 / 80, end=3 / 4, start=start)
    >>> print(f"{np.linalg.norm(last.x, axis=1).mean():.3f} {(9 / 4 - 1) ** 0.5:.3f}")
    1.118 1.118
    """
    check_state(space := known_space(state), state)
    law = object_of("problem", problem, Problem).law
    p, step = whole_number("order", order, 1, MOST_STEPS), number("step", step, above=0)
    fields, own = dict(state.fields), problem.law_species
    if hasattr(law, "initial") and not own.keys() <= fields.keys():
        made = law.initial(state.surface())
        fields |= {name: made[name] for name in own if name in made}
    check_functions("state", problem, replace(state, fields=fields))
    states = [replace(state, fields={name: fields[name] for name in problem.all_species})]
    for _ in range(p - 1):
        t = later(states[-1].t, step)
        found: list[State] = []
        for m in range(1, p + 1):
            start = states[-1:]
            with _silent(bool(found) or len(states) > 1):
                run = evolve(
                    space, problem, 1, step / m, t, start=start, solver=solver, growth=growth
                )
            with _silent(bool(found)):
                *_, euler = run
            found.append(_at(1 / m, euler))
        # The error is a polynomial in the step but for O(tau^{p+1}): its value at step 0.
        states.append(_with_given(problem, replace(_at_time(space, found, 0.0, 1.0, p), t=t)))
    return states


@contextmanager
def _silent(silent: bool) -> Iterator[None]:
    """Without the warnings of a run where another one, with a longer step, has given them."""
    with warnings.catch_warnings():
        if silent:
            warnings.simplefilter("ignore", EvolutionWarning)
        yield


def _with_given(problem: Problem, state: State) -> State:
    """The state with the values in place that Species(fixed=...) gives at its positions."""
    fields = dict(state.fields)
    for name, species in problem.all_species.items():
        if species.fixed is not None:
            nodes = species.fixed.nodes(name, known_space(state))
            fields[name] = w = fields[name].copy()
            w[nodes] = species.fixed.at(name, state.x[nodes], state.t, w.shape[1:])
    return replace(state, fields=fields)


def _at(t: float, s: State) -> State:
    """The state with another number for its time."""
    return State(t, s.x, None, space=s.space, fields=s.fields, products=s.products, method=s.method)


def _for_step(state: State, method: Method | None, order: int | None, step: float) -> State:
    """The state, its products belonging to the method with another step."""
    if method is not None:
        method = (method[0], order or method[1], step)
    if not state.products or state.method == method:
        return state
    return State(
        state.t,
        state.x,
        state.v,
        space=state.space,
        fields=state.fields,
        products=state.products,
        method=method,
    )


def _at_time(
    space: SurfaceSpace, states: Sequence[State], t: float, step: float, nearest: int
) -> State:
    """The state at a time, interpolated through those nearest to it."""
    near = sorted(states, key=lambda s: abs(s.t - t))[:nearest]
    if abs(near[0].t - t) <= SAME_TIME * step:
        return near[0]
    near.sort(key=lambda s: s.t)
    weights = _lagrange(np.array([s.t for s in near]), t)
    x = combine(weights, [s.x for s in near])
    fields, products, M = {}, {}, None
    # Of what no step has computed all is taken for conserved, as by `remeshed`.
    known = any(s.products or s.method is not None for s in near)
    for name in near[0].fields:
        fields[name] = combine(weights, [s[name] for s in near])
        if known and not any(name in s.products for s in near):
            continue  # not conserved
        own = [space.mass_times(s.x, s[name]) for s in near]
        amounts = [s.products.get(name, b) for s, b in zip(near, own, strict=True)]
        products[name] = combine(weights, amounts)
        if all(_close(a, b) for a, b in zip(amounts, own, strict=True)):
            M = space.mass(x) if M is None else M
            solver = DirectSolver(partial(superlu, order=space.elimination_order))
            fields[name] = solver.solve(M, products[name], fields[name])
    return State(t, x, None, space=space, fields=fields, products=products)


def _close(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= OWN_MASS * np.abs(b).max())


def _lagrange(times: Array, t: float) -> list[float]:
    """Weights of the values at some times in the value at t of the polynomial through them.

    Examples
    --------
    >>> _lagrange(np.array([0.0, 1.0, 2.0]), 0.5)
    [0.375, 0.75, -0.125]
    """
    return [float(np.prod([(t - b) / (a - b) for b in times if b != a])) for a in times]
