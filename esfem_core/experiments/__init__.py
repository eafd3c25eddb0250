"""The papers' experiments at the papers' own resolution: ``python -m esfem_core.experiments``."""

from esfem_core.campaign import Experiment

__all__ = ["EXPERIMENTS"]

EXPERIMENTS: list[Experiment] = []
"""All of them, in the order of the book."""
