"""Whether alpha, diffusivities, rates and sizes are numbers that leave digits of the solution.

And what makes right-hand sides, which are integrals, as large as on a surface of size 1.
"""

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from esfem_core.checks import Array, level_outside
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.laws import Dynamic, Prescribed, Regularised, Species
from esfem_core.problems import Problem
from esfem_core.solvers import ROUNDING, RTOL
from esfem_core.stepping.agreement import innermost
from esfem_core.stepping.bdf import delta
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.state import State
from esfem_core.surfaces import components, normals_of

__all__ = ["check_components", "check_rates", "check_units", "factor_to_size_one"]

# A takes constants to zero but for rounding, so in M + s A amounts, and the translation of all
# nodes, stand against 1e-16 s. For s = LARGEST r^2, with the squared radius r^2 of a sphere as
# large, a step loses 2e-7 of them with 162 nodes of degree 1 and 2e-5 with 5762 of degree 3, and
# proportionally more for larger s, with every solver.
LARGEST = 1e8

LOST = 1e-6  # of the largest value: from here on worth a warning
# What is lost on a component where its right-hand side is as large as the whole: measured with 20
# to 5,120 triangles each, for ratios of areas of 1e2 to 1e6.
LOST_ALONE = 10 * RTOL
ITERATIVE = ("lagged", "cholmod")


def factor_to_size_one(space: SurfaceSpace) -> float:
    """A power of 1024 that brings the squared radius of the surface near 1, as check_units has it.

    Examples
    --------
    >>> import esfem_core as ec
    >>> sphere = ec.sphere("icosahedron", 2)
    >>> factor_to_size_one(ec.SurfaceSpace(sphere))
    1.0
    >>> factor_to_size_one(ec.SurfaceSpace(sphere.apply_scale(1e-3))) == 1024**2
    True
    """
    square = min(max(_squared_radius(space, space.nodes), 1e-290), 1e290)
    return 1024.0 ** -round(math.log(square, 1024))


def check_units(space: SurfaceSpace, problem: Problem, first: State, step: float) -> None:
    """Look for what is so large that rounding takes amounts or the motion of the whole surface.

    As where nodes are in metres, the surface is that of a cell, and D = 1 is left as it is. Of
    coefficients that are functions nothing is known.

    Warns
    -----
    EvolutionWarning
        For alpha, or D times the step, beyond 1e8 area/(4 pi).
    """
    square = _squared_radius(space, first.x)
    for called, s, lost in _large(problem, step):
        if s > LARGEST * square > 0:
            warnings.warn(
                f"{called} is {s:.3g}, {s / square:.1g} times area/(4 pi), the squared radius of a "
                f"sphere as large as the surface: beyond {LARGEST:.0g} times, rounding takes 2e-7 "
                f"to 2e-5 of {lost} in each step, and more in proportion. Is it meant in the units "
                "of the nodes? Take such that the surface is about 1 across, and a smaller number "
                "if it is as large in these",
                EvolutionWarning,
                stacklevel=level_outside(),
            )


def check_rates(
    problem: Problem, first: State, order: int, step: float, solver: str | Callable[[], object]
) -> None:
    """Look for rates that make a system so much larger at some places that others lose digits.

    As a penalty does, rate and source R at some places only. Where rate and source are of one size
    everywhere nothing is lost, however large they are.

    Parameters
    ----------
    problem : Problem
    first : State
        What rates and sources are looked at on; those that cannot be computed are left to the step.
    order : int
    step : float
    solver : str or callable
        Of "direct" and of one's own nothing is asked.

    Warns
    -----
    EvolutionWarning
        If a step may lose more than 1e-6 of the values where the rate is small.
    """
    if solver not in ITERATIVE:
        return
    at, weight = first.surface(), delta(order)[0] / step
    for name, species in problem.all_species.items():
        if not callable(species.rate):
            continue
        lost = 0.0
        with suppress(Exception), np.errstate(all="ignore"):
            lost = _lost(species, at, name, weight)
        if LOST < lost < np.inf:
            warnings.warn(
                f"the rate of {name!r} is so much larger at some places than at others that, where "
                f"it is small, each step may lose up to {lost:.1g} of {name!r}: solver={solver!r} "
                f"leaves a residual of {RTOL:g} of the whole right-hand side. Take a smaller rate "
                'or solver="direct"; values that are given at nodes need no rate, but '
                "Species(fixed=(nodes, values))",
                EvolutionWarning,
                stacklevel=level_outside(),
            )


