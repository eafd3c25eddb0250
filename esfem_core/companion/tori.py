"""Tori with about equal edges in both directions, regular or displaced at random."""

import numpy as np
import trimesh

from esfem_core.checks import number, whole_number
from esfem_core.surfaces import exact_surfaces
from esfem_core.surfaces import torus as grid_torus

__all__ = ["torus"]


def torus(n: int, R: float = 1.0, r: float = 0.4, displaced: float = 0.0) -> trimesh.Trimesh:
    """The :func:`esfem_core.torus` of 5n by 2n cells, its vertices displaced, always the same way.

    On a regular mesh errors of neighbouring elements cancel, and orders are seen that no theorem
    promises.

    Parameters
    ----------
    n : int
        2 or more.
    R, r : float
        Radius of the core circle and of the tube, R > r > 0.
    displaced : float
        Largest displacement of a coordinate, 0 to 0.3, in edges around the tube; the vertices are
        put back on the torus.

    Returns
    -------
    trimesh.Trimesh
        With 10 n² vertices.

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated.

    Examples
    --------
    >>> regular, irregular = torus(4), torus(4, displaced=0.2)
    >>> len(regular.vertices), bool((regular.faces == irregular.faces).all())
    (160, True)
    """
    n, displaced = whole_number("n", n, 2), number("displaced", displaced, least=0, most=0.3)
    tri = grid_torus(R, r, 5 * n, 2 * n)
    if displaced == 0:
        return tri
    shift = np.random.default_rng(n).uniform(-1, 1, tri.vertices.shape)
    vertices = np.asarray(tri.vertices) + displaced * np.pi * r / n * shift
    closest = exact_surfaces.Torus(R, r).closest(vertices)
    return trimesh.Trimesh(closest, tri.faces, process=False)
