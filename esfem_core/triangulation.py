"""Closed triangulations: spheres, a torus, and what a mesh must be for the theory.

A linear triangulation *is* a :class:`trimesh.Trimesh`; everything here takes or returns one.
"""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["check_triangulation", "displaced", "sphere", "to_unit_sphere", "torus"]

SHAPE_TOLERANCE = 1e-10  # smallest allowed 4 sqrt(3) area / (sum of squared edge lengths)


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


def check_triangulation(tri: trimesh.Trimesh) -> None:
    """Refuse a mesh that is not a closed, outward oriented surface of proper triangles.

    Checked in this order: finite vertices, each in some triangle; triangles with three different
    corners and an area; every edge in two triangles; neighbours oriented alike; triangles around
    a vertex forming one fan, so that V - E + F = 2 (components - handles); enclosed volume
    positive.

    Parameters
    ----------
    tri : trimesh.Trimesh

    Raises
    ------
    TypeError
        If `tri` is no :class:`trimesh.Trimesh`.
    ValueError
        With the first vertex, triangle or edge that fails and why.

    Examples
    --------
    >>> check_triangulation(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    Traceback (most recent call last):
        ...
    ValueError: the surface is not closed: edge (0, 1) of triangle 0 belongs to 1 triangle...
    """
    if not isinstance(tri, trimesh.Trimesh):
        raise TypeError(f"expected a trimesh.Trimesh, got {type(tri).__name__}")
    vertices, faces = np.asarray(tri.vertices, dtype=float), np.asarray(tri.faces)
    if len(faces) == 0:
        raise ValueError("the triangulation has no triangles")
    _check_vertices(vertices, faces)
    _check_triangles(vertices, faces)
    _check_edges(faces)
    _check_fans(len(vertices), faces)
    volume = np.einsum("ti,ti->", vertices[faces[:, 0]], _cross(vertices, faces)) / 6
    if volume <= 0:
        raise ValueError(
            f"the triangles are oriented inwards (enclosed volume {volume:.3g}); call tri.invert()"
        )


def _cross(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = vertices[faces.T]
    return np.cross(b - a, c - a)


def _check_vertices(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"vertex {i} is not finite: {vertices[i].tolist()}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        t = int(np.argmax(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
        raise ValueError(
            f"triangle {t} has corners {faces[t].tolist()}, but there are {len(vertices)} vertices"
        )
    unused = np.bincount(faces.ravel(), minlength=len(vertices)) == 0
    if unused.any():
        raise ValueError(
            f"vertex {np.argmax(unused)} belongs to no triangle "
            f"({unused.sum()} such vertices); call tri.remove_unreferenced_vertices()"
        )


def _check_triangles(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    a, b, c = faces.T
    repeated = (a == b) | (b == c) | (c == a)
    if repeated.any():
        t = int(np.argmax(repeated))
        raise ValueError(f"triangle {t} is degenerate: its corners {faces[t].tolist()} repeat")
    p, q, r = vertices[faces.T]
    squares = ((q - p) ** 2 + (r - q) ** 2 + (p - r) ** 2).sum(axis=1)
    area = np.linalg.norm(_cross(vertices, faces), axis=1) / 2
    flat = ~(4 * np.sqrt(3) * area > SHAPE_TOLERANCE * squares)
    if flat.any():
        t = int(np.argmax(flat))
        raise ValueError(
            f"triangle {t} with corners {faces[t].tolist()} is degenerate: area {area[t]:.3g} "
            f"at a longest edge of about {np.sqrt(squares[t] / 2):.3g}"
        )


def _check_edges(faces: NDArray[np.int64]) -> None:
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, inverse, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    times = count[inverse.ravel()]
    if (times != 2).any():
        e = int(np.argmax(times != 2))
        i, j = directed[e].tolist()
        if times[e] == 1:
            raise ValueError(
                f"the surface is not closed: edge ({i}, {j}) of triangle {e // 3} belongs to "
                "1 triangle (the theory is for closed surfaces; if corners that should be one "
                "vertex are several, call tri.merge_vertices())"
            )
        raise ValueError(
            f"the surface is not a manifold: edge ({i}, {j}) of triangle {e // 3} belongs to "
            f"{times[e]} triangles"
        )
    _, first, count = np.unique(directed, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        e = int(first[np.argmax(count > 1)])
        i, j = directed[e].tolist()
        raise ValueError(
            f"neighbours are oriented against each other: triangle {e // 3} and its neighbour "
            f"both run through edge ({i}, {j}) in this direction; call tri.fix_normals()"
        )


def _check_fans(n_vertices: int, faces: NDArray[np.int64]) -> None:
    """Corners linked across edges must form one fan around each vertex."""
    n = 3 * len(faces)
    corner = np.arange(n).reshape(-1, 3)
    start, end = faces, np.roll(faces, -1, axis=1)
    # Edge (i, j) of one triangle is (j, i) in its neighbour: corner i here meets corner i there.
    here = np.lexsort((end.ravel(), start.ravel()))
    there = np.lexsort((start.ravel(), end.ravel()))
    at_start, at_end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    graph = coo_array((np.ones(n), (at_start[here], at_end[there])), shape=(n, n))
    n_fans, fan = connected_components(graph, directed=False)
    if n_fans == n_vertices:
        return
    first = np.unique(fan, return_index=True)[1]
    fans_at = np.bincount(faces.ravel()[first], minlength=n_vertices)
    i = int(np.argmax(fans_at > 1))
    euler = n_vertices - n // 2 + len(faces)
    raise ValueError(
        f"vertex {i} joins {fans_at[i]} separate fans of triangles: the surface touches itself "
        f"there (Euler number {euler}); give each fan its own vertex"
    )
