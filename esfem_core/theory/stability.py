"""Errors that chosen defects and starting errors cause ([N] Section 4)."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import (
    Array,
    finite_array,
    flag,
    function,
    iterable,
    number,
    object_of,
    shown,
    whole_number,
)
from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.solvers import superlu
from esfem_core.stepping import State, check_state, evolve, exact_state
from esfem_core.theory.defects import (
    Defects,
    constant_diffusivity,
    defects,
    dual_norm,
    velocity_law,
)

__all__ = ["ErrorTerms", "error_terms", "proposition_1", "response"]

MOST_ORDER = 6  # what evolve runs without further ado


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
        With exact values and the law of [N]. (Where the motion is prescribed, v is a quotient of
        exact positions, and its error is no answer to a defect.)
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
        If the problem has no exact values or is not that of [N], `start` does not hold p pairs
        of the right shapes, or as `evolve` does, at the call; if chosen defects have the wrong
        shape, in their step.

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
    order, step = whole_number("order", order, 1, MOST_ORDER), number("step", step, above=0)
    function("chosen", chosen, "of the number of a step")
    constant_diffusivity(problem)
    velocity_law(problem)
    if start is not None:
        start = _checked_start(order, start)
    states = [exact_state(space, problem, n * step) for n in range(order)]
    if start is not None:
        states = [_perturbed(s, *e, n) for n, (s, e) in enumerate(zip(states, start, strict=True))]

    def perturbation(n: int) -> tuple[Array, Array, Array]:
        own = defects(space, problem, order, step, n)
        wanted = object_of(f"chosen({n})", chosen(n), Defects)
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


def _checked_start(order: int, start: object) -> Sequence[tuple[Array, Array]]:
    """Refuse what is no sequence of pairs."""
    pairs = list(iterable("start", start, f"p = {order} pairs (e_x, e_u)"))
    if len(pairs) != order:
        raise ValueError(f"start must hold p = {order} pairs (e_x, e_u), got {len(pairs)}")
    for n, pair in enumerate(pairs):
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise TypeError(f"start[{n}] must be a pair (e_x, e_u), got {shown(pair)}")
    return pairs


def _perturbed(exact: State, e_x: Array, e_u: Array, n: int) -> State:
    """Starting values with errors."""
    e_x = finite_array(f"start[{n}]: e_x", e_x, exact.x.shape)
    e_u = finite_array(f"start[{n}]: e_u", e_u, exact.u.shape)
    return State(exact.t, exact.x + e_x, None, exact.u + e_u)


@dataclass(frozen=True, eq=False)
class ErrorTerms:
    """Errors and defects of a run, and the squared norms of which [N] Section 4 speaks.

    Attributes
    ----------
    order : int
    step : float
    computed, exact : tuple of State
        At t = 0, step, ...
    defects : tuple of Defects or None
        None for the starting values.
    K : tuple of (N, N) sparse arrays
        M + A at the exact positions.
    errors : dict of str to float arrays
        "x" and "v", (n, N, 3), and "u", of which v is zero in the starting values.
    squares : dict of str to (n,) float arrays
        "x", "v", "u": squares of the K-norms of the errors; "u_mass", "u_stiffness": of the norms
        of u with M and with A; "d_x": of the K-norm of d_x; "d_v", "d_u": of the dual norms.
    """

    order: int
    step: float
    computed: tuple[State, ...]
    exact: tuple[State, ...]
    defects: tuple[Defects | None, ...]
    K: tuple[csr_array, ...]
    errors: dict[str, Array]
    squares: dict[str, Array]


def error_terms(
    space: SurfaceSpace,
    pairs: Iterable[tuple[State, State]],
    order: int,
    step: float,
    chosen: Callable[[int], Defects | None],
) -> ErrorTerms:
    """Collect errors and norms of what :func:`response` yields.

    Parameters
    ----------
    space : SurfaceSpace
    pairs : iterable of (State, State)
        Computed and exact states.
    order : int
    step : float
    chosen : callable
        The defects, as given to :func:`response`; None where there are none.

    Returns
    -------
    ErrorTerms

    Raises
    ------
    TypeError, ValueError
        If the pairs are not more than p or no states of this space with a "u" of one shape, their
        times are not `step` apart, or `chosen` returns neither defects of their shapes nor None.

    Examples
    --------
    A defect in x in the last step causes errors of x and v there, and none before:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
    >>> zero, problem = np.zeros_like(space.nodes), ec.problems.expanding_sphere()
    >>> def chosen(n):
    ...     return Defects(zero[:, 0], zero, 1e-5 * space.nodes * (n == 8))
    >>> pairs = response(space, problem, 2, 1 / 16, 0.5, chosen)
    >>> terms = error_terms(space, pairs, 2, 1 / 16, chosen)
    >>> bool(terms.squares["d_x"][-1] > 0), not terms.squares["d_x"][:-1].any()
    (True, True)
    >>> [bool(terms.squares[q][:-1].max() < 1e-20 < terms.squares[q][-1]) for q in ("x", "v")]
    [True, True]
    """
    order, step = whole_number("order", order, 1, MOST_ORDER), number("step", step, above=0)
    function("chosen", chosen, "of the number of a step")
    computed, exact = _checked_pairs(space, pairs, order, step)
    given = tuple(
        _checked_defects(n, chosen(n), exact[n]) if n >= order else None for n in range(len(exact))
    )
    matrices = [space.mass_stiffness(s.x) for s in exact]
    K = tuple(M + A for M, A in matrices)
    e_x = np.array([s.x - ex.x for s, ex in zip(computed, exact, strict=True)])
    e_u = np.array([s.u - ex.u for s, ex in zip(computed, exact, strict=True)])
    e_v = np.zeros_like(e_x)
    for n in range(order, len(exact)):
        e_v[n] = cast(Array, computed[n].v) - cast(Array, exact[n].v)
    squares = {
        "x": [_square(k, e) for k, e in zip(K, e_x, strict=True)],
        "v": [_square(k, e) for k, e in zip(K, e_v, strict=True)],
        "u": [_square(k, e) for k, e in zip(K, e_u, strict=True)],
        "u_mass": [_square(M, e) for (M, _), e in zip(matrices, e_u, strict=True)],
        "u_stiffness": [_square(A, e) for (_, A), e in zip(matrices, e_u, strict=True)],
    }
    of_defects = np.array([_defect_squares(k, d) for k, d in zip(K, given, strict=True)]).T
    squares |= zip(("d_x", "d_v", "d_u"), of_defects, strict=True)
    return ErrorTerms(
        order,
        step,
        computed,
        exact,
        given,
        K,
        {"x": e_x, "v": e_v, "u": e_u},
        {name: np.array(values) for name, values in squares.items()},
    )


def _checked_pairs(
    space: SurfaceSpace, pairs: object, order: int, step: float
) -> tuple[tuple[State, ...], tuple[State, ...]]:
    """Computed and exact states; refuses what is no run of this order and step."""
    computed: list[State] = []
    exact: list[State] = []
    for n, pair in enumerate(iterable("pairs", pairs, "(State, State)")):
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise TypeError(f"pairs[{n}] must be a pair (computed, exact), got {shown(pair)}")
        first = exact[0] if exact else object_of("pairs[0][1]", pair[1], State)
        for i, state in enumerate(pair):
            name = f"pairs[{n}][{i}]"
            check_state(space, state, name)
            if "u" not in state.fields:
                raise ValueError(f'{name} must have values of "u", but has none')
            wanted = first.fields.get("u", state.u).shape  # (N, 1) minus (N,) would be (N, N)
            if state.u.shape != wanted:
                raise ValueError(
                    f"all u of pairs must have one shape, got {name}.u of shape "
                    f"{state.u.shape} and pairs[0][1].u of {wanted}"
                )
            if n >= order and state.v is None:
                raise ValueError(f"{name} must have a velocity, but has none")
            t = first.t + n * step
            if abs(state.t - t) > 1e-6 * step:
                raise ValueError(
                    f"{name} must be at the time of step {n}, t = {t:g} with step = {step:g}, but "
                    f"is at {state.t:g}"
                )
        computed.append(pair[0])
        exact.append(pair[1])
    if len(exact) <= order:
        raise ValueError(f"pairs must be more than p = {order}, got {len(exact) or 'none'}")
    return tuple(computed), tuple(exact)


def _checked_defects(n: int, given: Defects | None, exact: State) -> Defects | None:
    """Defects of one step, or None."""
    if given is not None:
        object_of(f"chosen({n})", given, Defects)
        for name, shape in (("u", exact.u.shape), ("v", exact.x.shape), ("x", exact.x.shape)):
            finite_array(f"chosen({n}).{name}", getattr(given, name), shape)
    return given


def _square(matrix: csr_array, w: Array) -> float:
    return float(np.sum(w * (matrix @ w)))


def _defect_squares(K: csr_array, d: Defects | None) -> tuple[float, float, float]:
    """Squared norms of d_x, d_v and d_u; nothing is factorised where there is no defect."""
    if d is None or not any(np.any(part) for part in d):
        return 0.0, 0.0, 0.0
    factor = superlu(K)
    return _square(K, d.x), dual_norm(factor, d.v) ** 2, dual_norm(factor, d.u) ** 2


def proposition_1(terms: ErrorTerms, corrected: bool = False) -> float:
    r"""Largest ratio of the two sides of [N] (4.7) over the steps of a run.

    As printed, it contains :math:`\tau\sum_{j=1}^n\|e_u^j\|_A^2` on the left, and of the velocity
    defects only :math:`\tau\sum_{j=p}^n\|d_v^j\|_\star^2` on the right. Corrected, the first sum
    begins at p, and the right-hand side contains :math:`\|d_v^n\|_\star^2`, too.

    Here K is M + A, as in :class:`ErrorTerms`, and the last p errors of u on the left are each
    measured with the mass matrix of their own level, where (4.7) has :math:`M(x_*^n)` for all.

    Parameters
    ----------
    terms : ErrorTerms
    corrected : bool

    Returns
    -------
    float
        The smallest constant C with which the estimate holds.

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated, or the right-hand side is zero in all steps.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
    >>> zero, problem = np.zeros_like(space.nodes), ec.problems.expanding_sphere()
    >>> def chosen(n):
    ...     return Defects(zero[:, 0], 1e-5 * space.nodes * (n == 8), zero)
    >>> pairs = response(space, problem, 2, 1 / 16, 0.5, chosen)
    >>> terms = error_terms(space, pairs, 2, 1 / 16, chosen)
    >>> proposition_1(terms) > 10 > 2 > proposition_1(terms, corrected=True)
    True
    """
    object_of("terms", terms, ErrorTerms)
    flag("corrected", corrected)
    p, tau, square = terms.order, terms.step, terms.squares
    gradients = square["u_stiffness"]
    if corrected:
        gradients = np.where(np.arange(len(gradients)) < p, 0.0, gradients)
    window = np.convolve(square["u_mass"], np.ones(p))[: len(gradients)]
    left = square["x"] + square["v"] + window + tau * (np.cumsum(gradients) - gradients[0])
    right = tau * np.cumsum(square["d_x"] + square["d_v"] + square["d_u"])
    right = right + np.sum(square["x"][:p] + square["u_mass"][:p])
    if corrected:
        right = right + square["d_v"]
    n = (np.arange(len(left)) >= p) & (right > 0)
    if not n.any():
        raise ValueError("terms must have a defect or a starting error in some step, all are zero")
    return float(np.max(left[n] / right[n]))
