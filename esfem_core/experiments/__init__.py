"""The papers' experiments at the papers' own resolution: ``python -m esfem_core.experiments``."""

from esfem_core.campaign import Experiment
from esfem_core.experiments.baseball_bat import BAT_EXPERIMENTS
from esfem_core.experiments.theorem import THEOREM

__all__ = ["EXPERIMENTS"]

EXPERIMENTS: list[Experiment] = [THEOREM, *BAT_EXPERIMENTS]
"""All of them, in the order of the book."""
