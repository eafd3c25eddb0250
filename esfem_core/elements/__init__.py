"""Functions on a surface: Lagrange elements of degree k, and their integrals."""

from esfem_core.elements.integrals import DegenerateElementError, ElementError, NotFiniteError
from esfem_core.elements.lagrange import Basis, node_indices, tabulate
from esfem_core.elements.lifting import squared_differences
from esfem_core.elements.numbering import flat_triangles
from esfem_core.elements.probing import ClosestPoints, closest_points, probe
from esfem_core.elements.quadrature import TriangleRule, triangle_rule
from esfem_core.elements.recovery import (
    Smoothing,
    nodal_average,
    normal_and_curvature,
    smoothed,
    smoothed_divergence,
)
from esfem_core.elements.scatter import combination, with_data
from esfem_core.elements.space import SurfaceSpace
from esfem_core.elements.surface import Surface, check_tensors
from esfem_core.elements.tangents import TangentPlanes

__all__ = [
    "Basis",
    "ClosestPoints",
    "DegenerateElementError",
    "ElementError",
    "NotFiniteError",
    "Smoothing",
    "Surface",
    "SurfaceSpace",
    "TangentPlanes",
    "TriangleRule",
    "check_tensors",
    "closest_points",
    "combination",
    "flat_triangles",
    "nodal_average",
    "node_indices",
    "normal_and_curvature",
    "probe",
    "smoothed",
    "smoothed_divergence",
    "squared_differences",
    "tabulate",
    "triangle_rule",
    "with_data",
]
