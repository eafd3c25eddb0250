"""Steps in time: linearly implicit BDF of order p."""

from esfem_core.stepping import bdf
from esfem_core.stepping.agreement import check_exact_surface, check_on_exact_surface
from esfem_core.stepping.checkpoints import load, save
from esfem_core.stepping.files import FULL, OwnFile, write_whole
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.measure import Measures, measure
from esfem_core.stepping.remeshing import remeshed
from esfem_core.stepping.respacing import respaced, started_anew
from esfem_core.stepping.run import MASSES, evolve
from esfem_core.stepping.scheme import Perturbation
from esfem_core.stepping.solving import Statistics
from esfem_core.stepping.start import exact_state
from esfem_core.stepping.state import (
    EvolutionError,
    Mass,
    State,
    check_state,
    known_space,
    same_space,
)
from esfem_core.stepping.times import same_time

__all__ = [
    "FULL",
    "MASSES",
    "EvolutionError",
    "EvolutionWarning",
    "Mass",
    "Measures",
    "OwnFile",
    "Perturbation",
    "State",
    "Statistics",
    "bdf",
    "check_exact_surface",
    "check_on_exact_surface",
    "check_state",
    "evolve",
    "exact_state",
    "known_space",
    "load",
    "measure",
    "remeshed",
    "respaced",
    "same_space",
    "same_time",
    "save",
    "started_anew",
    "write_whole",
]
