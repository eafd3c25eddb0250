"""Spheres triangulated by bisection: other meshes with the numbers of nodes of [LMV]."""

import numpy as np
import trimesh

from esfem_core.triangulation import to_unit_sphere

__all__ = ["bisected_sphere"]


def bisected_sphere(bisections: int) -> trimesh.Trimesh:
    """Octahedron whose triangles are bisected again and again, nodes moved to the unit sphere.

    Each triangle is cut from the middle of one edge to the vertex opposite, which is the newest
    one, starting with the edges in the plane x3 = 0. After an even number of bisections there are
    as many nodes as in ``sphere("octahedron", bisections // 2)``, where each triangle is cut into
    four of its own shape. Here neighbouring triangles do not form parallelograms, and errors of
    linear elements against the interpolant are not superclose.

    Parameters
    ----------
    bisections : int
        n >= 0; there are 4 2^n + 2 vertices.

    Returns
    -------
    trimesh.Trimesh
        Closed and oriented outwards.

    Raises
    ------
    ValueError
        If `bisections` is not an integer >= 0.

    Examples
    --------
    >>> len(bisected_sphere(4).vertices), len(bisected_sphere(14).vertices)
    (66, 65538)
    """
    if bisections != int(bisections) or bisections < 0:
        raise ValueError(f"bisections must be an integer >= 0, got {bisections!r}")
    vertices = np.array(
        [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float
    )
    equator = [(0, 1), (1, 2), (2, 3), (3, 0)]
    # The first two vertices of a triangle are the ends of the edge to be cut.
    faces = np.array([f for i, j in equator for f in ((i, j, 4), (j, i, 5))])
    for _ in range(int(bisections)):
        edges, number = np.unique(np.sort(faces[:, :2], axis=1), axis=0, return_inverse=True)
        middle = len(vertices) + number.ravel()
        vertices = np.vstack([vertices, to_unit_sphere(vertices[edges].mean(axis=1))])
        i, j, k = faces.T
        faces = np.vstack([np.column_stack([k, i, middle]), np.column_stack([j, k, middle])])
    return trimesh.Trimesh(vertices, faces, process=False)
