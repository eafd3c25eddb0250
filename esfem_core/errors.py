"""Norms on discrete surfaces, and errors against an exact solution."""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, issparse

from esfem_core.checks import (
    Array,
    finite_array,
    function,
    iterable,
    number,
    object_of,
    real_array,
    shown,
)
from esfem_core.elements import SurfaceSpace, squared_differences
from esfem_core.laws import check_no_slip
from esfem_core.problems import Problem
from esfem_core.stepping import (
    State,
    check_exact_surface,
    check_state,
    exact_state,
    same_space,
    same_time,
)

__all__ = [
    "Errors",
    "Measure",
    "compare",
    "difference",
    "lifted",
    "root_of_form",
    "seminorm",
    "square_matrix",
    "time_norms",
    "unit_of",
]


INDEFINITE = 1e-8  # negative squares below this, relative to their terms, are rounding
# Spaces on whose nodes the exact solution of a problem was found to begin: once is enough.
FITTING: WeakKeyDictionary[Problem, WeakSet[SurfaceSpace]] = WeakKeyDictionary()
LARGEST = 1e75  # the square of what is larger, times an entry of a matrix, may be no float


class Errors(NamedTuple):
    """L2 norms and H1 seminorms of the errors in positions, velocities and solution.

    Where there is no velocity or no "u", its errors are NaN.
    """

    x_l2: float
    x_h1: float
    v_l2: float
    v_h1: float
    u_l2: float
    u_h1: float


Measure = Callable[[SurfaceSpace, Problem, State], Errors]
"""How far a state is from the exact solution: :func:`compare` or :func:`lifted`."""


def seminorm(matrix: csr_array, w: ArrayLike) -> float:
    r"""Norm or seminorm of a finite element function.

    .. math:: \Bigl( \sum_c w_c^T\, \text{matrix}\; w_c \Bigr)^{1/2}

    over the components c of the values. With the mass matrix M(x) this is the L2 norm on
    Γ_h[x] of the finite element function with nodal values w, with the stiffness matrix A(x) its H1
    seminorm ([N] section 3, [LMV] (2.8)). Of values below 1e-162 the squares are no numbers, and it
    is zero.

    Parameters
    ----------
    matrix : (N, N) sparse array
        Symmetric, positive semidefinite.
    w : (N, ...) float array

    Returns
    -------
    float

    Raises
    ------
    TypeError, ValueError
        If the matrix is not sparse and square, `w` does not have one row for each of its own,
        something is not finite, or w^T matrix w is negative beyond rounding.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 3), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> print(f"{seminorm(M, space.nodes) ** 2 / (4 * np.pi):.4f}")
    1.0000
    >>> print(f"{seminorm(A, space.nodes) ** 2 / (8 * np.pi):.4f}")
    1.0000
    """
    matrix = square_matrix("matrix", matrix)
    w = finite_array("w", w, (matrix.shape[1], "..."))
    columns = w.reshape(len(w), -1)
    largest = np.abs(columns).max(initial=0.0)
    if largest > LARGEST:  # squares would overflow; a power of two takes nothing from the digits
        unit = 2.0 ** int(np.frexp(largest)[1] - 1)
        return unit * seminorm(matrix, w / unit)
    image, size = matrix @ columns, 0.0
    if not np.sum(columns * image) >= 0:  # whether that is rounding, its largest terms tell
        size = float(np.sum(np.abs(columns) * (abs(matrix) @ np.abs(columns))))
    return root_of_form("matrix", columns, image, size)


def square_matrix(name: str, matrix: csr_array) -> csr_array:
    """A sparse, square matrix of finite numbers.

    Raises
    ------
    TypeError, ValueError
        If it is not sparse, not square or not finite.
    """
    if not issparse(matrix):
        raise TypeError(f"{name} must be a sparse matrix, got {shown(matrix)}")
    if len(matrix.shape) != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{name} must be square, got shape {matrix.shape}")
    finite_array(f"{name}.data", matrix.tocsr().data, ("n",))
    return matrix


