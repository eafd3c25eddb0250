"""What a surface is: triangulations, level sets, exact surfaces.

A linear triangulation *is* a :class:`trimesh.Trimesh`; everything here takes or returns one.
"""

from esfem_core.surfaces import exact_surfaces
from esfem_core.surfaces.check import boundary_advice, check_triangulation
from esfem_core.surfaces.differences import central_stencil, derivative
from esfem_core.surfaces.edges import Edges, collapse, edges_of, flip, split
from esfem_core.surfaces.faults import FLATTEST, NO_LENGTH, Fault, check_coordinates, fault
from esfem_core.surfaces.files import curved_elements, read_mesh
from esfem_core.surfaces.foot_points import FootPoints
from esfem_core.surfaces.level_set import central_gradient, descend, project_to_level_set
from esfem_core.surfaces.meshing import MeshingError, from_level_set
from esfem_core.surfaces.orientation import (
    components,
    normals_of,
    sides_of,
    turned_to_agree,
    turned_to_outside,
    volumes,
)
from esfem_core.surfaces.places import without_unused
from esfem_core.surfaces.quality import Quality, angles_of, mesh_quality
from esfem_core.surfaces.relaxation import Evened, Guide, evened, resized
from esfem_core.surfaces.repair import repair
from esfem_core.surfaces.shapes import bisected_sphere, displaced, sphere, to_unit_sphere, torus
from esfem_core.surfaces.smooth import SmoothSurface, smooth
from esfem_core.surfaces.sources import Elements

__all__ = [
    "FLATTEST",
    "NO_LENGTH",
    "Edges",
    "Elements",
    "Evened",
    "Fault",
    "FootPoints",
    "Guide",
    "MeshingError",
    "Quality",
    "SmoothSurface",
    "angles_of",
    "bisected_sphere",
    "boundary_advice",
    "central_gradient",
    "central_stencil",
    "check_coordinates",
    "check_triangulation",
    "collapse",
    "components",
    "curved_elements",
    "derivative",
    "descend",
    "displaced",
    "edges_of",
    "evened",
    "exact_surfaces",
    "fault",
    "flip",
    "from_level_set",
    "mesh_quality",
    "normals_of",
    "project_to_level_set",
    "read_mesh",
    "repair",
    "resized",
    "sides_of",
    "smooth",
    "sphere",
    "split",
    "to_unit_sphere",
    "torus",
    "turned_to_agree",
    "turned_to_outside",
    "volumes",
    "without_unused",
]
