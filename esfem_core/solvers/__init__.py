"""Linear systems: symmetric positive definite, sparse, changing a little from step to step.

Knows arrays only, no mesh class and no problem.
"""

from esfem_core.solvers.dissection import Dissection, dissect
from esfem_core.solvers.factors import DirectSolver, Factor, Solver, cholmod, superlu
from esfem_core.solvers.fronts import Fronts
from esfem_core.solvers.lagged import LaggedSolver
from esfem_core.solvers.multifrontal import BlockFactor, factorise

__all__ = [
    "BlockFactor",
    "DirectSolver",
    "Dissection",
    "Factor",
    "Fronts",
    "LaggedSolver",
    "Solver",
    "cholmod",
    "dissect",
    "factorise",
    "superlu",
]