def root_of_form(name: str, w: Array, image: Array, size: float = 0.0) -> float:
    """(w . image)^{1/2}, where the image is that of w under a positive semidefinite matrix.

    Rounding can bring a square that is zero below zero; what is more negative, relative to the
    terms of the square or to `size`, is refused.

    Raises
    ------
    ValueError
        If the square is negative beyond rounding.

    Examples
    --------
    >>> root_of_form("matrix", np.array([3.0, 4.0]), np.array([-3.0, 4.0]))
    2.6457513110645907
    >>> root_of_form("matrix", np.array([3.0, 4.0]), np.array([3.0, -4.0]))
    Traceback (most recent call last):
        ...
    ValueError: matrix must be positive semidefinite, but has the square -7 for this vector
    """
    products = w * image
    square = float(products.sum())
    if not square >= -INDEFINITE * max(size, float(np.abs(products).sum())):
        raise ValueError(
            f"{name} must be positive semidefinite, but has the square {square:.3g} for this vector"
        )
    return float(np.sqrt(max(square, 0.0)))


def unit_of(values: Array) -> float:
    """Power of two near the largest of finite values, for norms whose squares are out of range.

    No digit is lost: the norm is `unit` times that of ``values / unit``.

    Examples
    --------
    >>> values = np.array([3e200, 4e200])
    >>> unit = unit_of(values)
    >>> bool(np.isclose(unit * np.sqrt(np.sum((values / unit) ** 2)), 5e200))
    True
    """
    return float(2.0 ** int(np.frexp(np.abs(values).max(initial=0.0))[1] - 1))


def compare(space: SurfaceSpace, problem: Problem, state: State) -> Errors:
    """Errors against the nodal interpolant of the exact solution on Γ_h[x_*] ([N] 7.4).

    The error vectors e_x = x - x_*, e_v = v - v_*, e_u = u - u_*, with exact values at the nodes,
    in the norms of the mass and the stiffness matrix at the exact nodes x_*.

    Parameters
    ----------
    space : SurfaceSpace
        Whose nodes are the initial positions: on new triangles, that of ``remeshed(states, h,
        problem)``, with the problem.
    problem : Problem
        With an exact solution.
    state : State

    Returns
    -------
    Errors
        Those of the velocity are NaN where ``state.v`` is None.

    Raises
    ------
    TypeError, ValueError
        If the problem has no exact solution or one of another surface than that of the nodes of
        the space, its law lets nodes slip, which are then not where the exact ones are, the state
        is not one of this space, something is not finite, or u and the exact u differ in shape.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.shrinking_sphere()
    >>> *_, last = ec.evolve(space, problem, order=2, step=1 / 20, end=1 / 2)
    >>> print(f"{ec.errors.compare(space, problem, last).x_l2:.1e}")
    9.8e-06
    """
    check_state(space, state)
    exact = exact_state(space, problem, state.t)
    _check_surface(space, problem)
    return _difference(space, state, exact, "problem.exact")


