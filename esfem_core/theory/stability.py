"""Errors that chosen defects and starting errors cause ([N] Section 4)."""

from collections.abc import Callable, Iterator, Sequence

from esfem_core.checks import Array, finite_array, number, whole_number
from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping import State, evolve, exact_state
from esfem_core.theory.defects import Defects, defects

__all__ = ["response"]


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
    TypeError, ValueError
        If the problem has no exact values, `start` does not hold p pairs of the right shapes, or
        as `evolve` does, at the call; if chosen defects have the wrong shape, in their step.

    Examples
    --------
    A defect in x in the last step moves the nodes against it by tau/delta_0:

    >>> import numpy as np
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
    order, step = whole_number("order", order, 1), number("step", step, above=0)
    states = [exact_state(space, problem, n * step) for n in range(order)]
    if start is not None:
        if len(start) != order:
            raise ValueError(f"start must hold p = {order} pairs (e_x, e_u), got {len(start)}")
        states = [_perturbed(s, *e, n) for n, (s, e) in enumerate(zip(states, start, strict=True))]

    def perturbation(n: int) -> tuple[Array, Array, Array]:
        own, wanted = defects(space, problem, order, step, n), chosen(n)
        rest = [
            a - finite_array(f"chosen({n}).{name}", getattr(wanted, name), a.shape)
            for name, a in own._asdict().items()
        ]
        return rest[0], rest[1], rest[2]

    run = evolve(
        space,
        problem,
        order,
        step,
        end,
        mass="extrapolated",
        start=states,
        solver="direct",
        perturbation=perturbation,
    )
    return ((state, exact_state(space, problem, state.t)) for state in run)


def _perturbed(exact: State, e_x: Array, e_u: Array, n: int) -> State:
    """Starting values with errors."""
    e_x = finite_array(f"start[{n}]: e_x", e_x, exact.x.shape)
    e_u = finite_array(f"start[{n}]: e_u", e_u, exact.u.shape)
    return State(exact.t, exact.x + e_x, None, exact.u + e_u)
