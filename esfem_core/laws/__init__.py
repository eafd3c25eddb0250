"""How a surface moves, and what moves with it: one law, one file."""

from esfem_core.laws.dynamic import Dynamic
from esfem_core.laws.fixed import Fixed
from esfem_core.laws.law import Law, Solve, check_law, check_no_slip, positions_of, same_species
from esfem_core.laws.mean_curvature import MeanCurvature, check_normal_and_curvature
from esfem_core.laws.prescribed import Prescribed
from esfem_core.laws.regularised import Regularised
from esfem_core.laws.slip import Elastic, with_slip
from esfem_core.laws.species import Part, Species, check_initial
from esfem_core.laws.values import check_of_points, check_of_surface, finite_nodal, values_at
from esfem_core.laws.volume_preserving import VolumePreserving

__all__ = [
    "Dynamic",
    "Elastic",
    "Fixed",
    "Law",
    "MeanCurvature",
    "Part",
    "Prescribed",
    "Regularised",
    "Solve",
    "Species",
    "VolumePreserving",
    "check_initial",
    "check_law",
    "check_no_slip",
    "check_normal_and_curvature",
    "check_of_points",
    "check_of_surface",
    "finite_nodal",
    "positions_of",
    "same_species",
    "values_at",
    "with_slip",
]
