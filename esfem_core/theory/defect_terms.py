"""The defects term by term, as the proof of [N] Lemma 6.1 splits them."""

from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np

from esfem_core.checks import Array, finite_array, function, number, object_of, whole_number
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.problems import Exact, Problem
from esfem_core.stepping import bdf, check_on_exact_surface, exact_state
from esfem_core.surfaces import derivative
from esfem_core.surfaces.exact_surfaces import ExactSurface
from esfem_core.theory.defects import (
    NodalValues,
    constant_diffusivity,
    diffusion,
    exact_values,
    force_load,
    rate_of_mass,
    rate_of_u,
    source_load,
    stretching,
    velocity_law,
)
from esfem_core.theory.forms import Lift, divergence, lift, stiffness
from esfem_core.theory.geometry import apply, tangent_projection

__all__ = ["Field", "spatial_terms_u", "temporal_terms_u", "temporal_terms_v"]


def temporal_terms_v(
    space: SurfaceSpace, problem: Problem, order: int, step: float, t: float
) -> dict[str, Array]:
    """The temporal part of M d_v, term by term as in [N] (6.1).

    Parameters
    ----------
    space, problem, order, step
        As for :func:`esfem_core.theory.defects.defects`; the surface moves by the velocity law.
    t : float
        At which there are p earlier levels.

    Returns
    -------
    dict of str to (N, 3) float array
        "M", "alpha A" and "beta A": the matrices at x~_* minus those at x_*, applied to v_*, v_*
        and x_*. "g, surface": g(x_*, u_*) - g(x~_*, u_*), since g stands on the other side.
        "g, extrapolated u": g(x~_*, u_*) - g(x~_*, u~_*), which the scheme has and (6.1) has not.

    Raises
    ------
    TypeError, ValueError
        If a number is out of range, there is no exact solution of this surface, or the motion is
        prescribed.

    Examples
    --------
    They add up to what the defects have beyond those of the semi-discretization:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> from esfem_core.theory.defects import defects, spatial_defects
    >>> problem = ec.problems.expanding_sphere()
    >>> terms = temporal_terms_v(space, problem, 2, 1 / 40, 0.5)
    >>> whole, limit = defects(space, problem, 2, 1 / 40, 20), spatial_defects(space, problem, 0.5)
    >>> bool(np.allclose(sum(terms.values()), whole.v - limit.v, rtol=0, atol=1e-12))
    True
    """
    order, step = _checked(space, problem, order, step)
    t = number("t", t)
    law = velocity_law(problem)
    now = exact_values(space, problem, t)
    check_on_exact_surface(space, problem, now.x, t)
    far = _extrapolated(space, problem, order, step, t)
    (Mt, At), (M, A) = space.mass_stiffness(far.x), space.mass_stiffness(now.x)
    on_extrapolated = force_load(space, problem, far.x, now.u, t)
    return {
        "M": Mt @ now.v - M @ now.v,
        "alpha A": law.alpha * (At @ now.v - A @ now.v),
        "beta A": law.beta * (At @ now.x - A @ now.x),
        "g, surface": force_load(space, problem, now.x, now.u, t) - on_extrapolated,
        "g, extrapolated u": on_extrapolated - force_load(space, problem, far.x, far.u, t),
    }