def check_components(
    space: SurfaceSpace, problem: Problem, first: State, solver: str | Callable[[], object]
) -> None:
    """Look for components so small beside others that iterative solvers lose digits on them.

    A right-hand side is about as large as the areas of the triangles. Where the smallest of these
    leaves no chance, as on meshes of one size with fewer than 1e8, components are not looked for.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        Nothing is lost where it solves no system.
    first : State
        With the nodes that areas are looked at on.
    solver : str or callable
        Of "direct" and of one's own nothing is asked.

    Warns
    -----
    EvolutionWarning
        If steps may lose more than 1e-6 of the values on a component, as where its area is 1e-4 of
        that of another with as many triangles.
    """
    solves = problem.all_species or not isinstance(innermost(problem.law), Prescribed)
    if solver not in ITERATIVE or not solves:
        return
    faces = space.cells[:, :3]
    area = np.linalg.norm(normals_of(first.x, faces), axis=1)
    with np.errstate(all="ignore"):  # what is degenerate or not finite is left to the step
        area /= area.max()
        if not LOST_ALONE * np.linalg.norm(area) > LOST * area.min():
            return
        component = components(faces)
        squares = np.bincount(component, area**2)
        lost = LOST_ALONE * math.sqrt(squares.sum() / squares.min())
    if LOST < lost < np.inf:
        i = int(squares.argmin())
        share = np.bincount(component, area)[i] / area.sum()
        warnings.warn(
            f"component {i} of the surface has {share:.1g} of its area, so little that steps may "
            f"lose a share of about {min(lost, 1):.1g} of the values there: solver={solver!r} "
            f'leaves a residual of {RTOL:g} of the whole right-hand side. Take solver="direct"',
            EvolutionWarning,
            stacklevel=level_outside(),
        )


def _lost(species: Species, at: Surface, name: str, weight: float) -> float:
    """A bound of what residuals leave in a species in a step, over its largest value.

    K = weight M + A + (mass matrix of the rate), and the right-hand side, have weight + rate and
    weight u + source as densities: their quotient is about the new u. Conjugate gradients leave
    a residual of RTOL of the whole right-hand side, or of the rounding errors in K u, wherever K is
    smallest.
    """
    u = np.abs(at[name])
    [part, *_] = species.parts(name, at)
    given = None if species.source is None else species.source(at)
    source = given[0] if isinstance(given, tuple) else given  # a flux is not looked at
    K = (weight + part.rate).reshape(*u.shape[:2], *(1,) * (u.ndim - 2))
    b = weight * u + np.abs(0.0 if source is None else source)
    values = (b / K).max(axis=(0, 1))
    shares = (b.max(axis=(0, 1)) / K.min())[values > 0] / values[values > 0]
    return float(RTOL * shares.max(initial=0.0) + ROUNDING * K.max() / K.min())


def _large(problem: Problem, step: float) -> Iterator[tuple[str, float, str]]:
    """What may be too large, by name; the number s of M + s A; and what then is lost."""
    law = innermost(problem.law)
    if isinstance(law, Regularised):
        yield "alpha, a squared length,", law.alpha, "the motion of the surface as a whole"
    for name, species in problem.all_species.items():
        if species.fixed is not None or callable(species.rate) or callable(species.diffusivity):
            continue  # with values given somewhere, constants are not taken to zero
        D = float(np.max(species.diffusivity))
        own = isinstance(law, Dynamic) and name in problem.law_species
        called = f"{'alpha' if own else f'the diffusivity of {name!r}'}, {D:.3g}, times the step"
        lost = f"the {'amount' if species.conserved else 'mean'} of {name!r}"
        yield called, D * step / (1 + step * (species.rate or 0.0)), lost


def _squared_radius(space: SurfaceSpace, x: Array) -> float:
    """Of a sphere with the area of the flat triangles."""
    a, b, c = x[space.cells[:, :3]].swapaxes(0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / (8 * np.pi))
