"""The defects term by term, as the proof of [N] Lemma 6.1 splits them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping.bdf import delta, gamma
from esfem_core.surfaces.exact_surfaces import ExactSurface
from esfem_core.theory.defects import (
    combined,
    difference,
    diffusion,
    interpolant,
    mass_times,
    rate_of_mass,
    rate_of_u,
    source_load,
    stretching,
    values_of,
)
from esfem_core.theory.forms import divergence, gradient_load, lift, stiffness

__all__ = ["Field", "spatial_terms_u", "temporal_terms_u", "temporal_terms_v"]

Array = NDArray[np.float64]
Values = tuple[Array, Array, Array]


def temporal_terms_v(
    space: SurfaceSpace, problem: Problem, order: int, step: float, t: float
) -> dict[str, Array]:
    """The part of M d_v that time makes, term by term as in [N] (6.1).

    Parameters
    ----------
    space, problem, order, step
        As for :func:`esfem_core.theory.defects.defects`; the surface moves by the velocity law.
    t : float
        At which there are p earlier levels.

    Returns
    -------
    dict of str to (N, 3) float array
        "M", "alpha A" and "beta A": the matrices at x~_* minus those at x_*. "g, surface": the
        same for g. "g, extrapolated u": g(x~_*, u_*) - g(x~_*, u~_*), which the scheme has and
        (6.1) has not.
    """
    (x_now, u_now, v_now), (x, u, _) = _extrapolation(space, problem, order, step, t)
    (Mt, At), (M, A) = space.mass_stiffness(x), space.mass_stiffness(x_now)
    on_extrapolated = source_load(space, problem, "g", x, u_now, t)
    return {
        "M": Mt @ v_now - M @ v_now,
        "alpha A": problem.alpha * (At @ v_now - A @ v_now),
        "beta A": problem.beta * (At @ x_now - A @ x_now),
        "g, surface": source_load(space, problem, "g", x_now, u_now, t) - on_extrapolated,
        "g, extrapolated u": on_extrapolated - source_load(space, problem, "g", x, u, t),
    }


def temporal_terms_u(
    space: SurfaceSpace, problem: Problem, order: int, step: float, n: int
) -> dict[str, Array]:
    """The part of M d_u that time makes, term by term as in [N] 6.2.

    Parameters
    ----------
    space, problem, order, step
        As for :func:`esfem_core.theory.defects.defects`; the surface moves by the velocity law.
    n : int
        Number of the step, 2 p or more, so that every level is extrapolated.

    Returns
    -------
    dict of str to (N,) float array
        "BDF": the quotient minus the derivative of M(x~_*) u_*. "(6.9)": M(x~_*) - M(x_*), applied
        to the material derivative of u. "(6.16)": the velocity of the extrapolated surface against
        the exact one. "(6.17)": the same divergence on both surfaces. "A": A(x~_*) - A(x_*).
        "(6.22)": f on both surfaces. "f, extrapolated u": as in :func:`temporal_terms_v`.

    Raises
    ------
    ValueError
        If n < 2 p.
    """
    if n < 2 * order:
        raise ValueError(f"all levels are extrapolated from n = 2 p = {2 * order} on, got n = {n}")
    t = n * step
    (x_now, u_now, v_now), (x, u, v) = _extrapolation(space, problem, order, step, t)
    rate, masses = rate_of_u(space, problem, t), []
    for j in range(order + 1):
        level, extrapolated = _extrapolation(space, problem, order, step, t - j * step)
        masses.append(mass_times(space, extrapolated[0], level[1]))
    quotient = combined(delta(order), masses) / step
    f_surface = source_load(space, problem, "f", x, u_now, t)
    (Mt, At), (M, A) = space.mass_stiffness(x), space.mass_stiffness(x_now)
    return {
        "BDF": quotient - rate_of_mass(space, x, v, u_now, rate),
        "(6.9)": Mt @ rate - M @ rate,
        "(6.16)": stretching(space, x, v - v_now, u_now),
        "(6.17)": stretching(space, x, v_now, u_now) - stretching(space, x_now, v_now, u_now),
        "A": diffusion(problem, At, u_now) - diffusion(problem, A, u_now),
        "(6.22)": source_load(space, problem, "f", x_now, u_now, t) - f_surface,
        "f, extrapolated u": f_surface - source_load(space, problem, "f", x, u, t),
    }


def _extrapolation(
    space: SurfaceSpace, problem: Problem, order: int, step: float, t: float
) -> tuple[Values, Values]:
    """x_*, u_*, v_* at t; and x~_*, u~_* and the velocity of x~_* there."""
    past = [values_of(interpolant(space, problem, t - (j + 1) * step)) for j in range(order)]
    x, u, v = (combined(gamma(order), values) for values in zip(*past, strict=True))
    return values_of(interpolant(space, problem, t)), (x, u, v)


class Field(NamedTuple):
    """What the spatial terms need to know of an exact solution.

    Attributes
    ----------
    surface : callable
        surface(t): Γ(t), an :class:`esfem_core.surfaces.exact_surfaces.ExactSurface`.
    v : callable
        v(x, t): velocity at points x, (..., 3), of Γ(t), given also near Γ(t).
    f : callable
        f(x, t): right-hand side at points of Γ(t), with the exact u and its gradient inserted.
    """

    surface: Callable[[float], ExactSurface]
    v: Callable[[Array, float], Array]
    f: Callable[[Array, float], Array]


def spatial_terms_u(
    space: SurfaceSpace, problem: Problem, field: Field, t: float
) -> dict[str, Array]:
    """The part of M d_u that space makes, term by term as in [N] 6.2, at x_* = x_*(t).

    The exact weak form, tested with lifts, is subtracted; so all terms but the last add up to
    :func:`esfem_core.theory.defects.spatial_defects` if u solves the equation on the surface.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution u that is given also near the surface.
    field : Field
    t : float

    Returns
    -------
    dict of str to (N,) float array
        With u' the material derivative and v^ the velocity of the lift of a particle of Γ_h:
        "u', interpolated" and "u', lifted" are (6.8) to (6.10), "u', v^" is what (5.2) bounds;
        then "(6.18)", "(6.19)" and "(6.20)", the two spatial differences of (ii), and "(6.23)".
        Last, and not to be added to the others, "(6.4), test function": -m(X; u, phi'^l), which
        the proof has, but the exact weak form for test functions with phi'^l != 0 has not.
    """
    x, u, v = values_of(interpolant(space, problem, t))
    onto = lift(space, x, field.surface(t))
    y, ratio, u_h = onto.points, onto.ratio, space.evaluate(u)
    tangential = np.eye(3) - onto.normal[..., :, None] * onto.normal[..., None, :]
    assert problem.exact is not None
    exact_u = problem.exact.u

    def slope(function: Callable[[Array], Array]) -> Array:
        """Ambient derivatives at y, last index."""
        return np.stack([along(function, e) for e in np.eye(3)], -1)

    def along(function: Callable[[Array], Array], e: Array) -> Array:
        return difference(lambda s: function(y + s * e))

    grad_u = (tangential @ slope(lambda z: exact_u(z, t))[..., None])[..., 0]
    v_exact = field.v(y, t)
    div_v = np.einsum("...ij,...ji->...", slope(lambda z: field.v(z, t)), tangential)
    rate = difference(lambda s: exact_u(y + s * v_exact, t + s))

    def moved(s: float) -> tuple[Array, Array]:
        then = lift(space, interpolant(space, problem, t + s).x, field.surface(t + s))
        weight = then.ratio * space.density(interpolant(space, problem, t + s).x)
        return then.points, weight

    v_lift = difference(lambda s: moved(s)[0])
    q_lift = difference(lambda s: moved(s)[1]) / space.density(x)  # (div v^) times ratio
    slip = v_lift - v_exact
    rate_lift = rate + np.sum(grad_u * slip, -1)
    rate_h = space.evaluate(rate_of_u(space, problem, t))

    def m(values: Array) -> Array:
        return space.load(x, values)

    pulled = np.swapaxes(onto.gradient, -1, -2)

    def a(gradient: Array) -> Array:
        return gradient_load(space, x, ratio[..., None] * (pulled @ gradient[..., None])[..., 0])

    A, A_lift = space.mass_stiffness(x)[1], stiffness(space, x, onto.tensor)
    exact = exact_u(y, t)
    return {
        "u', interpolated": m(rate_h - rate_lift),
        "u', lifted": m((1 - ratio) * rate_lift),
        "u', v^": m(ratio * (rate_lift - rate)),
        "(6.18)": m((divergence(space, x, v) - q_lift) * u_h),
        "(6.19)": m((q_lift - ratio * div_v) * u_h),
        "(6.20)": m(ratio * div_v * (u_h - exact)),
        "A, lifted": diffusion(problem, A, u) - diffusion(problem, A_lift, u),
        "A, interpolated": diffusion(problem, A_lift, u) - problem.diffusivity * a(grad_u),
        "(6.23)": m(ratio * field.f(y, t)) - source_load(space, problem, "f", x, u, t),
        "(6.4), test function": a(exact[..., None] * slip),
    }
