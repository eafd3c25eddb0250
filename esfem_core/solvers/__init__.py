"""Linear systems: symmetric positive definite, sparse, changing a little from step to step.

Knows arrays only, no mesh class and no problem.
"""

from esfem_core.solvers.dissection import Dissection, dissect
from esfem_core.solvers.factors import DirectSolver, Factor, Solver, cholmod, superlu
from esfem_core.solvers.fronts import Fronts
from esfem_core.solvers.lagged import LaggedSolver
from esfem_core.solvers.multifrontal import BlockFactor, factorise
from esfem_core.solvers.systems import check_residual, right_hand_side

__all__ = [
    "BlockFactor",
    "DirectSolver",
    "Dissection",
    "Factor",
    "Fronts",
    "LaggedSolver",
    "Solver",
    "check_residual",
    "cholmod",
    "dissect",
    "factorise",
    "right_hand_side",
    "superlu",
]
