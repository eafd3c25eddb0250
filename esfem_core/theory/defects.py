r"""Defects: what the exact nodal values leave over in the scheme ([N] (4.1), [LMV] (5.3)).

Exact values x_*, v_*, u_* at the nodes, put into (2.19)-(2.21), leave d_u, d_v and d_x::

    (1/tau) sum_j delta_j M(x~_*^{n-j}) u_*^{n-j} + A(x~_*^n) u_*^n
                                        = f(x~_*^n, u~_*^n) + M(x_*^n) d_u^n
    K(x~_*^n) v_*^n + beta A(x~_*^n) x_*^n = g(x~_*^n, u~_*^n) + M(x_*^n) d_v^n
    (1/tau) sum_j delta_j x_*^{n-j}     = v_*^n + d_x^n

Only the functionals M d_u and M d_v are ever needed, and it is they that functions here return.
At levels j < p, where nothing can be extrapolated, M(x_*^j) is taken, as the scheme does.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.solvers import Factor, superlu
from esfem_core.stepping import State
from esfem_core.stepping.bdf import delta, gamma
from esfem_core.theory.forms import divergence

__all__ = [
    "Defects",
    "defects",
    "dual_norm",
    "interpolant",
    "spatial_defects",
]

Array = NDArray[np.float64]

# Central differences of order 8, whose errors of truncation and rounding are both about 1e-13.
_WIDTH = 0.01
_STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


class Defects(NamedTuple):
    """Defects of one step.

    Attributes
    ----------
    u : (N,) or (N, m) float array
        M(x_*^n) d_u^n; with a prescribed motion this is -d_n of [LMV] (3.3).
    v : (N, 3) float array
        M(x_*^n) d_v^n; zero with a prescribed motion.
    x : (N, 3) float array
        d_x^n, without the mass matrix.
    """

    u: Array
    v: Array
    x: Array


def dual_norm(K: csr_array | Factor, functional: Array) -> float:
    r"""Norm of a functional that is dual to the norm of K: (r^T K^{-1} r)^{1/2}.

    With K = A + M and r = d this is [LMV]'s norm of a defect d, which contains the mass matrix.
    With K = M + alpha A and r = M d it is [N]'s norm (d^T M K^{-1} M d)^{1/2} of a defect d,
    which does not; for alpha = 1 it is dual to the full H1 norm.

    Parameters
    ----------
    K : (N, N) sparse array or Factor
        Symmetric positive definite, or its factorisation if it serves several times.
    functional : (N, ...) float array
        The vector r; components are summed.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the sizes do not match.

    Examples
    --------
    The constant functional is dual to the constants, on which K is M:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> area = M.sum()
    >>> bool(abs(dual_norm(M + A, M @ np.ones(len(space.nodes))) - area**0.5) < 1e-12)
    True
    """
    if isinstance(K, csr_array):
        if K.shape[0] != len(functional):
            raise ValueError(f"functional must have {K.shape[0]} rows, got {functional.shape}")
        K = superlu(K)
    columns = functional.reshape(len(functional), -1)
    return float(np.sqrt(max(np.sum(columns * K.solve(columns)), 0.0)))


def interpolant(space: SurfaceSpace, problem: Problem, t: float) -> State:
    """Exact values x_*(t), v_*(t), u_*(t) at the nodes.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution.
    t : float

    Returns
    -------
    State

    Raises
    ------
    ValueError
        If the problem has no exact solution.
    """
    if problem.exact is None:
        raise ValueError("defects need a problem with an exact solution")
    x = np.array(problem.exact.x(space.nodes, t), dtype=float)
    v, u = problem.exact.v(space.nodes, t), problem.exact.u(x, t)
    return State(t, x, np.array(v, dtype=float), np.array(u, dtype=float))


def defects(space: SurfaceSpace, problem: Problem, order: int, step: float, n: int) -> Defects:
    """Defects of step n for the scheme with mass="extrapolated".

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution. A problem with a prescribed motion is one of [LMV].
    order : int
        p.
    step : float
        tau.
    n : int
        Number of the step, p or more.

    Returns
    -------
    Defects

    Raises
    ------
    ValueError
        If there is no exact solution, or n < p.

    Examples
    --------
    A perturbation by the defects makes the scheme return the exact nodal values:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.expanding_sphere()
    >>> def d(n):
    ...     return defects(space, problem, 3, 1 / 20, n)
    >>> *_, last = ec.evolve(space, problem, 3, 1 / 20, 0.5, solver="direct", perturbation=d)
    >>> max(ec.errors.compare(space, problem, last)) < 1e-11
    True
    """
    if n < order:
        raise ValueError(f"the first step that is one is n = p = {order}, got n = {n}")
    exact = [interpolant(space, problem, (n - j) * step) for j in range(min(2 * order, n) + 1)]
    now, d = exact[0], delta(order)
    x_now, u_now, v_now = values_of(now)

    def at(j: int) -> Array:  # where the mass matrix of level n - j is taken
        if problem.motion is not None or n - j < order:
            return exact[j].x
        return combined(gamma(order), [s.x for s in exact[j + 1 : j + order + 1]])

    x = at(0)
    u = combined(gamma(order), [s.u for s in exact[1 : order + 1]])
    A = space.mass_stiffness(x)[1]
    du = combined(d, [mass_times(space, at(j), exact[j].u) for j in range(order + 1)]) / step
    du += diffusion(problem, A, u_now) - source_load(space, problem, "f", x, u, now.t)
    if problem.motion is not None:
        return Defects(du, np.zeros_like(x), np.zeros_like(x))
    dv = velocity_law(space, problem, x, x_now, v_now)
    dv -= source_load(space, problem, "g", x, u, now.t)
    return Defects(du, dv, combined(d, [s.x for s in exact[: order + 1]]) / step - v_now)


def spatial_defects(space: SurfaceSpace, problem: Problem, t: float) -> Defects:
    """Defects of the semi-discretization: the limit of :func:`defects` as tau goes to 0.

    d/dt (M(x_*) u_*) + A(x_*) u_* - f(x_*, u_*), which with opposite sign is M r of [LMV] (5.2),
    and K(x_*) v_* + beta A(x_*) x_* - g(x_*, u_*), which is [N] (6.2).

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution, defined also a little before and after t, of which u_* is
        differentiated numerically to about 12 digits.
    t : float

    Returns
    -------
    Defects
        ``x`` is zero: the defect of x is made in time alone.
    """
    x, u, v = values_of(interpolant(space, problem, t))
    A = space.mass_stiffness(x)[1]
    du = rate_of_mass(space, x, v, u, rate_of_u(space, problem, t))
    du += diffusion(problem, A, u) - source_load(space, problem, "f", x, u, t)
    zero = np.zeros_like(x)
    if problem.motion is not None:
        return Defects(du, zero, zero)
    law = velocity_law(space, problem, x, x, v)
    return Defects(du, law - source_load(space, problem, "g", x, u, t), zero)


def values_of(state: State) -> tuple[Array, Array, Array]:
    """Positions, solution and velocity."""
    assert state.v is not None
    return state.x, state.u, state.v


def combined(coefficients: Array, values: Sequence[Array]) -> Array:
    """Sum of coefficients[j] values[j], newest first."""
    total: Array = np.tensordot(coefficients, np.array(values), axes=1)
    return total


def difference(function: Callable[[float], Array]) -> Array:
    """Derivative at 0 of a smooth function of order-one length scale."""
    parts = [c * (function(i * _WIDTH) - function(-i * _WIDTH)) for i, c in _STENCIL.items()]
    derivative: Array = np.sum(parts, axis=0) / _WIDTH
    return derivative


def rate_of_u(space: SurfaceSpace, problem: Problem, t: float) -> Array:
    """Material derivative of u at the nodes."""
    return difference(lambda s: interpolant(space, problem, t + s).u)


def mass_times(space: SurfaceSpace, x: Array, u: Array) -> Array:
    """M(x) u."""
    return space.load(x, space.evaluate(u))


def stretching(space: SurfaceSpace, x: Array, v: Array, u: Array) -> Array:
    """q(x; v; u, .): integrals of (div v) u phi_j."""
    return space.load(x, (divergence(space, x, v).T * space.evaluate(u).T).T)


def rate_of_mass(space: SurfaceSpace, x: Array, v: Array, u: Array, rate: Array) -> Array:
    """d/dt (M(x) u) for x' = v and u' = rate."""
    return mass_times(space, x, rate) + stretching(space, x, v, u)


def diffusion(problem: Problem, A: csr_array, u: Array) -> Array:
    return np.asarray((A @ u) * problem.diffusivity)


def velocity_law(
    space: SurfaceSpace, problem: Problem, surface: Array, x: Array, v: Array
) -> Array:
    """K v + beta A x, with matrices on Γ_h[surface]."""
    M, A = space.mass_stiffness(surface)
    return np.asarray(M @ v + A @ (problem.alpha * v + problem.beta * x))


def source_load(
    space: SurfaceSpace, problem: Problem, name: str, x: Array, u: Array, t: float
) -> Array:
    """Load vector f(x, u) or g(x, u)."""
    function: Callable[..., Array] | None = getattr(problem, name)
    if function is None:
        return np.zeros_like(u if name == "f" else x)
    at = space.assemble(x, u)
    values = np.asarray(function(at.u, at.grad_u, at.points, t), dtype=float)
    return space.load_with(at.density, values if name == "f" else values[..., None] * at.normals)
