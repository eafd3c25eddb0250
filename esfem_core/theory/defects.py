r"""Defects: what the exact nodal values leave over in the scheme ([N] (4.1), [LMV] (5.3)).

Exact values x_*, v_*, u_* at the nodes, put into (2.19)-(2.21), leave d_u, d_v and d_x:

.. math::

    \frac1\tau \sum_{j=0}^p \delta_j M(\tilde x_*^{n-j}) u_*^{n-j} + A(\tilde x_*^n) u_*^n
        &= f(\tilde x_*^n, \tilde u_*^n) + M(x_*^n) d_u^n \\
    K(\tilde x_*^n) v_*^n + \beta A(\tilde x_*^n) x_*^n
        &= g(\tilde x_*^n, \tilde u_*^n) + M(x_*^n) d_v^n \\
    \frac1\tau \sum_{j=0}^p \delta_j x_*^{n-j} &= v_*^n + d_x^n

Only the functionals M d_u and M d_v are ever needed, and the functions here return these.
At levels j < p, where nothing can be extrapolated, M(x_*^j) is taken, as the scheme does.
"""

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, issparse

from esfem_core.checks import Array, finite_array, number, object_of, shown, whole_number
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.errors import root_of_form, square_matrix, unit_of
from esfem_core.laws import Prescribed, Regularised
from esfem_core.problems import Problem
from esfem_core.solvers import Factor, superlu
from esfem_core.stepping import bdf, check_on_exact_surface, exact_state
from esfem_core.surfaces import derivative
from esfem_core.theory.forms import check_definite, check_symmetric, divergence

__all__ = [
    "Defects",
    "NodalValues",
    "constant_diffusivity",
    "defects",
    "diffusion",
    "dual_norm",
    "exact_values",
    "force_load",
    "rate_of_mass",
    "rate_of_u",
    "regularised_law",
    "source_load",
    "spatial_defects",
    "stretching",
    "velocity_law",
]


class NodalValues(NamedTuple):
    """Nodal values at one time.

    Attributes
    ----------
    x, v : (N, 3) float array
        Positions and velocities.
    u : (N,) or (N, m) float array
        Solution.
    """

    x: Array
    v: Array
    u: Array


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


