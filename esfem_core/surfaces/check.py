"""What a mesh must be for the theory: closed, oriented outwards, of proper triangles."""

import numpy as np
import trimesh

from esfem_core.surfaces.faults import check_is_trimesh, fault
from esfem_core.surfaces.repair import remedy

__all__ = ["check_triangulation"]


def check_triangulation(tri: trimesh.Trimesh) -> None:
    """Refuse a mesh that is not a closed, outward oriented surface of proper triangles.

    Checked in this order: finite vertices, each in some triangle; triangles with three different
    corners and an area; every edge in two triangles; neighbours oriented alike; triangles around
    a vertex forming one fan, so that V - E + F = 2 (components - handles); each component
    enclosing a volume, oriented outwards, or inwards where it is a cavity, that is, inside an odd
    number of others.

    Parameters
    ----------
    tri : trimesh.Trimesh

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
    """
    check_is_trimesh("tri", tri)
    vertices, faces = np.array(tri.vertices, dtype=float), np.array(tri.faces, dtype=np.int64)
    found = fault(vertices, faces)
    if found is not None:
        raise ValueError(f"{found.text}; {remedy(vertices, faces, found)}")