def temporal_terms_u(
    space: SurfaceSpace, problem: Problem, order: int, step: float, n: int
) -> dict[str, Array]:
    """The temporal part of M d_u, term by term as in [N] 6.2.

    The derivative of u is that of :func:`esfem_core.theory.defects.rate_of_u`.

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
        to the material derivative of u. "(6.16)": q with the velocity of the extrapolated surface
        minus q with the exact one, both at x~_*. "(6.17)": q with the exact one at x~_* minus that
        at x_*. "A": A(x~_*) - A(x_*), applied to u_*. "(6.22)": f(x_*, u_*) - f(x~_*, u_*).
        "f, extrapolated u": f(x~_*, u_*) - f(x~_*, u~_*).

    Raises
    ------
    TypeError, ValueError
        If n < 2 p, or as for :func:`temporal_terms_v`.

    Examples
    --------
    They add up to what the defects have beyond those of the semi-discretization:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> from esfem_core.theory.defects import defects, spatial_defects
    >>> problem = ec.problems.expanding_sphere()
    >>> terms = temporal_terms_u(space, problem, 2, 1 / 40, 20)
    >>> whole, limit = defects(space, problem, 2, 1 / 40, 20), spatial_defects(space, problem, 0.5)
    >>> bool(np.allclose(sum(terms.values()), whole.u - limit.u, rtol=0, atol=1e-12))
    True
    """
    order, step = _checked(space, problem, order, step)
    n = whole_number("n", n, 0)
    if n < 2 * order:
        raise ValueError(f"n must be at least 2 p = {2 * order}, got {n}")
    t = n * step
    now = exact_values(space, problem, t)
    check_on_exact_surface(space, problem, now.x, t)
    far = _extrapolated(space, problem, order, step, t)
    rate, masses = rate_of_u(space, problem, t), []
    for j in range(order + 1):
        then = t - j * step
        surface = _extrapolated(space, problem, order, step, then).x
        masses.append(space.mass_times(surface, exact_state(space, problem, then).u))
    quotient = bdf.combine(bdf.delta(order), masses) / step
    f_surface = source_load(space, problem, far.x, now.u, t)
    (Mt, At), (M, A) = space.mass_stiffness(far.x), space.mass_stiffness(now.x)
    on_extrapolated = stretching(space, far.x, now.v, now.u)
    return {
        "BDF": quotient - rate_of_mass(space, far.x, far.v, now.u, rate),
        "(6.9)": Mt @ rate - M @ rate,
        "(6.16)": stretching(space, far.x, far.v - now.v, now.u),
        "(6.17)": on_extrapolated - stretching(space, now.x, now.v, now.u),
        "A": diffusion(problem, At, now.u) - diffusion(problem, A, now.u),
        "(6.22)": source_load(space, problem, now.x, now.u, t) - f_surface,
        "f, extrapolated u": f_surface - source_load(space, problem, far.x, far.u, t),
    }


def _checked(space: SurfaceSpace, problem: Problem, order: int, step: float) -> tuple[int, float]:
    object_of("space", space, SurfaceSpace)
    constant_diffusivity(problem)
    velocity_law(problem)
    return whole_number("order", order, 1, bdf.MOST_STEPS), number("step", step, above=0)


