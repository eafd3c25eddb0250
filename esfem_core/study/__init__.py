"""Convergence studies, and studies of many cases in many processes."""

from esfem_core.study import dependencies, environment, user_code
from esfem_core.study.cases import Results, grid, run
from esfem_core.study.convergence import (
    ConvergenceTable,
    final,
    observed_orders,
    space_study,
    time_study,
)
from esfem_core.study.locks import StudyWarning
from esfem_core.study.processes import Processes, WorkerLostError
from esfem_core.study.rows import Row, UnsavedRowsError, read, select
from esfem_core.study.scheduling import (
    Experiment,
    Failure,
    Outcome,
    case,
    is_current,
    outcomes,
)

__all__ = [
    "ConvergenceTable",
    "Experiment",
    "Failure",
    "Outcome",
    "Processes",
    "Results",
    "Row",
    "StudyWarning",
    "UnsavedRowsError",
    "WorkerLostError",
    "case",
    "dependencies",
    "environment",
    "final",
    "grid",
    "is_current",
    "observed_orders",
    "outcomes",
    "read",
    "run",
    "select",
    "space_study",
    "time_study",
    "user_code",
]
