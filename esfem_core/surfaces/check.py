"""What a mesh must be for the theory: closed, oriented outwards, of proper triangles."""

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from esfem_core.checks import Array, Ints, shown

__all__ = ["check_is_trimesh", "check_triangulation"]

SHAPE_TOLERANCE = 1e-10  # smallest allowed 4 sqrt(3) area / (sum of squared edge lengths)


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
        If `tri` is not a :class:`trimesh.Trimesh`.
    ValueError
        With the first vertex, triangle or edge that fails and why.

    Examples
    --------
    >>> check_triangulation(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    Traceback (most recent call last):
        ...
    ValueError: the surface is not closed: edge (0, 1) of triangle 0 belongs to 1 triangle...
    """
    check_is_trimesh("tri", tri)
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


def check_is_trimesh(name: str, value: object) -> None:
    """Refuse what is not a :class:`trimesh.Trimesh`.

    Examples
    --------
    >>> check_is_trimesh("tri", None)
    Traceback (most recent call last):
        ...
    TypeError: tri must be a trimesh.Trimesh, got None
    """
    if not isinstance(value, trimesh.Trimesh):
        raise TypeError(f"{name} must be a trimesh.Trimesh, got {shown(value)}")


def _cross(vertices: Array, faces: Ints) -> Array:
    a, b, c = vertices[faces.T]
    return np.cross(b - a, c - a)


def _check_vertices(vertices: Array, faces: Ints) -> None:
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


def _check_triangles(vertices: Array, faces: Ints) -> None:
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


def _check_edges(faces: Ints) -> None:
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


def _check_fans(n_vertices: int, faces: Ints) -> None:
    """Refuse a vertex whose triangles are not connected across edges.

    Take a graph whose nodes are the 3T corners of the triangles, and link two corners of
    neighbouring triangles at the same end of their common edge. Its components are the fans, of
    which each vertex must have one.
    """
    n = 3 * len(faces)
    corner = np.arange(n).reshape(-1, 3)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    corner_at_start, corner_at_end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()

    # Each edge runs once from i to j and once, in the neighbour, from j to i. So the k-th of the
    # sides sorted by (start, end) is the k-th of those sorted by (end, start) in reverse, and
    # where the one starts the other ends.
    by_start, by_end = np.lexsort((end, start)), np.lexsort((start, end))
    links = corner_at_start[by_start], corner_at_end[by_end]
    graph = coo_array((np.ones(n), links), shape=(n, n))
    n_fans, fan = connected_components(graph, directed=False)
    if n_fans == n_vertices:
        return
    first = np.unique(fan, return_index=True)[1]  # corner of each fan
    fans_at = np.bincount(faces.ravel()[first], minlength=n_vertices)
    i = int(np.argmax(fans_at > 1))
    euler = n_vertices - n // 2 + len(faces)
    raise ValueError(
        f"vertex {i} joins {fans_at[i]} separate fans of triangles: the surface touches itself "
        f"there (Euler number {euler}); give each fan its own vertex"
    )
