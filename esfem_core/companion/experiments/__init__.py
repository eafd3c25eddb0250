"""The papers' experiments at the papers' own resolution.

The command that runs them is ``python -m esfem_core.companion.experiments``.
"""

from esfem_core.companion.experiments import (
    baseball_bat,
    ellipsoid,
    expanding_sphere,
    mass_matrices,
    mass_runtime,
    theorem,
)
from esfem_core.study import Experiment

__all__ = ["EXPERIMENTS"]

EXPERIMENTS: list[Experiment] = [
    *theorem.EXPERIMENTS,
    *ellipsoid.EXPERIMENTS,
    *baseball_bat.EXPERIMENTS,
    *expanding_sphere.EXPERIMENTS,
    *mass_matrices.EXPERIMENTS,
    *mass_runtime.EXPERIMENTS,
]
"""All of them, in the order of the book."""
