"""Whether alpha and diffusivities are numbers for the size of the surface.

And what makes right-hand sides, which are integrals, as large as on a surface of size 1.
"""

import math
import warnings
from collections.abc import Iterator

import numpy as np

from esfem_core.checks import Array, level_outside
from esfem_core.elements import SurfaceSpace
from esfem_core.laws import Dynamic, Regularised
from esfem_core.problems import Problem
from esfem_core.stepping.agreement import innermost
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.state import State

__all__ = ["check_units", "factor_to_size_one"]

# A takes constants to zero but for rounding, so in M + s A amounts, and the translation of all
# nodes, stand against 1e-16 s. For s = LARGEST r^2, with the squared radius r^2 of a sphere as
# large, a step loses 2e-7 of them with 162 nodes of degree 1 and 2e-5 with 5762 of degree 3, and
# proportionally more for larger s, with every solver.
LARGEST = 1e8


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