def _extrapolated(
    space: SurfaceSpace, problem: Problem, order: int, step: float, t: float
) -> NodalValues:
    """x~_* at t, its velocity and u~_*."""
    past = [exact_values(space, problem, t - (j + 1) * step) for j in range(order)]
    return NodalValues(*(bdf.extrapolate(values) for values in zip(*past, strict=True)))


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
    """The spatial part of M d_u, term by term as in [N] 6.2, at x_* = x_*(t).

    The exact weak form, tested with lifts, is subtracted; so all terms but the last add up to
    :func:`esfem_core.theory.defects.spatial_defects`, up to the error of quadrature (give the space
    a high `exactness`), if u solves the equation on the surface. Derivatives are differences with a
    step of 0.01, for surfaces and times of a size of about one.

    Parameters
    ----------
    space, problem : SurfaceSpace, Problem
        With an exact solution u of one component, given also near the surface.
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

    Raises
    ------
    ValueError
        If there is no exact solution of this surface, u has several components or does not return
        (n,) at points (n, 3), or `field` returns something of the wrong shape or not finite.
    """
    object_of("field", field, Field)
    for name, of in (("surface", "a time"), ("v", "points and a time"), ("f", "points and a time")):
        function(f"field.{name}", getattr(field, name), f"of {of}")
    t = number("t", t)
    x, v, u = exact_values(space, problem, t)
    check_on_exact_surface(space, problem, x, t)
    finite_array("the exact u", u, (len(x),))
    at, onto = Surface(space, x), lift(space, x, field.surface(t))
    ratio, exact = onto.ratio, _exact_at(problem, field, onto, t)
    v_lift, q_lift = _lift_motion(space, problem, field, t)
    slip = v_lift - exact.v
    rate_lift = exact.rate + np.sum(exact.grad_u * slip, -1)
    rate_h, u_h = space.evaluate(rate_of_u(space, problem, t)), space.evaluate(u)
    pulled = np.swapaxes(onto.gradient, -1, -2)

    def a(gradient: Array) -> Array:
        return at.load(None, ratio[..., None] * apply(pulled, gradient))

    m = at.load
    D, A, A_lift = constant_diffusivity(problem), at.A, stiffness(space, x, onto.tensor)
    return {
        "u', interpolated": m(rate_h - rate_lift),
        "u', lifted": m((1 - ratio) * rate_lift),
        "u', v^": m(ratio * (rate_lift - exact.rate)),
        "(6.18)": m((divergence(space, x, v) - q_lift) * u_h),
        "(6.19)": m((q_lift - ratio * exact.div_v) * u_h),
        "(6.20)": m(ratio * exact.div_v * (u_h - exact.u)),
        "A, lifted": diffusion(problem, A, u) - diffusion(problem, A_lift, u),
        "A, interpolated": diffusion(problem, A_lift, u) - D * a(exact.grad_u),
        "(6.23)": m(ratio * exact.f) - source_load(space, problem, x, u, t),
        "(6.4), test function": a(exact.u[..., None] * slip),
    }


class _Exact(NamedTuple):
    """The exact solution at the lifts of the quadrature points; the rate is the material one."""

    u: Array
    grad_u: Array
    rate: Array
    v: Array
    div_v: Array
    f: Array


def _exact_at(problem: Problem, field: Field, onto: Lift, t: float) -> _Exact:
    y, tangential = onto.points, tangent_projection(onto.normal)
    exact_u = cast(Exact, problem.exact).functions["u"]

    def u(z: Array, s: float) -> Array:
        """Of points (T, Q, 3); the function is one of points (n, 3), and may be called again."""
        points = z.reshape(-1, 3).copy()
        values = finite_array("exact.u(x, t)", exact_u(points, s), (len(points),))
        return np.array(values).reshape(z.shape[:-1])

    def slope(of: Callable[[Array], Array]) -> Array:
        """Ambient derivatives at y, last index."""
        return np.stack([along(of, e) for e in np.eye(3)], -1)

    def along(of: Callable[[Array], Array], e: Array) -> Array:
        return derivative(lambda s: of(y + s * e))

    v = np.array(finite_array("field.v(x, t)", field.v(y.copy(), t), y.shape))  # v is called again
    return _Exact(
        u=u(y, t),
        grad_u=apply(tangential, slope(lambda z: u(z, t))),
        rate=derivative(lambda s: u(y + s * v, t + s)),
        v=v,
        div_v=np.einsum("...ij,...ji->...", slope(lambda z: field.v(z, t)), tangential),
        f=finite_array("field.f(x, t)", field.f(y.copy(), t), y.shape[:-1]),
    )


def _lift_motion(
    space: SurfaceSpace, problem: Problem, field: Field, t: float
) -> tuple[Array, Array]:
    """Velocity v^ of the lifts of the quadrature points, and its divergence times the ratio."""

    def moved(s: float) -> tuple[Array, Array]:
        """Lifts at t + s, and the area that they carry."""
        x = exact_state(space, problem, t + s).x
        onto = lift(space, x, field.surface(t + s))
        return onto.points, onto.ratio * space.density(x)

    density = space.density(exact_state(space, problem, t).x)
    return derivative(lambda s: moved(s)[0]), derivative(lambda s: moved(s)[1]) / density
