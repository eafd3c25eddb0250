"""The papers' experiments at the papers' own resolution: ``python -m esfem_core.experiments``."""

from esfem_core.campaign import Experiment
from esfem_core.experiments import ellipsoid

__all__ = ["EXPERIMENTS"]

EXPERIMENTS: list[Experiment] = [*ellipsoid.EXPERIMENTS]
"""All of them, in the order of the book."""