def lifted(space: SurfaceSpace, problem: Problem, state: State) -> Errors:
    """Errors on the exact surface Γ(t), those of [N] Theorem 2.1.

    The nodal vectors x, v, u are taken as functions on Γ_h[x_*] ([N] (2.23)), with the exact nodes
    x_*, lifted to Γ(t), and compared there with the identity, the velocity and the solution:
    ``||x^L - id||``, ``||v^L - v||``, ``||u^L - u||`` in L2(Γ(t)) and with tangential gradients.
    Unlike :func:`compare`, this counts the error of interpolation. The quadrature is exact to
    degree 2k + 2, whatever the space's: on coarse meshes three digits of the errors are right.
    Errors whose squares are no numbers, above 1e154 or below 1e-162, become infinite or zero.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution that has closest points and origins
        (:class:`esfem_core.Exact`): the spheres and the ellipsoid in :mod:`esfem_core.problems`
        do.
    state : State

    Returns
    -------
    Errors
        Those of the velocity are NaN where ``state.v`` is None.

    Raises
    ------
    TypeError, ValueError
        If the problem has no exact solution or the solution no closest points and origins, or as
        for :func:`compare`.

    Examples
    --------
    >>> import esfem_core as ec
    >>> problem = ec.problems.expanding_sphere()
    >>> for refinements in (2, 3):
    ...     space = ec.SurfaceSpace(ec.sphere("octahedron", refinements), 2, ec.to_unit_sphere)
    ...     x = problem.exact.x(space.nodes, 0.5)
    ...     exact = ec.State(0.5, x, None, problem.exact.u(x, 0.5))
    ...     e = ec.errors.lifted(space, problem, exact)
    ...     print(f"interpolation error of u: {e.u_l2:.1e} {e.u_h1:.1e}")
    interpolation error of u: 2.0e-02 1.9e-01
    interpolation error of u: 2.6e-03 5.1e-02
    """
    check_state(space, state)
    t, exact = state.t, object_of("problem", problem, Problem).exact
    if exact is None or exact.closest is None or exact.origin is None:
        raise ValueError(
            "lifted errors need an exact solution with closest points and origins: problem must "
            "have Exact(x, v, u, closest, origin), but has "
            f"{'none' if exact is None else 'not all of them'}"
        )
    _check_surface(space, problem)
    x_of, v_of, u_of = exact.x, exact.v, exact.functions.get("u")
    closest, origin = exact.closest, exact.origin
    n = len(space.nodes)
    v = np.zeros_like(state.x) if state.v is None else state.v
    # Without a "u", or an exact one, there is nothing to compare.
    u = state.fields.get("u", np.zeros(n)) if u_of is not None else np.zeros(n)
    compared = u_of is not None and "u" in state.fields

    def on_surface(y: Array) -> Array:
        return finite_array("exact.closest(x, t)", closest(y.copy(), t), (len(y), 3))

    def solution(y: Array) -> Array:
        p = finite_array("exact.origin(x, t)", origin(y.copy(), t), (len(y), 3))
        velocity = finite_array("exact.v(p, t)", v_of(p, t), (len(y), 3))
        values = np.zeros((len(y), u[0].size))
        if u_of is not None and compared:
            shape = (len(y), *u.shape[1:])
            values = finite_array("exact.u(x, t)", u_of(y.copy(), t), shape).reshape(values.shape)
        return np.hstack([y, velocity, values])

    x = finite_array("exact.x(p, t)", x_of(space.nodes.copy(), t), (n, 3))
    w = np.hstack([state.x, v, u.reshape(n, -1)])
    squares = squared_differences(space, x, on_surface, w, solution)
    l2, h1 = ([np.sqrt(part.sum()) for part in np.split(s, [3, 6])] for s in squares)
    if state.v is None:
        l2[1] = h1[1] = np.nan
    if not compared:
        l2[2] = h1[2] = np.nan
    x_l2, v_l2, u_l2 = map(float, l2)
    x_h1, v_h1, u_h1 = map(float, h1)
    return Errors(x_l2, x_h1, v_l2, v_h1, u_l2, u_h1)


def difference(space: SurfaceSpace, state: State, reference: State) -> Errors:
    """Differences of two discrete solutions on the same space, on Γ_h[reference.x].

    Against a run with a much smaller step this is the temporal error alone. Both runs must then
    start alike at t = 0 (``start="euler"``) or with states of the finer one (`fine` of
    :func:`esfem_core.study.time_study`): exact starting values at (p - 1) tau restart the spatial
    error there, which shows as a difference of first order in tau.

    Parameters
    ----------
    space : SurfaceSpace
    state, reference : State
        At the same time.

    Returns
    -------
    Errors

    Raises
    ------
    TypeError, ValueError
        If the states are not at the same time, not on this space, not finite, or their u differ in
        shape.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> runs = [
    ...     list(ec.evolve(space, ec.problems.growing_sphere(), 2, step, 0.5, start="euler"))
    ...     for step in (1 / 40, 1 / 80, 1 / 1280)
    ... ]
    >>> coarse, fine = (difference(space, run[-1], runs[-1][-1]).x_l2 for run in runs[:2])
    >>> print(f"{np.log2(coarse / fine):.1f}")
    2.0
    """
    check_state(space, state)
    return _difference(space, state, reference, "reference")


def _check_surface(space: SurfaceSpace, problem: Problem) -> None:
    """Refuse a space that is not the initial surface, at the first of all states of a run.

    And nodes that slip: they are not where the exact solution has them.
    """
    check_no_slip(
        problem.law,
        "exact nodes are those without; compare state.u with exact.u(state.x, t)",
    )
    known = FITTING.setdefault(problem, WeakSet())
    if space not in known:
        check_exact_surface(space, problem)
        known.add(space)


def _check_same_mesh(space: SurfaceSpace, state: State, name: str) -> None:
    """Refuse a state of another mesh, whose nodal values are at other points."""
    other = state.space if isinstance(state, State) else None
    if other is not None and not same_space(other, space):
        raise ValueError(
            f"{name} must be a state of this space, {space!r}, but it is one of {other!r}; "
            "values of runs on two meshes are compared at points: "
            "state.space.probe(state.x, state.u, points) of each"
        )


