"""Triangulated spheres and a torus, and a mesh with its vertices displaced."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import trimesh

from esfem_core.checks import (
    Array,
    finite_array,
    function,
    number,
    one_of,
    real_array,
    whole_number,
)
from esfem_core.surfaces.faults import FARTHEST, check_is_trimesh

__all__ = ["Solid", "bisected_sphere", "displaced", "sphere", "to_unit_sphere", "torus"]

Solid = Literal["octahedron", "icosahedron"]


MOST_CELLS = 10_000  # of a torus in one direction
MOST_REFINEMENTS = 12  # 6.7e7 vertices from the octahedron: beyond, memory ends first


def to_unit_sphere(points: Array) -> Array:
    """Closest points on the unit sphere, ``p(x) = x/|x|`` ([N] (2.2)).

    Parameters
    ----------
    points : (..., 3) float array
        Any points but the origin.

    Returns
    -------
    (..., 3) float array

    Raises
    ------
    TypeError, ValueError
        If they are not real numbers of that shape, or if a point is the origin or not finite.

    Examples
    --------
    >>> to_unit_sphere(np.array([[0.0, 3.0, 4.0]]))
    array([[0. , 0.6, 0.8]])
    """
    x = real_array("points", points, ("...", 3))
    length = np.linalg.norm(x, axis=-1, keepdims=True)

    # Two reductions, so that good points cost next to nothing; a NaN fails both comparisons.
    if not (length.min(initial=1.0) > 0 and length.max(initial=1.0) < np.inf):
        bad = ~((length > 0) & (length < np.inf))[..., 0]
        raise ValueError(
            "points must have a positive and finite distance from the origin, but one is "
            f"{x[bad][0].tolist()}"
        )
    return np.asarray(x / length)


def sphere(kind: Solid = "octahedron", refinements: int = 3) -> trimesh.Trimesh:
    """Triangulate the unit sphere by refining a regular solid.

    Each refinement splits every triangle in four and moves the new vertices to the sphere.

    Parameters
    ----------
    kind : {"octahedron", "icosahedron"}
        The octahedron keeps edges on the three coordinate planes; the icosahedron has the more
        even triangles.
    refinements : int
        Number of refinements, 0 to 12: ``4**(r+1) + 2`` vertices from the octahedron,
        ``10 * 4**r + 2`` from the icosahedron. 5 and 7 refinements of the octahedron give the
        4,098 and 65,538 vertices of the meshes of [LMV], which does not say how it refines; see
        :func:`bisected_sphere`.

    Returns
    -------
    trimesh.Trimesh
        Closed, oriented outwards.

    Raises
    ------
    TypeError, ValueError
        If `kind` is unknown or `refinements` is not an integer from 0 to 12.

    Examples
    --------
    >>> len(sphere("octahedron", 5).vertices), len(sphere("icosahedron", 2).vertices)
    (4098, 162)
    """
    refinements = whole_number("refinements", refinements, 0, MOST_REFINEMENTS)
    if one_of("kind", kind, Solid) == "octahedron":
        vertices = np.vstack([np.eye(3), -np.eye(3)])
        faces = np.array(
            [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
        )
    else:
        solid = trimesh.creation.icosahedron()
        vertices, faces = to_unit_sphere(np.asarray(solid.vertices)), np.asarray(solid.faces)
    for _ in range(refinements):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        vertices = to_unit_sphere(vertices)
    return trimesh.Trimesh(vertices, faces, process=False)


def torus(R: float = 1.0, r: float = 0.4, n: int = 20, m: int = 8) -> trimesh.Trimesh:
    """Triangulate the torus around the third axis by a grid of angles.

    Parameters
    ----------
    R, r : float
        Radius of the core circle and of the tube, R > r > 0, together up to 1e75.
    n, m : int
        Numbers of cells around the axis and around the tube, 3 to 10,000; each cell is two
        triangles. They are most even for n/m near R/r. A tube of few cells around the axis is far
        from the torus: with n = 3 or 4 not every point has its own closest one.

    Returns
    -------
    trimesh.Trimesh
        Closed, oriented outwards, with n m vertices on the torus.

    Raises
    ------
    TypeError, ValueError
        If a radius is not positive, R <= r, or a number is not an integer from 3 to 10,000.

    Examples
    --------
    >>> mesh = torus(1.0, 0.4, n=20, m=8)
    >>> len(mesh.vertices), len(mesh.faces), mesh.euler_number
    (160, 320, 0)
    """
    R, r = number("R", R, above=0), number("r", r, above=0)
    if r >= R:
        raise ValueError(f"R must be larger than r, got R = {R:g} and r = {r:g}")
    if R + r > FARTHEST:
        raise ValueError(f"R + r must be up to {FARTHEST:g}, got R = {R:g} and r = {r:g}")
    n, m = whole_number("n", n, 3, MOST_CELLS), whole_number("m", m, 3, MOST_CELLS)
    # trimesh.creation.torus has changed its diagonals, and with them all numbers, at version 5.
    around, along = np.linspace(0, 2 * np.pi, n + 1)[:-1, None], np.linspace(0, 2 * np.pi, m + 1)
    distance, height = r / R * np.cos(along[:-1]) + 1.0, r / R * np.sin(along[:-1])
    x = np.cos(around) * distance, np.sin(around) * distance, np.broadcast_to(height, (n, m))
    a = np.arange(n * m).reshape(n, m)
    b, c, d = np.roll(a, -1, 0), np.roll(a, -1, 1), np.roll(a, (-1, -1), (0, 1))
    faces = np.stack([a, b, c, c, b, d], axis=-1).reshape(-1, 3)
    return trimesh.Trimesh(R * np.stack(x, axis=-1).reshape(-1, 3), faces, process=False)


def displaced(
    tri: trimesh.Trimesh,
    share: float,
    project: Callable[[Array], Array],
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
        0 or more; the same seed gives the same mesh.

    Returns
    -------
    trimesh.Trimesh

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated, or `project` does not return finite points of the shape
        it is given.

    Examples
    --------
    >>> tri = sphere("icosahedron", 2)
    >>> moved = displaced(tri, 0.2, to_unit_sphere)
    >>> distance = np.linalg.norm(moved.vertices - tri.vertices, axis=1).max()
    >>> bool(0.1 < distance / tri.edges_unique_length.min() < 0.4)
    True
    """
    check_is_trimesh("tri", tri)
    share, seed = number("share", share, least=0, most=0.3), whole_number("seed", seed, 0)
    function("project", project, "of points (n, 3)")
    if len(tri.faces) == 0:
        raise ValueError("tri must have triangles, got none")
    x = np.asarray(tri.vertices)
    shift = np.random.default_rng(seed).uniform(-1, 1, x.shape)
    moved = project(x + share * tri.edges_unique_length.min() * shift)
    moved = finite_array("project(x)", moved, x.shape)
    return trimesh.Trimesh(moved, tri.faces.copy(), process=False)


