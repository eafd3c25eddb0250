"""The defects' parts that time makes, term by term as in the proof of [N] Lemma 6.1."""

import numpy as np
from numpy.typing import NDArray

from esfem_core.bdf import delta, gamma
from esfem_core.defects import (
    combined,
    diffusion,
    interpolant,
    mass_times,
    rate_of_mass,
    rate_of_u,
    source_load,
    stretching,
    values_of,
)
from esfem_core.problem import Problem
from esfem_core.surface import SurfaceSpace

__all__ = ["temporal_terms_u", "temporal_terms_v"]

Array = NDArray[np.float64]
Values = tuple[Array, Array, Array]


def temporal_terms_v(
    space: SurfaceSpace, problem: Problem, order: int, step: float, t: float
) -> dict[str, Array]:
    """The part of M d_v that time makes, term by term as in [N] (6.1).

    Parameters
    ----------
    space, problem, order, step
        As for :func:`esfem_core.defects.defects`; the surface moves by the velocity law.
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
        As for :func:`esfem_core.defects.defects`; the surface moves by the velocity law.
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
