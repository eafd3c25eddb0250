"""Spheres of radius r(t) with exact solutions: two are forced, two solve an equation for r."""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.special import lambertw

from esfem_core.checks import Array, number, one_of
from esfem_core.elements import Surface
from esfem_core.problems.problem import Exact, Problem, at_points
from esfem_core.surfaces import to_unit_sphere

__all__ = [
    "Coupling",
    "expanding_sphere",
    "growing_sphere",
    "logistic_sphere",
    "shrinking_sphere",
]

Coupling = Literal["smooth", "printed", "none"]
"""How u acts on the motion in :func:`expanding_sphere`."""

MOST_EVALUATIONS = 100_000  # of the equation of a radius: a second of time


def expanding_sphere(
    coupling: Coupling = "smooth", alpha: float = 1.0, beta: float = 1.0
) -> Problem:
    r"""[N] Section 7.3: a sphere of radius r = 1 + sin(pi t)/2 with u = a x1 x2 x3, a = exp(-t^2).

    :math:`x_1 x_2 x_3` is an eigenfunction of the Laplace-Beltrami operator for
    :math:`-12/r^2`, so that

    .. math::

        f = \Bigl( 5\,\frac{r'}{r} + \frac{a'}{a} + \frac{12}{r^2} \Bigr) u, \qquad
        c(t) = r' + 2\alpha\,\frac{r'}{r^2} + \frac{2\beta}{r},

    and the velocity law holds for every g that equals c on the solution.

    Parameters
    ----------
    coupling : {"smooth", "printed", "none"}
        "smooth": g = c + (u - a x1 x2 x3), which is well posed. "printed": the thesis'
        g = c u/(a x1 x2 x3), which is 0/0 on three great circles. "none": g = c.
    alpha, beta : float
        As for :class:`Problem`.

    Returns
    -------
    Problem

    Raises
    ------
    ValueError, TypeError
        If `coupling` is unknown or a parameter out of range.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> problem = expanding_sphere()
    >>> *_, last = ec.evolve(space, problem, order=2, step=1 / 20, end=0.5)
    >>> print(f"{np.linalg.norm(last.x, axis=1).mean():.2f}")  # r(1/2)
    1.50
    """
    alpha, beta = number("alpha", alpha, least=0), number("beta", beta, least=0)

    def a(t: float) -> float:
        return float(np.exp(-(t**2)))

    def r(t: float) -> float:
        return 1 + 0.5 * float(np.sin(np.pi * t))

    def dr(t: float) -> float:
        return 0.5 * np.pi * float(np.cos(np.pi * t))

    def c(t: float) -> float:
        return dr(t) + 2 * alpha * dr(t) / r(t) ** 2 + 2 * beta / r(t)

    def f(at: Surface) -> Array:
        return (5 * dr(at.t) / r(at.t) - 2 * at.t + 12 / r(at.t) ** 2) * at.u

    def smooth(at: Surface) -> Array:
        return c(at.t) + (at.u - exact_u(at.points, at.t))

    def printed(at: Surface) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):  # 0/0 is found and reported
            return c(at.t) * at.u / exact_u(at.points, at.t)

    def none(at: Surface) -> Array:
        return np.full(at.u.shape, c(at.t))

    def exact_u(x: Array, t: float) -> Array:
        return a(t) * x[..., 0] * x[..., 1] * x[..., 2]

    couplings = {"smooth": smooth, "printed": printed, "none": none}
    one_of("coupling", coupling, Coupling)
    return Problem(
        u0=lambda x: exact_u(x, 0.0),
        f=f,
        g=couplings[coupling],
        alpha=alpha,
        beta=beta,
        exact=_exact_sphere(r, dr, exact_u),
    )


