"""Local changes of a closed triangulation: flip, split and collapse edges, many at a time.

Each function takes arrays of vertices and triangles and changes as many edges as it can without
two changes touching, so that a sweep is a few array operations.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

__all__ = ["Edges", "collapse", "edges_of", "flip", "split"]

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


class Edges(NamedTuple):
    """Edges of a closed oriented triangulation.

    Attributes
    ----------
    ends : (E, 2) int array
        i, j: one triangle is (i, j, p), the other (j, i, q), up to rotation.
    opposite : (E, 2) int array
        p, q.
    halves : (E, 2) int array
        3 t + n for side n, from corner n to the next, of each of these triangles t.
    """

    ends: Faces
    opposite: Faces
    halves: Faces

    def lengths(self, x: Array) -> Array:
        """Lengths of the edges between vertices at x, (E,)."""
        across = x[self.ends[:, 1]] - x[self.ends[:, 0]]
        length: Array = np.sqrt(_dot(across, across))
        return length


def edges_of(faces: Faces) -> Edges:
    """List the edges of a closed oriented triangulation.

    Examples
    --------
    >>> import esfem_core as ec
    >>> edges_of(ec.sphere("octahedron", 0).faces).ends.shape
    (12, 2)
    """
    start, end, third = (faces[:, [n, (n + 1) % 3, (n + 2) % 3]].ravel() for n in range(3))
    halves = np.argsort(_keys(start, end), kind="stable").reshape(-1, 2)
    first = halves[:, 0]
    return Edges(np.stack([start[first], end[first]], axis=1), third[halves], halves)


def flip(x: Array, faces: Faces) -> tuple[Faces, int]:
    """Replace edges by the other diagonal of their two triangles where Delaunay's criterion asks.

    An edge is flipped if the angles opposite to it add up to more than pi. Never flipped is an
    edge whose other diagonal exists already, one with an end in three triangles, and one whose
    new triangles would fold over.

    Parameters
    ----------
    x : (n, 3) float array
    faces : (T, 3) int array

    Returns
    -------
    (T, 3) int array, int
        The triangles, and how many edges were flipped.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("icosahedron", 1)
    >>> flip(tri.vertices, tri.faces)[1]
    0
    """
    e = edges_of(faces)
    excess = -_cotangents(x, faces)[e.halves].sum(axis=1)
    todo = np.flatnonzero(excess > 1e-6)
    patches = np.hstack([e.ends, e.opposite])[todo]
    i, j, p, q = patches.T
    valence = np.bincount(faces.ravel())
    allowed = (valence[i] > 3) & (valence[j] > 3) & ~_joined(e, p, q)
    old = _normals(x, i, j, p) + _normals(x, j, i, q)
    for a, b, c in ((p, i, q), (q, j, p)):
        allowed &= _dot(_normals(x, a, b, c), old) > 0
    todo, patches = todo[allowed], patches[allowed]
    chosen = _independent(excess[todo], patches, len(x))
    i, j, p, q = patches[chosen].T
    result = faces.copy()
    first, second = e.halves[todo[chosen]].T // 3
    result[first] = np.stack([p, i, q], axis=1)
    result[second] = np.stack([q, j, p], axis=1)
    return result, len(first)


def split(x: Array, faces: Faces, longest: float) -> tuple[Array, Faces, int]:
    """Put a vertex into the middle of edges that are longer than `longest`.

    Parameters
    ----------
    x : (n, 3) float array
    faces : (T, 3) int array
    longest : float

    Returns
    -------
    (m, 3) float array, (S, 3) int array, int
        Vertices, triangles and how many edges were split.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 0)
    >>> x, faces, n = split(tri.vertices, tri.faces, 1.0)
    >>> len(x), len(faces), n
    (7, 10, 1)
    """
    e = edges_of(faces)
    lengths = e.lengths(x)
    todo = np.flatnonzero(lengths > longest)
    patches = np.hstack([e.ends, e.opposite])
    todo = todo[_independent(lengths[todo], patches[todo], len(x))]
    i, j, p, q = patches[todo].T
    m = len(x) + np.arange(len(todo))
    result = faces.copy()
    first, second = e.halves[todo].T // 3
    result[first] = np.stack([i, m, p], axis=1)
    result[second] = np.stack([j, m, q], axis=1)
    added = [np.stack([m, j, p], axis=1), np.stack([m, i, q], axis=1)]
    return np.vstack([x, (x[i] + x[j]) / 2]), np.vstack([result, *added]), len(todo)


def collapse(x: Array, faces: Faces, priority: Array, longest: float) -> tuple[Array, Faces, int]:
    """Shrink edges to their midpoints.

    Left alone are edges whose ends have more than two neighbours in common (the topology would
    change), that would leave a vertex in three triangles, an edge longer than `longest` or a
    triangle turned by more than 60 degrees.

    Parameters
    ----------
    x : (n, 3) float array
    faces : (T, 3) int array
    priority : (E,) float array
        For the edges of :func:`edges_of`: those with a positive number are candidates, larger
        numbers first.
    longest : float

    Returns
    -------
    (m, 3) float array, (S, 3) int array, int
        Vertices, triangles and how many edges were collapsed.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("icosahedron", 1)
    >>> x, faces, n = collapse(tri.vertices, tri.faces, np.arange(120.0), 2.0)
    >>> n > 0, len(x) == 42 - n, len(faces) == 80 - 2 * n
    (True, True, True)
    """
    e = edges_of(faces)
    todo = np.flatnonzero(priority > 0)
    valence = np.bincount(faces.ravel())
    allowed = _common_neighbours(e, len(x), todo) == 2
    allowed &= (valence[e.opposite[todo]] > 4).all(axis=1)
    allowed &= valence[e.ends[todo]].sum(axis=1) > 7
    todo = todo[allowed]
    while True:
        chosen = todo[_far_apart(priority[todo], e, todo, len(x))]
        i, j = e.ends[chosen].T
        y, target = x.copy(), np.arange(len(x))
        y[i] = (x[i] + x[j]) / 2
        target[j] = i
        owner = np.full(len(x), -1)  # of a vertex that moves: its edge
        owner[i] = owner[j] = chosen
        renamed = target[faces]
        a, b, c = renamed.T
        kept = (a != b) & (b != c) & (c != a)
        old, new = _normals(x, *faces.T), _normals(y, a, b, c)
        bad = _dot(old, new) < 0.5 * np.sqrt(_dot(old, old) * _dot(new, new))
        for p, q in ((a, b), (b, c), (c, a)):
            bad |= _dot(y[p] - y[q], y[p] - y[q]) > longest**2
        touched = owner[faces].max(axis=1)  # by one edge only, the chosen are far apart
        refused = np.unique(touched[bad & kept & (touched >= 0)])
        if len(refused) == 0:
            break
        todo = np.setdiff1d(todo, refused)
    used = np.zeros(len(x), dtype=bool)
    used[renamed[kept]] = True
    number = np.cumsum(used) - 1
    return y[used], number[renamed[kept]], len(chosen)


def _normals(x: Array, a: Faces, b: Faces, c: Faces) -> Array:
    """Normals of triangles, twice their area long."""
    return np.cross(x[b] - x[a], x[c] - x[a])


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("ij,ij->i", a, b)
    return product


def _cotangents(x: Array, faces: Faces) -> Array:
    """Cotangents of the angles opposite to each side, in the order of ``Edges.halves``."""
    corners = x[faces]
    sides = corners[:, [1, 2, 0]] - corners
    squares = np.einsum("tij,tij->ti", sides, sides)
    normals = _normals(x, *faces.T)
    double_area = np.sqrt(_dot(normals, normals))
    with np.errstate(divide="ignore"):
        cotangents = (squares.sum(axis=1, keepdims=True) / 2 - squares) / double_area[:, None]
    result: Array = cotangents.ravel()
    return result


def _rank(priority: Array) -> Faces:
    """Positive ranks without ties, larger for higher priority; among equals the first wins."""
    rank = np.empty(len(priority), dtype=np.int64)
    rank[np.argsort(-priority, kind="stable")] = np.arange(len(priority), 0, -1)
    return rank


def _independent(priority: Array, patches: Faces, n: int) -> NDArray[np.bool_]:
    """Choose patches of vertices that share none: the first in each of their vertices."""
    rank = _rank(priority)
    best = np.zeros(n, dtype=np.int64)
    np.maximum.at(best, patches, rank[:, None])
    chosen: NDArray[np.bool_] = (best[patches] == rank[:, None]).all(axis=1)
    return chosen


def _far_apart(priority: Array, e: Edges, todo: Faces, n: int) -> NDArray[np.bool_]:
    """Choose edges such that no triangle has corners that are neighbours of two of them."""
    rank = _rank(priority)
    ends = e.ends[todo]
    best = np.zeros(n, dtype=np.int64)
    np.maximum.at(best, ends, rank[:, None])
    for _ in range(3):  # how far apart, in edges
        before = best.copy()
        np.maximum.at(best, e.ends, before[e.ends[:, ::-1]])
    chosen: NDArray[np.bool_] = (best[ends] == rank[:, None]).all(axis=1)
    return chosen


def _keys(a: Faces, b: Faces) -> Faces:
    """One number for each pair of vertices, in whichever order."""
    keys: Faces = np.minimum(a, b) * 2**31 + np.maximum(a, b)
    return keys


def _joined(e: Edges, a: Faces, b: Faces) -> NDArray[np.bool_]:
    """Tell of pairs of vertices whether they are an edge."""
    keys, wanted = _keys(*e.ends.T), _keys(a, b)  # those of the edges are sorted
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    found: NDArray[np.bool_] = keys[place] == wanted
    return found


def _common_neighbours(e: Edges, n: int, todo: Faces) -> Faces:
    rows, columns = np.vstack([e.ends, e.ends[:, ::-1]]).T
    adjacency = coo_array((np.ones(len(rows), dtype=np.int64), (rows, columns)), (n, n)).tocsr()
    i, j = e.ends[todo].T
    return np.asarray((adjacency[i] * adjacency[j]).sum(axis=1)).ravel()
