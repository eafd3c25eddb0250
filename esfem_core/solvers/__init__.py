"""Linear systems: symmetric positive definite, sparse, changing a little from step to step.

Knows arrays only, no mesh class and no problem.
"""

from esfem_core.solvers.conjugate_gradients import ROUNDING
from esfem_core.solvers.dissection import Dissection, dissect
from esfem_core.solvers.factors import DirectSolver, Factor, Solver, cholmod, superlu
from esfem_core.solvers.fronts import Fronts
from esfem_core.solvers.lagged import RTOL, LaggedSolver
from esfem_core.solvers.multifrontal import BlockFactor, factorise
from esfem_core.solvers.products import times, times_rows
from esfem_core.solvers.systems import require_small_residual, right_hand_side
from esfem_core.solvers.threads import (
    BLAS_THREADS,
    MOST_THREADS,
    pieces,
    processors,
    side_by_side,
    thread_count,
    using_threads,
)

__all__ = [
    "BLAS_THREADS",
    "MOST_THREADS",
    "ROUNDING",
    "RTOL",
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
    "pieces",
    "processors",
    "require_small_residual",
    "right_hand_side",
    "side_by_side",
    "superlu",
    "thread_count",
    "times",
    "times_rows",
    "using_threads",
]