def logistic_sphere(
    alpha: float = 1.0,
    beta: float = 0.0,
    delta: float = 0.4,
    limit: float = 2.0,
    rate: float = 0.5,
) -> Problem:
    r"""A sphere that grows logistically, driven by u = exp(-6t) x1 x2, with forcing.

    A benchmark of Kovács, Li, Lubich and Power Guerra (2017). The radius solves

    .. math::

        r' = k r\, (1 - r/R), \qquad r(t) = \frac{R}{R\, e^{-kt} + 1 - e^{-kt}},

    from r(0) = 1 to the limit R, and the points move along the normals, :math:`v = r' x/r`. Since
    :math:`x_1 x_2` is homogeneous of degree 2 and an eigenfunction of the Laplace-Beltrami operator
    for :math:`-6/r^2`,

    .. math::

        \partial^\bullet u = \Bigl( 2\,\frac{r'}{r} - 6 \Bigr) u, \qquad
        \nabla_\Gamma \cdot v = 2\,\frac{r'}{r}, \qquad
        \Delta_\Gamma u = -\frac{6}{r^2}\, u, \qquad
        f = \Bigl( 4\,\frac{r'}{r} - 6 + \frac{6}{r^2} \Bigr) e^{-6t} x_1 x_2.

    On the solution the force of the velocity law is c along the normal, and with

    .. math::

        g = c + \delta\, (u - e^{-6t} x_1 x_2), \qquad
        c = r' + 2\alpha\,\frac{r'}{r^2} + \frac{2\beta}{r},

    the velocity depends on u.

    Parameters
    ----------
    alpha, beta : float
        As for :class:`Problem`.
    delta : float
        How strongly u drives the surface; 0 for a surface that does not see u.
    limit, rate : float
        R > 0 and k > 0 of the logistic equation; R < 1 makes the sphere shrink.

    Returns
    -------
    Problem

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.logistic_sphere()
    >>> *_, last = ec.evolve(space, problem, order=3, step=1 / 40, end=1.0)
    >>> e = ec.errors.compare(space, problem, last)
    >>> print(f"{np.linalg.norm(last.x, axis=1).max():.4f} {e.x_l2:.0e} {e.u_l2:.0e}")
    1.2449 5e-05 1e-05
    """
    alpha, beta = number("alpha", alpha, least=0), number("beta", beta, least=0)
    delta, limit = number("delta", delta), number("limit", limit, above=0)
    rate = number("rate", rate, above=0)

    def r(t: float) -> float:
        decay = float(np.exp(-rate * t))
        return limit / (limit * decay + 1 - decay)

    def dr(t: float) -> float:
        return rate * r(t) * (1 - r(t) / limit)

    def exact_u(x: Array, t: float) -> Array:
        return float(np.exp(-6 * t)) * x[..., 0] * x[..., 1]

    def f(at: Surface) -> Array:
        size = r(at.t)
        return (4 * dr(at.t) / size - 6 + 6 / size**2) * exact_u(at.points, at.t)

    def g(at: Surface) -> Array:
        size, speed = r(at.t), dr(at.t)
        c = speed + 2 * alpha * speed / size**2 + 2 * beta / size
        return c + delta * (at.u - exact_u(at.points, at.t))

    return Problem(
        u0=lambda x: exact_u(x, 0.0),
        f=f,
        g=g,
        alpha=alpha,
        beta=beta,
        exact=_exact_sphere(r, dr, exact_u),
    )


def shrinking_sphere(alpha: float = 1.0, beta: float = 1.0, u0: float = 1.0) -> Problem:
    r"""Regularised mean curvature flow of the unit sphere, carrying a constant amount of u.

    f = g = 0, and

    .. math::

        r' \Bigl( 1 + \frac{2\alpha}{r^2} \Bigr) = -\frac{2\beta}{r}, \qquad
        \frac{r^2}{2} + 2\alpha \ln r = \frac12 - 2\beta t, \qquad u = \frac{u_0}{r^2}

    by conservation of mass. For alpha > 0 the sphere never vanishes.

    Parameters
    ----------
    alpha, beta : float
        As for :class:`Problem`.
    u0 : float
        The constant u at the start.

    Returns
    -------
    Problem
        With alpha = 0, its exact solution ends at t = 1/(4 beta), and asking for a later time is a
        ValueError.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> *_, last = ec.evolve(space, shrinking_sphere(), order=2, step=1 / 20, end=0.5)
    >>> r = np.linalg.norm(last.x, axis=1).mean()
    >>> print(f"{r:.2f} {r**2 / 2 + 2 * np.log(r):.2f}")  # 1/2 - 2 t
    0.69 -0.50
    """
    alpha, beta = number("alpha", alpha, least=0), number("beta", beta, least=0)
    u0 = number("u0", u0)

    def radius(t: float) -> float:
        square = 1 - 4 * beta * number("t", t)
        if alpha == 0:
            if square <= 0:
                raise ValueError(
                    f"t must be earlier: the sphere vanishes at t = {1 / (4 * beta)}, asked for "
                    f"t = {t}"
                )
            return float(np.sqrt(square))
        # y + ln(y) = w with y = r^2/(2 alpha): y is Lambert's function of e^w, which overflows.
        w = square / (2 * alpha) - np.log(2 * alpha)
        y = float(lambertw(np.exp(w)).real) if w < 700 else _lambert_of_exponential(w)
        return float(np.sqrt(2 * alpha * y))

    def speed(r: float) -> float:
        return -2 * beta * r / (r * r + 2 * alpha)

    return _sphere_problem(radius, speed, u0, alpha=alpha, beta=beta)


