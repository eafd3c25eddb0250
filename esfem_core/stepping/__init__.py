"""Steps in time: linearly implicit BDF of order p."""

from esfem_core.stepping import bdf
from esfem_core.stepping.run import MASSES, evolve
from esfem_core.stepping.scheme import Perturbation
from esfem_core.stepping.start import exact_state
from esfem_core.stepping.state import EvolutionError, State, check_state

__all__ = [
    "MASSES",
    "EvolutionError",
    "Perturbation",
    "State",
    "bdf",
    "check_state",
    "evolve",
    "exact_state",
]
