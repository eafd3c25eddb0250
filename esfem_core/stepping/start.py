"""Starting values: exact ones, or of order p by extrapolated Euler steps."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping.state import State

__all__ = ["euler_states", "exact_state"]

Array = NDArray[np.float64]
March = Callable[..., Iterator[State]]


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
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    >>> state = exact_state(space, ec.problems.expanding_sphere(), 0.5)
    >>> print(f"{np.linalg.norm(state.x, axis=1).max():.2f}")
    1.50
    """
    if problem.exact is None:
        raise ValueError("this needs a problem with an exact solution: Problem(..., exact=...)")
    x = np.array(problem.exact.x(space.nodes, t), dtype=float)
    v, u = problem.exact.v(space.nodes, t), problem.exact.u(x, t)
    return State(t, x, np.array(v, dtype=float), np.array(u, dtype=float))


def euler_states(
    space: SurfaceSpace, problem: Problem, order: int, step: float, steps: March
) -> list[State]:
    """Starting values of order p: Euler with step/1, ..., step/p, extrapolated to step 0.

    The error of a one-step method has an expansion in powers of the step. Euler with updated mass
    matrices is one; (2.19), with M(x^{n-1}) in step n but M(x^0) in both step 0 and step 1, is not.
    """
    states = [State(0.0, space.nodes.copy(), None, problem.initial_values(space.nodes))]
    for n in range(1, order):
        last = states[-1]
        rows: list[tuple[Array, Array]] = []  # Aitken-Neville, one row per number of substeps
        for m in range(1, order + 1):
            times = ((n, last.t + (i + 1) * step / m) for i in range(m))
            *_, euler = steps(1, step / m, [last], times, "updated")
            x, u = euler.x, euler.u
            row = [(x, u)]
            for i, (x_old, u_old) in enumerate(rows, start=1):
                ratio = m / (m - i) - 1
                x, u = x + (x - x_old) / ratio, u + (u - u_old) / ratio
                row.append((x, u))
            rows = row
        states.append(State(n * step, x, None, u))
    return states
