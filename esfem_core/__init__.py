"""Evolving surface finite elements in space, backward difference formulas in time."""

from esfem_core import bdf, errors, multipliers, problems, study
from esfem_core.assembly import DegenerateElementError
from esfem_core.flow import evolve
from esfem_core.level_set import project_to_level_set
from esfem_core.linear_solver import DirectSolver, LaggedSolver
from esfem_core.mesher import MeshingError, from_level_set
from esfem_core.problem import Exact, Problem
from esfem_core.quality import Quality, mesh_quality
from esfem_core.state import EvolutionError, State
from esfem_core.surface import SurfaceSpace
from esfem_core.triangulation import check_triangulation, sphere, to_unit_sphere

__all__ = [
    "DegenerateElementError",
    "DirectSolver",
    "EvolutionError",
    "Exact",
    "LaggedSolver",
    "MeshingError",
    "Problem",
    "Quality",
    "State",
    "SurfaceSpace",
    "bdf",
    "check_triangulation",
    "errors",
    "evolve",
    "from_level_set",
    "mesh_quality",
    "multipliers",
    "problems",
    "project_to_level_set",
    "sphere",
    "study",
    "to_unit_sphere",
]
