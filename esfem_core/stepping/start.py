"""Starting values: exact ones, or of order p by extrapolated Euler steps."""

from collections.abc import Iterator

from esfem_core.checks import Array, number
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping.guard import Guard
from esfem_core.stepping.scheme import Scheme
from esfem_core.stepping.state import State
from esfem_core.stepping.times import later

__all__ = ["euler_states", "exact_starts", "exact_state", "initial_state"]

Values = dict[str, Array]


def exact_state(space: SurfaceSpace, problem: Problem, t: float) -> State:
    """Exact values x_*(t), v_*(t), u_*(t) at the nodes.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution.
    t : float

    Returns
    -------
    State

    Raises
    ------
    ValueError
        If the problem has no exact solution.

    Examples
    --------
    >>> import numpy as np
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    >>> state = exact_state(space, ec.problems.expanding_sphere(), 0.5)
    >>> print(f"{np.linalg.norm(state.x, axis=1).max():.2f}")
    1.50
    """
    t = number("t", t)
    if problem.exact is None:
        raise ValueError("this needs a problem with an exact solution: Problem(..., exact=...)")
    x, v, fields = problem.exact.nodal(space.nodes, t)
    return State(t, x, v, space=space, fields=fields)


def exact_starts(space: SurfaceSpace, problem: Problem, order: int, step: float) -> Iterator[State]:
    """Exact states at 0, step, ..., (order - 1) step, without velocities."""
    t = 0.0
    for _ in range(order):
        state = exact_state(space, problem, t)
        fields = {name: state[name] for name in problem.all_species}
        yield State(t, state.x, None, space=space, fields=fields)
        t = later(t, step)


def initial_state(space: SurfaceSpace, problem: Problem) -> State:
    """The initial values on the initial surface."""
    values = problem.initial_values(space.nodes)
    if len(values) < len(problem.all_species):
        values |= problem.law.initial(Surface(space, space.nodes))
    fields = {name: values[name] for name in problem.all_species}
    return State(0.0, space.nodes, None, space=space, fields=fields)


def euler_states(scheme: Scheme, order: int, step: float, guard: Guard) -> Iterator[State]:
    """Starting values of order p: Euler with step/1, ..., step/p, extrapolated to step 0.

    The error of a one-step method has an expansion in powers of the step. Euler with updated mass
    matrices is one; (2.19), with M(x^{n-1}) in step n but M(x^0) in both step 0 and step 1, is not.
    Of a conserved species it is the amounts M(x) u that are extrapolated, so that their sum stays
    what it is.

    Parameters
    ----------
    scheme : Scheme
        With ``mass="updated"``.
    order : int
        p.
    step : float
    guard : Guard

    Yields
    ------
    State
        At 0, step, ..., (p - 1) step, each when it is known.
    """
    last = initial_state(scheme.space, scheme.problem)
    yield last
    for n in range(1, order):
        end = later(last.t, step)
        rows: list[Values] = []  # Aitken-Neville, one row per number of substeps
        for m in range(1, order + 1):
            times = ((n, last.t + i * step / m) for i in range(1, m))
            *_, euler = scheme.steps(1, step / m, [last], (*times, (n, end)), guard)
            row = [{"x": euler.x, **euler.fields, **euler.products}]
            for i, old in enumerate(rows, start=1):
                ratio = m / (m - i) - 1
                new = row[-1]
                row.append({key: new[key] + (new[key] - old[key]) / ratio for key in new})
            rows = row
        last = _state(scheme, end, rows[-1], euler)
        yield last


def _state(scheme: Scheme, t: float, values: Values, near: State) -> State:
    """The state with these positions and functions, amounts for conserved ones; one is near."""
    space, x = scheme.space, values["x"]
    fields, M = {}, None
    for name, species in scheme.problem.all_species.items():
        fields[name] = values[name]
        if species.conserved:
            M = space.mass(x) if M is None else M
            fields[name] = scheme.systems.solve("start", M, values[name], near[name])
        fields[name] = scheme.fixed(name, x, t, fields[name])
    return State(t, x, None, space=space, fields=fields)
