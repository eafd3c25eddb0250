"""What is solved: the papers' own problems, spheres, and problems made for a solution."""

from esfem_core.problems.manufactured import manufactured
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
    "manufactured",
    "oscillating_ellipsoid",
    "shrinking_sphere",
]
