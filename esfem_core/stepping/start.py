"""Starting values: exact ones, or of order p by extrapolated Euler steps."""

from collections.abc import Iterator, Sequence

from esfem_core.checks import Array, finite_array, mapping, number, object_of
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping.guard import Guard
from esfem_core.stepping.scheme import Scheme, naming_the_step
from esfem_core.stepping.state import State

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
    TypeError, ValueError
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
    object_of("space", space, SurfaceSpace)
    t = number("t", t)
    exact = object_of("problem", problem, Problem).exact
    if exact is None:
        raise ValueError(
            "problem must have an exact solution, but has none: Problem(..., exact=Exact(...))"
        )
    x, v, fields = exact.nodal(space.nodes, t)
    return State(t, x, v, space=space, fields=fields)


def exact_starts(space: SurfaceSpace, problem: Problem, times: Sequence[float]) -> Iterator[State]:
    """Exact states at some times, without velocities."""
    for t in times:
        state = exact_state(space, problem, t)
        fields = {name: state[name] for name in problem.all_species}
        yield State(t, state.x, None, space=space, fields=fields)


def initial_state(space: SurfaceSpace, problem: Problem) -> State:
    """The initial values on the initial surface."""
    values = problem.initial_values(space.nodes)
    if len(values) < len(problem.all_species):
        values |= _made_by(problem.law, space)
    for name in problem.all_species:
        if name not in values:
            raise ValueError(
                f"{name!r} must have initial values, but its Species has None and the law makes "
                "none: Species(initial, ...)"
            )
    fields = {name: values[name] for name in problem.all_species}
    return State(0.0, space.nodes, None, space=space, fields=fields)


def _made_by(law: object, space: SurfaceSpace) -> Values:
    """Initial values of its functions that a law makes."""
    if not hasattr(law, "initial"):
        return {}
    made = mapping("what law.initial returns", law.initial(Surface(space, space.nodes)), "values")
    values = {}
    for key, given in made.items():
        called, n = f"the initial {key!r} of law", len(space.nodes)
        w = finite_array(called, given, (n, "..."))
        values[key] = w if w.ndim == 1 else finite_array(called, w, (n, "m"))
    return values


def euler_states(
    scheme: Scheme, times: Sequence[float], step: float, guard: Guard
) -> Iterator[State]:
    """Starting values of order p: Euler with step/1, ..., step/p, extrapolated to step 0.

    The error of a one-step method has an expansion in powers of the step. Euler with updated mass
    matrices is one; (2.19), with M(x^{n-1}) in step n but M(x^0) in both step 0 and step 1, is not.
    Of a conserved species it is the amounts M(x) u that are extrapolated, so that their sum stays
    what it is.

    Parameters
    ----------
    scheme : Scheme
        With ``mass="updated"``.
    times : sequence of p floats
        0, step, ..., (p - 1) step.
    step : float
    guard : Guard

    Yields
    ------
    State
        At these times, each when it is known.
    """
    order = len(times)
    last = initial_state(scheme.space, scheme.problem)
    yield last
    for n, end in enumerate(times[1:], start=1):
        rows: list[Values] = []  # Aitken-Neville, one row per number of substeps
        for m in range(1, order + 1):
            parts = ((n, last.t + i * step / m) for i in range(1, m))
            *_, euler = scheme.steps(scheme.history(1, step / m, [last]), (*parts, (n, end)), guard)
            row = [{"x": euler.x, **euler.fields, **euler.products}]
            for i, old in enumerate(rows, start=1):
                ratio = m / (m - i) - 1
                new = row[-1]
                row.append({key: new[key] + (new[key] - old[key]) / ratio for key in new})
            rows = row
        with naming_the_step(n, end):
            last = _state(scheme, end, rows[-1], euler)
            guard.look_at_surface(last.x)
            guard.warn_of_folds(last.x, scheme.space)
            guard.look_at_functions(last.x, last.fields)
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
