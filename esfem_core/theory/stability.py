"""Errors that chosen defects and starting errors cause ([N] Section 4)."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping import State, evolve
from esfem_core.theory.defects import Defects, defects, interpolant

__all__ = ["response"]

Array = NDArray[np.float64]


def response(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    step: float,
    end: float,
    chosen: Callable[[int], Defects],
    start: Sequence[tuple[Array, Array]] | None = None,
) -> Iterator[tuple[State, State]]:
    """Run the scheme such that (4.2)-(4.4) hold with chosen defects.

    The defects that the exact values have are put into the scheme, and the chosen ones are taken
    away. What then separates the computed from the exact values is the answer of the scheme to the
    chosen defects and starting errors alone. So a stability estimate like [N] Proposition 1 can be
    tested with any defects, and the exact values need not solve an equation.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With exact values. With a prescribed motion, only ``chosen(n).u`` counts.
    order : int
    step, end : float
        As for :func:`esfem_core.evolve`.
    chosen : callable
        ``chosen(n)`` are the defects of step n = p, p + 1, ..., in the sense of [N] (4.1):
        M d_u, M d_v and d_x.
    start : sequence of p pairs (e_x, e_u), optional
        Starting errors, (N, 3) and of the shape of u; none if not given.

    Yields
    ------
    computed, exact : State
        At t = 0, step, ..., end.

    Raises
    ------
    ValueError
        If the problem has no exact values, `start` does not hold p pairs, or as `evolve` does.

    Examples
    --------
    A defect in x in the last step moves the nodes against it by tau/delta_0:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
    >>> def chosen(n):
    ...     zero = np.zeros_like(space.nodes)
    ...     return Defects(zero[:, 0], zero, space.nodes if n == 8 else zero)
    >>> problem = ec.problems.expanding_sphere()
    >>> *_, (computed, exact) = response(space, problem, 2, 1 / 16, 0.5, chosen)
    >>> e_x, e_v = computed.x - exact.x, computed.v - exact.v
    >>> bool(np.allclose(e_x, (e_v - space.nodes) / 16 / 1.5))
    True
    """
    if start is not None and len(start) != order:
        raise ValueError(f"start must hold p = {order} pairs (e_x, e_u), got {len(start)}")
    states = [interpolant(space, problem, n * step) for n in range(order)]
    if start is not None:
        states = [
            State(s.t, s.x + e_x, None, s.u + e_u)
            for s, (e_x, e_u) in zip(states, start, strict=True)
        ]

    def perturbation(n: int) -> tuple[Array, Array, Array]:
        own, wanted = defects(space, problem, order, step, n), chosen(n)
        return own.u - wanted.u, own.v - wanted.v, own.x - wanted.x

    run = evolve(
        space, problem, order, step, end, start=states, solver="direct", perturbation=perturbation
    )
    for state in run:
        yield state, interpolant(space, problem, state.t)
