"""Triangulated spheres and a torus, and a mesh with its vertices displaced."""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

__all__ = ["bisected_sphere", "displaced", "sphere", "to_unit_sphere", "torus"]


def to_unit_sphere(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Closest points on the unit sphere, ``p(x) = x/|x|`` ([N] (2.2)).

    Parameters
    ----------
    points : (n, 3) float array
        Any points but the origin.

    Returns
    -------
    (n, 3) float array

    Examples
    --------
    >>> to_unit_sphere(np.array([[0.0, 3.0, 4.0]]))
    array([[0. , 0.6, 0.8]])
    """
    unit: NDArray[np.float64] = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return unit


def sphere(kind: str = "octahedron", refinements: int = 3) -> trimesh.Trimesh:
    """Triangulate the unit sphere by refining a regular solid.

    Each refinement splits every triangle in four and moves the new vertices to the sphere.

    Parameters
    ----------
    kind : {"octahedron", "icosahedron"}
        The octahedron keeps edges on the three coordinate planes; the icosahedron has the more
        even triangles.
    refinements : int
        Number of refinements, 0 or more: ``4**(r+1) + 2`` vertices from the octahedron,
        ``10 * 4**r + 2`` from the icosahedron. The meshes of [LMV], with 4,098 and 65,538
        vertices, are octahedra refined 5 and 7 times.

    Returns
    -------
    trimesh.Trimesh
        Closed, oriented outwards.

    Raises
    ------
    ValueError
        If `kind` is unknown or `refinements` is not a non-negative integer.

    Examples
    --------
    >>> len(sphere("octahedron", 5).vertices), len(sphere("icosahedron", 2).vertices)
    (4098, 162)
    """
    if refinements != int(refinements) or refinements < 0:
        raise ValueError(f"refinements must be an integer >= 0, got {refinements!r}")
    if kind == "octahedron":
        vertices = np.vstack([np.eye(3), -np.eye(3)])
        faces = np.array(
            [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
        )
    elif kind == "icosahedron":
        solid = trimesh.creation.icosahedron()
        vertices, faces = to_unit_sphere(np.asarray(solid.vertices)), np.asarray(solid.faces)
    else:
        raise ValueError(f'kind must be "octahedron" or "icosahedron", got {kind!r}')
    for _ in range(int(refinements)):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        vertices = to_unit_sphere(vertices)
    return trimesh.Trimesh(vertices, faces, process=False)


def torus(R: float = 1.0, r: float = 0.4, n: int = 20, m: int = 8) -> trimesh.Trimesh:
    """Triangulate the torus around the third axis by a grid of angles.

    Parameters
    ----------
    R, r : float
        Radius of the core circle and of the tube, R > r > 0.
    n, m : int
        Numbers of cells around the axis and around the tube, 3 or more; each cell is two
        triangles. Even ones have n/m near R/r. A tube of few cells around the axis is far from
        the torus: with n = 3 or 4 not every point has its own closest one.

    Returns
    -------
    trimesh.Trimesh
        Closed, oriented outwards, with n m vertices on the torus.

    Raises
    ------
    ValueError
        If a radius or a number is out of range.

    Examples
    --------
    >>> mesh = torus(1.0, 0.4, n=20, m=8)
    >>> len(mesh.vertices), len(mesh.faces), mesh.euler_number
    (160, 320, 0)
    """
    if not (np.isfinite(R) and R > r > 0):
        raise ValueError(f"a torus needs R > r > 0, got R = {R!r} and r = {r!r}")
    if n != int(n) or m != int(m) or min(n, m) < 3:
        raise ValueError(f"n and m must be integers >= 3, got n = {n!r} and m = {m!r}")
    return trimesh.creation.torus(R, r, major_sections=int(n), minor_sections=int(m))


def displaced(
    tri: trimesh.Trimesh,
    share: float,
    project: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    seed: int = 0,
) -> trimesh.Trimesh:
    """Move the vertices of a triangulation at random, then back to the surface.

    Regular meshes flatter: errors of neighbouring elements cancel. A displaced mesh shows the
    orders that are proven.

    Parameters
    ----------
    tri : trimesh.Trimesh
    share : float
        Largest displacement of a coordinate before projection, as a share of the shortest edge;
        0 to 0.3.
    project : callable
        (n, 3) -> (n, 3), puts points on the surface.
    seed : int

    Returns
    -------
    trimesh.Trimesh

    Raises
    ------
    ValueError
        If the share is out of range.

    Examples
    --------
    >>> tri = sphere("icosahedron", 2)
    >>> moved = displaced(tri, 0.2, to_unit_sphere)
    >>> distance = np.linalg.norm(moved.vertices - tri.vertices, axis=1).max()
    >>> bool(0.1 < distance / tri.edges_unique_length.min() < 0.4)
    True
    """
    if not 0 <= share <= 0.3:
        raise ValueError(f"share must be from 0 to 0.3, got {share!r}")
    shift = np.random.default_rng(seed).uniform(-1, 1, np.shape(tri.vertices))
    moved = project(tri.vertices + share * tri.edges_unique_length.min() * shift)
    return trimesh.Trimesh(moved, tri.faces, process=False)


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