def dual_norm(K: csr_array | Factor, functional: ArrayLike) -> float:
    r"""Norm of a functional that is dual to the norm of K, :math:`(r^T K^{-1} r)^{1/2}`.

    With :math:`K = A + M` and :math:`r = d` this is [LMV]'s norm of a defect d, which contains the
    mass matrix. With :math:`K = M + \alpha A` and :math:`r = M d` it is [N]'s norm
    :math:`(d^T M K^{-1} M d)^{1/2}` of a defect d, which does not; for alpha = 1 it is dual to the
    full H1 norm.

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
    TypeError, ValueError
        If K is neither, or no symmetric positive definite matrix, the sizes do not match, or the
        functional is not finite. A Factor is trusted.

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
    if issparse(K):
        K = square_matrix("K", K).astype(float).tocsr()
        _check_unknowns(K)
        check_symmetric("K", K)
        check_definite("K", K)
        r = finite_array("functional", functional, (K.shape[0], "..."))
        K = superlu(K)
    elif isinstance(K, type) or not callable(getattr(K, "solve", None)):
        raise TypeError(f"K must be a sparse matrix or its Factor, got {shown(K)}")
    else:
        r = finite_array("functional", functional, ("N", "..."))
    unit = unit_of(r)
    columns = r.reshape(len(r), -1) / unit
    return unit * root_of_form("K", columns, K.solve(columns))


def _check_unknowns(K: csr_array) -> None:
    if K.shape[0] == 0:
        raise ValueError("K must have at least one unknown, got shape (0, 0)")


def exact_values(space: SurfaceSpace, problem: Problem, t: float) -> NodalValues:
    """The exact state at t (:func:`esfem_core.stepping.exact_state`), velocities included.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution.
    t : float

    Returns
    -------
    NodalValues

    Raises
    ------
    TypeError, ValueError
        If the problem has no exact solution.
    """
    state = exact_state(space, problem, t)
    return NodalValues(state.x, cast(Array, state.v), state.u)


def defects(space: SurfaceSpace, problem: Problem, order: int, step: float, n: int) -> Defects:
    """Defects of step n for the scheme with mass="extrapolated".

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution. A problem with a prescribed motion is one of [LMV]. The species "u"
        must be conserved, without a rate and without given values, its diffusivity constant.
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
    TypeError, ValueError
        If there is no exact solution, or it takes nodes off its own surface, since it is one of
        another; the problem is none of the theory (:func:`constant_diffusivity`,
        :func:`regularised_law`), a number is out of range, or n < p.

    Examples
    --------
    A perturbation by the defects makes the scheme return the exact nodal values:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.expanding_sphere()
    >>> def d(n):
    ...     return defects(space, problem, 3, 1 / 20, n)
    >>> options = {"mass": "extrapolated", "solver": "direct", "perturbation": d}
    >>> *_, last = ec.evolve(space, problem, 3, 1 / 20, 0.5, **options)
    >>> max(ec.errors.compare(space, problem, last)) < 1e-11
    True
    """
    order, step = whole_number("order", order, 1, bdf.MOST_STEPS), number("step", step, above=0)
    object_of("problem", problem, Problem)
    n = whole_number("n", n, 0)
    if n < order:
        raise ValueError(f"n must be at least p = {order}, got {n}")
    law = regularised_law(problem)
    constant_diffusivity(problem)
    # Newest first. Extrapolating the positions at level n - p reaches back to n - 2 p.
    exact = [exact_values(space, problem, (n - j) * step) for j in range(min(2 * order, n) + 1)]
    now, d, t = exact[0], bdf.delta(order), n * step
    check_on_exact_surface(space, problem, now.x, t)

    def at(j: int) -> Array:  # where the mass matrix of level n - j is taken
        if law is None or n - j < order:
            return exact[j].x
        return bdf.extrapolate([s.x for s in exact[j + 1 : j + order + 1]])

    x, u = at(0), bdf.extrapolate([s.u for s in exact[1 : order + 1]])
    A = space.mass_stiffness(x)[1]
    masses = [space.mass_times(at(j), exact[j].u) for j in range(order + 1)]
    du = bdf.combine(d, masses) / step
    du += diffusion(problem, A, now.u) - source_load(space, problem, x, u, t)
    if law is None:
        return Defects(du, np.zeros_like(x), np.zeros_like(x))
    dv = law.residual(Surface(space, x, u, t), now.x, now.v)
    dx = bdf.combine(d, [s.x for s in exact[: order + 1]]) / step - now.v
    return Defects(du, dv, dx)


def spatial_defects(space: SurfaceSpace, problem: Problem, t: float) -> Defects:
    r"""Defects of the semi-discretization: the limit of :func:`defects` as tau goes to 0.

    .. math::

        M(x_*) d_u &= \frac{\mathrm d}{\mathrm dt} \bigl( M(x_*) u_* \bigr) + A(x_*) u_*
            - f(x_*, u_*) \\
        M(x_*) d_v &= K(x_*) v_* + \beta A(x_*) x_* - g(x_*, u_*)

    The first is M r of [LMV] (5.2), the second [N] (6.2).

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        As for :func:`defects`; the exact solution is defined also a little before and after t,
        since u_* is differentiated numerically, as in :func:`rate_of_u`.
    t : float

    Returns
    -------
    Defects
        ``x`` is zero: the defect of x is a temporal one.

    Raises
    ------
    TypeError, ValueError
        If there is no exact solution of this surface, or the problem is none of the theory, as for
        :func:`defects`.

    Examples
    --------
    Those of BDF2 come to them with order two:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem, x = ec.problems.expanding_sphere(), space.nodes
    >>> K, limit = sum(space.mass_stiffness(1.5 * x)), spatial_defects(space, problem, 0.5)
    >>> def to_limit(n):
    ...     return dual_norm(K, defects(space, problem, 2, 0.5 / n, n).u - limit.u)
    >>> print(f"{to_limit(80) / to_limit(160):.1f}")
    4.0
    """
    constant_diffusivity(problem)
    x, v, u = exact_values(space, problem, t)
    check_on_exact_surface(space, problem, x, t)
    A = space.mass_stiffness(x)[1]
    du = rate_of_mass(space, x, v, u, rate_of_u(space, problem, t))
    du += diffusion(problem, A, u) - source_load(space, problem, x, u, t)
    law, zero = regularised_law(problem), np.zeros_like(x)
    dv = zero if law is None else law.residual(Surface(space, x, u, t), x, v)
    return Defects(du, dv, zero)


def rate_of_u(space: SurfaceSpace, problem: Problem, t: float) -> Array:
    """Material derivative of the exact u at the nodes.

    By differences with a step of 0.01: to about 12 digits where u varies on times of about one.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution, defined also a little before and after t.
    t : float

    Returns
    -------
    (N,) or (N, m) float array

    Raises
    ------
    TypeError, ValueError
        If the problem has no exact solution, or an argument is not as stated.
    """
    return derivative(lambda s: exact_state(space, problem, s).u, t)


def stretching(space: SurfaceSpace, x: Array, v: ArrayLike, u: ArrayLike) -> Array:
    """q(x; v; u, phi_j) = int (div v) u phi_j, without the matrix.

    Parameters
    ----------
    space : SurfaceSpace
    x, v : (N, 3) float arrays
        Node positions and nodal velocities.
    u : (N,) or (N, m) float array

    Returns
    -------
    float array of the shape of u

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong shape or is not finite.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> x, u = space.nodes, space.nodes[:, 0]
    >>> b = stretching(space, x, 0.5 * x, u)  # div v = 1
    >>> bool(np.allclose(b, space.mass_times(x, u), rtol=0, atol=1e-15))
    True
    """
    object_of("space", space, SurfaceSpace)
    values = space.evaluate(finite_array("u", u, (len(space.nodes), "...")))
    rate = divergence(space, x, v)
    return space.load(x, rate.reshape(*rate.shape, *[1] * (values.ndim - 2)) * values)


def rate_of_mass(
    space: SurfaceSpace, x: Array, v: ArrayLike, u: ArrayLike, rate: ArrayLike
) -> Array:
    r"""Rate of change of M(x) u for nodes that move with v.

    .. math::

        \frac{\mathrm d}{\mathrm dt} \bigl( M(x) u \bigr) = M(x)\, \dot u + q(x; v; u, \cdot)

    Parameters
    ----------
    space, x, v, u
        As for :func:`stretching`.
    rate : float array of the shape of u
        u', the material derivative.

    Returns
    -------
    float array of the shape of u

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong shape or is not finite.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.
    """
    object_of("space", space, SurfaceSpace)
    u = finite_array("u", u, (len(space.nodes), "..."))
    rate = finite_array("rate", rate, u.shape)
    return space.mass_times(x, rate) + stretching(space, x, v, u)


def diffusion(problem: Problem, A: csr_array, u: Array) -> Array:
    """D A u, with the diffusivity D of each component.

    Parameters
    ----------
    problem : Problem
    A : (N, N) CSR array
        Stiffness matrix.
    u : (N,) or (N, m) float array

    Returns
    -------
    float array of the shape of u

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated, or as by :func:`constant_diffusivity`.
    """
    D, A = constant_diffusivity(problem), square_matrix("A", A)
    shape = (A.shape[0], "...") if np.ndim(D) == 0 else (A.shape[0], len(np.atleast_1d(D)))
    return np.asarray((A @ finite_array("u", u, shape)) * D)


def constant_diffusivity(problem: Problem) -> float | Array:
    """D of the species "u", the only one of (2.19): a number, or one for each component.

    Raises
    ------
    TypeError, ValueError
        If there is another species or no "u", its diffusivity is a function, or its equation is
        another than that of the papers.

    Examples
    --------
    >>> import esfem_core as ec
    >>> constant_diffusivity(ec.Problem(species={}, law=ec.laws.Regularised()))
    Traceback (most recent call last):
        ...
    ValueError: problem must have the species "u" alone for the theory, got none
    """
    species = object_of("problem", problem, Problem).species
    if list(species) != ["u"]:
        names = ", ".join(map(repr, species)) or "none"
        raise ValueError(f'problem must have the species "u" alone for the theory, got {names}')
    u = species["u"]
    if callable(u.diffusivity):
        raise TypeError("the theory is for constant diffusivities, got a function")
    if not u.conserved or u.rate is not None or u.fixed is not None:
        raise TypeError(
            'the theory is for a species "u" that is conserved, without a rate and without given '
            f"values, got conserved={u.conserved}, rate={shown(u.rate)}, fixed={shown(u.fixed)}"
        )
    return u.diffusivity


def regularised_law(problem: Problem) -> Regularised | None:
    """The law of [N], or None for a prescribed motion, the problem of [LMV].

    Raises
    ------
    TypeError
        For any other law, and what is no problem.
    """
    object_of("problem", problem, Problem)
    if isinstance(problem.law, Prescribed):
        return None
    if not isinstance(problem.law, Regularised):
        raise TypeError(
            "the theory is for laws.Regularised and laws.Prescribed, got "
            f"{type(problem.law).__name__}"
        )
    return problem.law


def velocity_law(problem: Problem) -> Regularised:
    """The law of [N], where nothing else will do.

    Raises
    ------
    TypeError, ValueError
        For any other law, a prescribed motion, and what is no problem.
    """
    law = regularised_law(problem)
    if law is None:
        raise ValueError(
            "problem must have the velocity law of [N], laws.Regularised, but its motion is "
            "prescribed"
        )
    return law


def source_load(
    space: SurfaceSpace, problem: Problem, x: ArrayLike, u: ArrayLike, t: float
) -> Array:
    """Load vector f(x, u) of the right-hand side of (2.19).

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
    x : (N, 3) float array
        Node positions.
    u : (N,) or (N, m) float array
    t : float

    Returns
    -------
    float array of the shape of u
        Zero if the problem has no f.

    Raises
    ------
    TypeError, ValueError
        If an argument, or what f returns, has the wrong shape or is not finite, or as by
        :func:`constant_diffusivity`.
    esfem_core.DegenerateElementError
        If an element has no area.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem = ec.Problem(u0=lambda x: x[:, 0], f=lambda at: at.t * at.u)
    >>> b = source_load(space, problem, space.nodes, space.nodes[:, 0], 2.0)
    >>> expected = 2 * space.mass_times(space.nodes, space.nodes[:, 0])
    >>> bool(np.allclose(b, expected, rtol=0, atol=1e-15))
    True
    """
    constant_diffusivity(problem)
    at = _surface(space, x, u, t)
    load = problem.species["u"].load("u", at)
    return np.zeros_like(at.fields["u"]) if load is None else load


def force_load(
    space: SurfaceSpace, problem: Problem, x: ArrayLike, u: ArrayLike, t: float
) -> Array:
    """Load vector g(x, u) of the right-hand side of (2.20).

    Parameters
    ----------
    space, problem, x, u, t
        As for :func:`source_load`.

    Returns
    -------
    (N, 3) float array
        Zero if the problem has no g, or a prescribed motion.

    Raises
    ------
    TypeError, ValueError
        If an argument, or what g returns, has the wrong shape or is not finite, or as by
        :func:`regularised_law`.
    esfem_core.DegenerateElementError
        If an element has no area.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem = ec.Problem(u0=lambda x: x[:, 0], g=lambda at: 3 * np.ones(at.density.shape))
    >>> b = force_load(space, problem, space.nodes, space.nodes[:, 0], 0.0)
    >>> expected = 3 * space.load(space.nodes, space.normals(space.nodes))
    >>> bool(np.allclose(b, expected, rtol=0, atol=1e-15))
    True
    """
    law, at = regularised_law(problem), _surface(space, x, u, t)
    load = None if law is None else law.load(at)
    return np.zeros_like(at.x) if load is None else load


def _surface(space: SurfaceSpace, x: ArrayLike, u: ArrayLike, t: float) -> Surface:
    object_of("space", space, SurfaceSpace)
    x = finite_array("x", x, space.nodes.shape)
    return Surface(space, x, finite_array("u", u, (len(space.nodes), "...")), t)