def _difference(space: SurfaceSpace, state: State, reference: State, name: str) -> Errors:
    _check_same_mesh(space, reference, name)
    check_state(space, reference, name)
    if not same_time(state.t, reference.t):
        raise ValueError(
            f"{name} must be at the time of state, t = {state.t}, but is at {reference.t}"
        )
    u, u_reference = state.fields.get("u"), reference.fields.get("u")
    if u is not None and u_reference is not None and u.shape != u_reference.shape:
        raise ValueError(
            f"u of state and of {name} must have one shape, got {u.shape} and {u_reference.shape}"
        )
    M, A = space.mass_stiffness(reference.x)

    def norms(a: Array | None, b: Array | None) -> tuple[float, float]:
        if a is None or b is None:
            return float("nan"), float("nan")
        return seminorm(M, a - b), seminorm(A, a - b)

    return Errors(
        *norms(state.x, reference.x), *norms(state.v, reference.v), *norms(u, u_reference)
    )


def time_norms(
    space: SurfaceSpace,
    problem: Problem,
    states: Iterable[State],
    window: tuple[float, float],
    measure: Measure = compare,
) -> tuple[float, float]:
    r"""Errors of u over a run, in the norms of [LMV] Theorem 5.2.

    .. math::

        \max_n \|e_u^n\|_{L^2}, \qquad
        \Bigl( \tau \sum_n \|\nabla e_u^n\|_{L^2}^2 \Bigr)^{1/2}

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
    states : iterable of State
        A run with constant step tau, as :func:`esfem_core.evolve` yields it; none is kept.
    window : (float, float)
        First and last time t_n to count, both included (to a relative 1e-12), starting states
        excluded.
    measure : callable, optional
        :func:`compare` or :func:`lifted`, or another that returns :class:`Errors`.

    Returns
    -------
    (float, float)
        Both, from u_l2 and u_h1 of `measure`. An error that is NaN makes them NaN.

    Raises
    ------
    TypeError
        If `measure` does not return Errors, or not of numbers.
    ValueError
        If no step lies in the window, the times do not increase by one constant step, or as
        `measure` does.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.oscillating_ellipsoid("oscillation")
    >>> states = ec.evolve(space, problem, order=2, step=1 / 20, end=1.0)
    >>> print("{:.1e} {:.1e}".format(*time_norms(space, problem, states, window=(0.5, 1.0))))
    4.0e-03 6.4e-03
    """
    first, last = real_array("window", window, (2,))
    if not first <= last:
        raise ValueError(f"window must be two times, the first not after the last, got {window}")
    function("measure", measure, "measure(space, problem, state)")
    iterable("states", states, "States")
    times, errors = [], []
    for i, state in enumerate(states):
        check_state(space, state, f"states[{i}]")
        times.append(state.t)
        _check_step(times)
        inside = first <= state.t <= last or same_time(state.t, first) or same_time(state.t, last)
        if inside and state.v is not None:
            found = measure(space, problem, state)
            errors.append(object_of("what measure returns", found, Errors))
            _check_entries(found)
    if not errors:
        raise ValueError(
            f"window must hold a step after the starting states, but none of {len(times)} states "
            f"lies in {window}"
        )
    if len(times) < 2:
        raise ValueError("states must hold two states or more, got one: it does not tell the step")
    tau = (times[-1] - times[0]) / (len(times) - 1)
    # Unlike Python's max, NumPy's does not skip NaN.
    largest = float(np.max([e.u_l2 for e in errors]))
    return largest, float(np.sqrt(tau * sum(_square(e.u_h1) for e in errors)))


def _check_entries(errors: Errors) -> None:
    """Refuse errors that are no numbers, or negative; NaN, where there is nothing, is none."""
    for name in ("u_l2", "u_h1"):
        value = getattr(errors, name)
        if not (isinstance(value, float) and math.isnan(value)):
            number(f"{name} of what measure returns", value, least=0)


def _square(value: float) -> float:
    try:
        return float(value) ** 2
    except OverflowError:
        return np.inf


def _check_step(times: list[float]) -> None:
    """Refuse the last time if it is not one step after the last but one."""
    if len(times) < 2:
        return
    tau, last = times[1] - times[0], times[-1] - times[-2]
    rounding = 2 * math.ulp(max(abs(times[0]), abs(times[-1])))
    if not (tau > 0 and abs(last - tau) <= 1e-6 * tau + rounding):
        raise ValueError(
            f"states must be one positive, constant step apart, got steps of {tau:g} and {last:g}"
        )
