"""What is solved: the papers' own problems, and two with simple exact solutions."""

from esfem_core.problems.prescribed import Evaluation, Solution, baseball_bat, oscillating_ellipsoid
from esfem_core.problems.problem import Exact, Problem
from esfem_core.problems.spheres import (
    Coupling,
    expanding_sphere,
    growing_sphere,
    logistic_sphere,
    shrinking_sphere,
)

__all__ = [
    "Coupling",
    "Evaluation",
    "Exact",
    "Problem",
    "Solution",
    "baseball_bat",
    "expanding_sphere",
    "growing_sphere",
    "logistic_sphere",
    "oscillating_ellipsoid",
    "shrinking_sphere",
]
