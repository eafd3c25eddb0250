"""Evolving surface finite elements in space, backward difference formulas in time."""

from esfem_core import errors, laws, problems, study
from esfem_core.elements import DegenerateElementError, ElementError, Surface, SurfaceSpace
from esfem_core.laws import Species
from esfem_core.problems import Exact, Problem
from esfem_core.solvers import DirectSolver, LaggedSolver
from esfem_core.stepping import (
    EvolutionError,
    EvolutionWarning,
    State,
    Statistics,
    bdf,
    evolve,
    measure,
)
from esfem_core.surfaces import (
    MeshingError,
    Quality,
    check_triangulation,
    exact_surfaces,
    from_level_set,
    mesh_quality,
    project_to_level_set,
    read_mesh,
    repair,
    sphere,
    to_unit_sphere,
    torus,
)
from esfem_core.theory import defects, forms, multipliers, peano

__all__ = [
    "DegenerateElementError",
    "DirectSolver",
    "ElementError",
    "EvolutionError",
    "EvolutionWarning",
    "Exact",
    "LaggedSolver",
    "MeshingError",
    "Problem",
    "Quality",
    "Species",
    "State",
    "Statistics",
    "Surface",
    "SurfaceSpace",
    "bdf",
    "check_triangulation",
    "defects",
    "errors",
    "evolve",
    "exact_surfaces",
    "forms",
    "from_level_set",
    "laws",
    "measure",
    "mesh_quality",
    "multipliers",
    "peano",
    "problems",
    "project_to_level_set",
    "read_mesh",
    "repair",
    "sphere",
    "study",
    "to_unit_sphere",
    "torus",
]