def _lambert_of_exponential(w: float) -> float:
    """Solve y + ln(y) = w for large w by Newton's method."""
    y = w
    for _ in range(20):
        y -= (y + np.log(y) - w) / (1 + 1 / y)
    return y


def growing_sphere(
    alpha: float = 1.0, beta: float = 1.0, delta: float = 1.0, u0: float = 4.0
) -> Problem:
    r"""A sphere that grows by what it carries: g = delta u, f = 0.

    By conservation of mass

    .. math::

        u = \frac{u_0}{r^2}, \qquad r' = \frac{\delta u_0 - 2\beta r}{r^2 + 2\alpha},

    which is integrated with SciPy to a relative tolerance of 1e-13.

    Parameters
    ----------
    alpha, beta : float
        As for :class:`Problem`.
    delta, u0 : float
        How strongly u drives the surface, and the constant u at the start.

    Returns
    -------
    Problem
        If the sphere vanishes, as for delta u0 < 0, asking for the exact solution at a later time
        is a ValueError.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> *_, last = ec.evolve(space, growing_sphere(), order=2, step=1 / 20, end=0.5)
    >>> r = np.linalg.norm(last.x, axis=1).mean()
    >>> print(f"{r:.2f} {r**2 * last.u.mean():.2f}")  # r^2 u stays
    1.26 4.00
    """
    alpha, beta = number("alpha", alpha, least=0), number("beta", beta, least=0)
    delta, u0 = number("delta", delta), number("u0", u0)

    def speed(r: float) -> float:
        return (delta * u0 - 2 * beta * r) / (r * r + 2 * alpha)

    @lru_cache(maxsize=4096)
    def radius(t: float) -> float:
        t = number("t", t)
        if t == 0:
            return 1.0
        from scipy.integrate import solve_ivp  # a tenth of the package's start, for this alone

        count = 0

        def rate(_: float, r: Array) -> Array:
            nonlocal count
            count += 1
            if count > MOST_EVALUATIONS or not r[0] > 0:  # a radius is positive
                reason = "no sphere is left" if count <= MOST_EVALUATIONS else "it is too far away"
                raise ValueError(f"t must have an exact radius, but {reason} at t = {t}")
            return speed(r[0]) * np.ones(1)

        # Relative to the radius however small that is; atol=0 would go on to where r underflows.
        with np.errstate(all="ignore"):  # found by the test of r
            solution = solve_ivp(rate, (0, t), [1.0], "DOP853", rtol=1e-13, atol=1e-63)
        if not (solution.success and solution.y[0, -1] > 0):
            raise ValueError(
                f"t must have an exact radius, but none is found at t = {t}: {solution.message}"
            )
        return float(solution.y[0, -1])

    def g(at: Surface) -> Array:
        return delta * at.u

    return _sphere_problem(radius, speed, u0, alpha=alpha, beta=beta, g=g)


def _sphere_problem(
    radius: Callable[[float], float],
    speed: Callable[[float], float],
    u0: float,
    *,
    alpha: float,
    beta: float,
    g: Callable[[Surface], Array] | None = None,
) -> Problem:
    """A sphere of radius r(t), r' = speed(r), with u = u0/r^2 constant on it."""

    def u(x: Array, t: float) -> Array:
        r = radius(t)
        if not 0 < r * r < np.inf:
            raise ValueError(f"t must be nearer to 0: there u = u0/r^2 is out of range, got {t}")
        return np.full(x.shape[:-1], u0 / r**2)

    return Problem(
        u0=lambda x: np.full(len(x), float(u0)),
        g=g,
        alpha=alpha,
        beta=beta,
        exact=_exact_sphere(
            radius,
            lambda t: speed(radius(t)),
            u,
        ),
    )


def _exact_sphere(
    radius: Callable[[float], float],
    speed: Callable[[float], float],
    u: Callable[[Array, float], Array],
) -> Exact:
    """The solution u on a sphere of radius r(t) that moves along its normals with r'(t)."""
    return Exact(
        at_points(lambda p, t: radius(t) * p),
        at_points(lambda p, t: speed(t) * p),
        at_points(u),
        at_points(lambda x, t: radius(t) * to_unit_sphere(x)),
        at_points(lambda x, t: to_unit_sphere(x)),
    )
