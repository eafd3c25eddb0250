"""Functions on a surface: Lagrange elements of degree k, and their integrals."""

from esfem_core.elements.integrals import DegenerateElementError
from esfem_core.elements.lagrange import Basis, node_indices, tabulate
from esfem_core.elements.lifting import squared_differences
from esfem_core.elements.numbering import flat_triangles
from esfem_core.elements.quadrature import TriangleRule, triangle_rule
from esfem_core.elements.scatter import with_data
from esfem_core.elements.space import Assembly, SurfaceSpace

__all__ = [
    "Assembly",
    "Basis",
    "DegenerateElementError",
    "SurfaceSpace",
    "TriangleRule",
    "flat_triangles",
    "node_indices",
    "squared_differences",
    "tabulate",
    "triangle_rule",
    "with_data",
]
