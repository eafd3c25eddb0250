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
Evaluation = Literal["direct", "lifted"]


def oscillating_ellipsoid(
    solution: Solution = "decay", evaluation: Evaluation = "direct"
) -> Problem:
    r"""[LMV] Example 1: an ellipsoid whose first axis oscillates, with an exact solution.

    The surface (6.1) is Γ(t) = {x1^2/a(t) + x2^2 + x3^2 = 1} with a(t) = 1 + sin(t)/4, at t = 0
    the unit sphere. Its points move by x1 = sqrt(a(t)) p1 with x2 and x3 fixed, hence with
    v = (a'/(2a) x1, 0, 0), which has a tangential part. The solution is u = phi(t) x1 x2, and
    f = u' + u div v - lap u of (2.1) is, with ν the unit outward normal::

        u'    = (phi' + phi a'/(2a)) x1 x2
        div v = a'/(2a) (1 - ν1^2)
        lap u = -phi (H (ν1 x2 + ν2 x1) + 2 ν1 ν2)
        ν     = w/|w|,  H = (2 + 1/a - (ν1^2/a + ν2^2 + ν3^2))/|w|,  w = (x1/a, x2, x3).

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

    The motion (6.2) takes p of the unit sphere to::

        x1 = p1 + max(0, p1) t,      (x2, x3) = c (p2, p3),
        c  = e^{-2t} + (1 - e^{-2t}) (s (p1^2 + 0.05) + p1^2),      s = sqrt(p2^2 + p3^2).

    c is the paper's g/s without its 0/0 at the poles (±1, 0, 0), which are nodes and stay on the
    axis: on the unit sphere s = sqrt(1 - p1^2) divides g.

    The velocity is only Lipschitz across p1 = 0, where the derivative of its first component jumps
    by 1, and with it the curvature of the surface, which remains continuously differentiable. At
    the poles the motion has Lipschitz first derivatives, but no second ones. The problem is
    outside the theory, which supposes a smooth evolution.

    Parameters
    ----------
    u0 : callable or (N,) or (N, m) array, optional
        Initial values, as for :class:`Problem`; the paper's x1 x2 if None. Their integral,
        which is conserved, is zero for the paper's.

    Returns
    -------
    Problem
        Without an exact solution, for the unit sphere as initial surface.

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