def bisected_sphere(bisections: int) -> trimesh.Trimesh:
    """Triangulate the unit sphere by bisecting the triangles of an octahedron again and again.

    Newest vertex bisection: each triangle is cut from its newest vertex to the middle of the edge
    opposite, at first the edges in the plane x3 = 0; the new vertices are moved to the sphere.
    After an even number of bisections there are as many vertices as in
    ``sphere("octahedron", bisections // 2)``, where each triangle is cut into four of its own
    shape. Here neighbouring triangles do not form parallelograms, and linear elements are not
    superclose to the interpolant.

    Parameters
    ----------
    bisections : int
        n, 0 to 24; there are 4 2^n + 2 vertices.

    Returns
    -------
    trimesh.Trimesh
        Closed and oriented outwards.

    Raises
    ------
    TypeError, ValueError
        If `bisections` is not an integer from 0 to 24.

    Examples
    --------
    >>> len(bisected_sphere(4).vertices), len(bisected_sphere(14).vertices)
    (66, 65538)
    """
    bisections = whole_number("bisections", bisections, 0, 2 * MOST_REFINEMENTS)
    vertices = np.array(
        [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float
    )
    equator = [(0, 1), (1, 2), (2, 3), (3, 0)]
    # The first two vertices of a triangle are the ends of the edge to be cut.
    faces = np.array([f for i, j in equator for f in ((i, j, 4), (j, i, 5))])
    for _ in range(bisections):
        edges, number = np.unique(np.sort(faces[:, :2], axis=1), axis=0, return_inverse=True)
        middle = len(vertices) + number.ravel()
        vertices = np.vstack([vertices, to_unit_sphere(vertices[edges].mean(axis=1))])
        i, j, k = faces.T  # k, the newest vertex, is next to the middle of (i, j) in both halves
        faces = np.vstack([np.column_stack([k, i, middle]), np.column_stack([j, k, middle])])
    return trimesh.Trimesh(vertices, faces, process=False)
