"""The problems of [LMV] Section 6: diffusion on surfaces whose motion is prescribed."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from esfem_core.checks import Array, one_of
from esfem_core.elements import Surface
from esfem_core.problems.problem import Exact, Problem, at_points
from esfem_core.surfaces.exact_surfaces import Ellipsoid

__all__ = ["Evaluation", "Solution", "baseball_bat", "oscillating_ellipsoid"]

Solution = Literal["decay", "oscillation"]
"""Exact solutions of :func:`oscillating_ellipsoid`."""

Evaluation = Literal["direct", "lifted"]
"""How the source of :func:`oscillating_ellipsoid` is evaluated."""


def oscillating_ellipsoid(
    solution: Solution = "decay", evaluation: Evaluation = "direct"
) -> Problem:
    r"""[LMV] Example 1: an ellipsoid whose first axis oscillates, with an exact solution.

    The surface (6.1) is at t = 0 the unit sphere:

    .. math::

        \Gamma(t) = \{x_1^2/a(t) + x_2^2 + x_3^2 = 1\}, \qquad a(t) = 1 + \tfrac14 \sin t.

    Its points move by :math:`x_1 = \sqrt{a(t)}\, p_1` with :math:`x_2, x_3` fixed, hence with
    :math:`v = (\tfrac{a'}{2a} x_1, 0, 0)`, which has a tangential part. The solution is
    :math:`u = \phi(t)\, x_1 x_2`, and the three terms of f in (2.1) are, with the unit outward
    normal,

    .. math::

        \partial^\bullet u &= \Bigl( \phi' + \phi\, \frac{a'}{2a} \Bigr) x_1 x_2, \qquad
        \nabla_\Gamma \cdot v = \frac{a'}{2a} (1 - \nu_1^2), \\
        \Delta_\Gamma u &= -\phi\, \bigl( H (\nu_1 x_2 + \nu_2 x_1) + 2 \nu_1 \nu_2 \bigr), \\
        \nu &= \frac{w}{|w|}, \qquad
        H = \frac{2 + 1/a - (\nu_1^2/a + \nu_2^2 + \nu_3^2)}{|w|}, \qquad
        w = (x_1/a, x_2, x_3).

    Parameters
    ----------
    solution : {"decay", "oscillation"}
        phi(t) = exp(-6t), of Figures 1 and 2, or cos(pi t), of Figure 3.
    evaluation : {"direct", "lifted"}
        How f, which is given on Γ, is extended to the quadrature points x, (T, Q, 3), of the
        discrete surface Γ_h. "direct": the closed form above, at x as it stands. "lifted":
        [LMV]'s f^{-l} of (2.6), constant along the normals of Γ, that is, the closed form at the
        point of Γ closest to x. The two differ by O(h^{k+1}) for elements of degree k, so by
        O(h^2) for linear ones (and by O(h^4) for quadratic ones, whose nodes a linear map takes
        from the sphere to this surface).

    Returns
    -------
    Problem
        With an exact solution, for the unit sphere as initial surface. Its "lifted" f is a
        ValueError at points that have no unique closest point.

    Raises
    ------
    ValueError
        If `solution` or `evaluation` is unknown.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.oscillating_ellipsoid("oscillation")
    >>> *_, last = ec.evolve(space, problem, order=3, step=1 / 40, end=1.0)
    >>> print(f"{last.x[:, 0].max() ** 2:.4f} {ec.errors.compare(space, problem, last).u_l2:.1e}")
    1.2104 1.3e-04
    """
    amplitudes: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
        "decay": (lambda t: np.exp(-6 * t), lambda t: -6 * np.exp(-6 * t)),
        "oscillation": (lambda t: np.cos(np.pi * t), lambda t: -np.pi * np.sin(np.pi * t)),
    }
    one_of("evaluation", evaluation, Evaluation)
    phi, dphi = amplitudes[one_of("solution", solution, Solution)]

    def a(t: float) -> float:
        return 1 + 0.25 * float(np.sin(t))

    def da(t: float) -> float:
        return 0.25 * float(np.cos(t))

    def position(p: Array, t: float) -> Array:
        x: Array = p * [np.sqrt(a(t)), 1, 1]
        return x

    def velocity(p: Array, t: float) -> Array:
        v: Array = p * [da(t) / (2 * np.sqrt(a(t))), 0, 0]
        return v

    def exact_u(x: Array, t: float) -> Array:
        return phi(t) * x[..., 0] * x[..., 1]

    def f(at: Surface) -> Array:
        x, t = at.points, at.t
        if evaluation == "lifted":
            x = _closest_on_spheroid(x, a(t))
        x1, x2, x3 = np.moveaxis(x, -1, 0)
        size = np.sqrt((x1 / a(t)) ** 2 + x2**2 + x3**2)
        n1, n2, n3 = x1 / a(t) / size, x2 / size, x3 / size
        H = (2 + 1 / a(t) - (n1**2 / a(t) + n2**2 + n3**2)) / size
        stretching = da(t) / (2 * a(t))
        material = (dphi(t) + phi(t) * stretching) * x1 * x2
        divergence = stretching * (1 - n1**2)
        laplacian = -phi(t) * (H * (n1 * x2 + n2 * x1) + 2 * n1 * n2)
        result: Array = material + phi(t) * x1 * x2 * divergence - laplacian
        return result

    at_position = at_points(position)
    return Problem(
        u0=lambda x: exact_u(x, 0.0),
        f=f,
        motion=at_position,
        exact=Exact(
            at_position,
            at_points(velocity),
            at_points(exact_u),
            at_points(lambda x, t: _closest_on_spheroid(x, a(t))),
            at_points(lambda x, t: x / [np.sqrt(a(t)), 1, 1]),
        ),
    )


def _closest_on_spheroid(x: Array, a: float) -> Array:
    """Points of {y1^2/a + y2^2 + y3^2 = 1} closest to x, (..., 3)."""
    return Ellipsoid((float(np.sqrt(a)), 1.0, 1.0)).closest(x)


def baseball_bat(u0: Callable[[Array], Array] | Array | None = None) -> Problem:
    r"""[LMV] Example 2: the unit sphere becomes a baseball bat at t = 1; no source.

    The motion (6.2) takes p of the unit sphere to

    .. math::

        x_1 &= p_1 + \max(0, p_1)\, t, \qquad (x_2, x_3) = c\, (p_2, p_3), \\
        c &= e^{-2t} + (1 - e^{-2t}) \bigl( s\, (p_1^2 + 0.05) + p_1^2 \bigr), \qquad
        s = \sqrt{p_2^2 + p_3^2}.

    c is the paper's g/s without its 0/0 at the poles (±1, 0, 0), which are nodes and stay on the
    axis: on the unit sphere :math:`s = \sqrt{1 - p_1^2}` divides g.

    The velocity is only Lipschitz across p1 = 0, where the derivative of its first component jumps
    by 1, and with it the curvature of the surface, which remains continuously differentiable. At
    the poles the motion has Lipschitz first derivatives, but no second ones. The problem is
    outside the theory, which supposes a smooth evolution.

    Parameters
    ----------
    u0 : callable, array or float, optional
        Initial values, as for :class:`Problem`; the paper's x1 x2 if None. Their integral,
        which is conserved, is zero for the paper's.

    Returns
    -------
    Problem
        Without an exact solution, for the unit sphere as initial surface.

    Raises
    ------
    TypeError, ValueError
        As of :class:`Problem`.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3))
    >>> *_, last = ec.evolve(space, ec.problems.baseball_bat(), order=2, step=1 / 20, end=1.0)
    >>> last.x[:, 0].min().item(), last.x[:, 0].max().item()
    (-1.0, 2.0)
    >>> waist = np.hypot(last.x[:, 1], last.x[:, 2])[space.nodes[:, 0] == 0]
    >>> print(f"{waist.min():.4f} {waist.max():.4f}")
    0.1786 0.1786
    """

    def motion(p: Array, t: float) -> Array:
        p1, p2, p3 = np.moveaxis(p, -1, 0)
        decay, s = np.exp(-2 * t), np.hypot(p2, p3)
        c = decay + (1 - decay) * (s * (p1**2 + 0.05) + p1**2)
        return np.stack([p1 + np.maximum(0, p1) * t, c * p2, c * p3], axis=-1)

    return Problem(u0=(lambda x: x[:, 0] * x[:, 1]) if u0 is None else u0, motion=motion)
