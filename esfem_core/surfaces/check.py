"""What a mesh must be: oriented outwards, of proper triangles, and for the theory closed."""

import numpy as np
import trimesh

from esfem_core.checks import Array, Ints, flag
from esfem_core.surfaces.faults import check_coordinates, check_is_trimesh, fault
from esfem_core.surfaces.orientation import sides_of
from esfem_core.surfaces.places import gap_of, joined, without_unused
from esfem_core.surfaces.repair import remedy

__all__ = ["boundary_advice", "check_triangulation"]


def check_triangulation(tri: trimesh.Trimesh, boundary: bool = False) -> None:
    """Refuse a mesh that is not a closed, outward oriented surface of proper triangles.

    Checked in this order: finite vertices up to 1e75, 1e-70 or more across, each in some triangle;
    triangles with three different corners and an area; every edge in two triangles; neighbours
    oriented alike; triangles around a vertex forming one fan, so that V - E + F = 2 (components -
    handles); each component enclosing a volume, at a place of its own, oriented outwards, or
    inwards where it is a cavity, that is, inside an odd number of others; no triangle lying on its
    neighbour. The triangles of the two sides of a thin shell may cross where the surface would not;
    the side that encloses less is then the cavity, so that they should be refined alike.

    Parameters
    ----------
    tri : trimesh.Trimesh
    boundary : bool
        Accept edges of one triangle as well. A component that has some encloses no volume, and
        may be oriented either way, neighbours alike. Two of them must not lie at one place, within
        1e-6 of the diagonal: that is a seam.

    Raises
    ------
    TypeError
        If `tri` is not a :class:`trimesh.Trimesh`.
    ValueError
        With the first vertex, triangle or edge that fails, why, and what helps:
        :func:`esfem_core.repair` has been tried where the message advises it.

    Examples
    --------
    >>> check_triangulation(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    Traceback (most recent call last):
        ...
    ValueError: the surface is not closed: edge (0, 1) of triangle 0 belongs to 1 triangle...
    >>> check_triangulation(
    ...     trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), boundary=True
    ... )
    """
    check_is_trimesh("tri", tri)
    vertices, faces = np.array(tri.vertices, dtype=float), np.array(tri.faces, dtype=np.int64)
    flag("boundary", boundary)
    check_coordinates("tri", vertices, faces)
    found = fault(vertices, faces, boundary)
    if found is None:
        return
    if boundary:
        raise ValueError(f"{found.text}; {remedy(vertices, faces, found, boundary=True)}")
    advice = remedy(vertices, faces, found) + boundary_advice(vertices, faces)
    if found.text.startswith("the surface is not closed"):
        advice += _seam_advice(vertices, faces)
    raise ValueError(f"{found.text}; {advice}")


def boundary_advice(vertices: Array, faces: Ints) -> str:
    """What else can be done about a mesh whose only fault is its boundary, as an end of a message.

    Examples
    --------
    >>> boundary_advice(np.eye(3), np.array([[0, 1, 2]]))
    '; where the motion is prescribed, a SurfaceSpace with boundary=True takes it as it is'
    """
    if fault(vertices, faces, boundary=True) is not None or gap_of(vertices, faces) > 0:
        return ""
    return "; where the motion is prescribed, a SurfaceSpace with boundary=True takes it as it is"


def _seam_advice(vertices: Array, faces: Ints) -> str:
    """The same of a mesh with a boundary beside edges that only need to be joined."""
    moved, _ = joined(vertices, faces)
    if moved is faces or not (sides_of(moved).times == 1).any():
        return ""
    left = fault(*without_unused(vertices, moved), boundary=True)
    how = "; where the motion is prescribed, a SurfaceSpace with boundary=True takes it after "
    return f"{how}tri = ec.read_mesh(tri)" if left is None else ""
