r"""Local changes of a closed triangulation: flip, split and collapse edges, many at a time.

The pictures show an edge (i, j) with its two triangles (i, j, p) and (j, i, q)::

          p                  p                  p                  p
         / \                /|\                /|\                 |
        /   \              / | \              / | \                |
       i-----j    flip:   i  |  j    split:  i--m--j   collapse:   i
        \   /              \ | /              \ | /                |
         \ /                \|/                \|/                 |
          q                  q                  q                  q

A split adds a vertex m and two triangles, a collapse removes j and both triangles. Each function
takes arrays of vertices and triangles and changes as many edges as it can without two changes
touching, so that a sweep is a few array operations; the next sweep changes others.

All start from the list of edges. Take a tetrahedron:

>>> faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])

Triangle t has the sides 3t, 3t + 1 and 3t + 2, from each corner to the next. Side 0 runs from 0
to 1 with corner 2 opposite, side 5, the last of triangle 1, from 1 to 0 with corner 3 opposite.
The two are halves of one edge:

>>> e = edges_of(faces)
>>> e.halves[0], e.ends[0], e.opposite[0]
(array([0, 5]), array([0, 1]), array([2, 3]))

So an edge finds its triangles, here 0 // 3 and 5 // 3, by the numbers of its halves.
"""

from typing import NamedTuple

import numpy as np

from esfem_core.checks import Array, Bools, Ints, finite_array, integer_array, number, real_array
from esfem_core.surfaces.orientation import normals_of

__all__ = ["Edges", "collapse", "edges_of", "flip", "split"]

EXCESS = 1e-6  # of cotangents: edges are flipped where the angles' sum is clearly above pi
MAX_TURN = 0.5  # smallest cosine between normals of a triangle before and after a collapse


class Edges(NamedTuple):
    """Edges of a closed oriented triangulation, each once.

    Attributes
    ----------
    ends : (E, 2) int array
        i, j: one triangle is (i, j, p), the other (j, i, q), up to rotation.
    opposite : (E, 2) int array
        p, q.
    halves : (E, 2) int array
        The sides of these two triangles that are the edge: 3t + n is side n of triangle t, from
        corner n to the next.
    """

    ends: Ints
    opposite: Ints
    halves: Ints

    def lengths(self, x: Array) -> Array:
        """Lengths of the edges between vertices at x, (E,)."""
        a, b = np.take(x, self.ends.T, axis=0)
        across = b - a
        return np.asarray(np.sqrt(_dot(across, across)))


def edges_of(faces: Ints) -> Edges:
    """List the edges of a closed oriented triangulation.

    Parameters
    ----------
    faces : (T, 3) int array

    Returns
    -------
    Edges
        Sorted by the smaller of their ends, then by the larger.

    Raises
    ------
    TypeError, ValueError
        If `faces` are not integers of that shape, or an edge has not two triangles that run
        through it in opposite directions.

    Examples
    --------
    >>> import esfem_core as ec
    >>> edges_of(ec.sphere("octahedron", 0).faces).ends.shape
    (12, 2)
    """
    faces = integer_array("faces", faces, ("T", 3))
    a, b, c = faces.T
    start, end, third = (np.stack(n, axis=1).ravel() for n in ((a, b, c), (b, c, a), (c, a, b)))

    # Each edge has a side that goes up, to the larger number, and one that goes down. Both kinds
    # are sorted by keys; the halves of an edge are then at the same place.
    keys = _keys(start, end)
    up, down = np.flatnonzero(start <= end), np.flatnonzero(start > end)
    up, down = up[np.argsort(keys[up])], down[np.argsort(keys[down])]
    once = keys[up]
    if not np.array_equal(once, keys[down]) or (once[1:] == once[:-1]).any():
        raise ValueError(
            "faces must be a closed triangulation, neighbours oriented alike; "
            "esfem_core.check_triangulation says where they are not"
        )
    first = np.minimum(up, down)
    halves = np.stack([first, np.maximum(up, down)], axis=1)
    return Edges(np.stack([start[first], end[first]], axis=1), third[halves], halves)


def flip(x: Array, faces: Ints) -> tuple[Ints, int]:
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

    Raises
    ------
    TypeError, ValueError
        If an array is not as stated, or the triangulation not closed and oriented.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("icosahedron", 1)
    >>> flip(tri.vertices, tri.faces)[1]
    0
    """
    x, faces = _mesh(x, faces)
    e = edges_of(faces)

    # cot a + cot b = sin(a + b)/(sin a sin b) is negative where a + b > pi.
    one, other = _cotangents(x, faces)[e.halves.T]
    excess = -(one + other)
    todo = np.flatnonzero(excess > EXCESS)
    if len(todo) == 0:
        return faces, 0
    patches = np.hstack([e.ends, e.opposite])[todo]
    allowed = _may_be_flipped(x, faces, e, patches)
    todo, patches = todo[allowed], patches[allowed]
    chosen = _independent(excess[todo], patches, len(x))

    i, j, p, q = patches[chosen].T
    result = faces.copy()
    first, second = e.halves[todo[chosen]].T // 3
    result[first] = np.stack([p, i, q], axis=1)
    result[second] = np.stack([q, j, p], axis=1)
    return result, len(first)


def _may_be_flipped(x: Array, faces: Ints, e: Edges, patches: Ints) -> Bools:
    """Whether the flips of patches (i, j, p, q) keep a proper triangulation without folds."""
    i, j, p, q = patches.T
    valence = np.bincount(faces.ravel())
    allowed: Bools = (valence[i] > 3) & (valence[j] > 3) & ~_joined(e, p, q)
    old = normals_of(x, patches[:, [0, 1, 2]]) + normals_of(x, patches[:, [1, 0, 3]])
    for new in ([2, 0, 3], [3, 1, 2]):
        allowed &= _dot(normals_of(x, patches[:, new]), old) > 0
    return allowed


def split(x: Array, faces: Ints, longest: float | Array) -> tuple[Array, Ints, int]:
    """Put a vertex into the middle of edges that are longer than `longest`.

    Parameters
    ----------
    x : (n, 3) float array
    faces : (T, 3) int array
    longest : float or (n,) float array
        Positive; of an edge, the mean of that at its ends.

    Returns
    -------
    (m, 3) float array, (S, 3) int array, int
        Vertices, triangles and how many edges were split.

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated, or the triangulation not closed and oriented.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 0)
    >>> x, faces, n = split(tri.vertices, tri.faces, 1.0)
    >>> len(x), len(faces), n
    (7, 10, 1)
    """
    x, faces = _mesh(x, faces)
    longest = _at_vertices("longest", longest, len(x))
    e = edges_of(faces)
    lengths = e.lengths(x)
    todo = np.flatnonzero(lengths > longest[e.ends].mean(axis=1))
    if len(todo) == 0:
        return x, faces, 0
    patches = np.hstack([e.ends, e.opposite])
    todo = todo[_independent(lengths[todo], patches[todo], len(x))]

    # Half of each old triangle takes its place in the array, the other halves are appended.
    i, j, p, q = patches[todo].T
    m = len(x) + np.arange(len(todo))
    result = faces.copy()
    first, second = e.halves[todo].T // 3
    result[first] = np.stack([i, m, p], axis=1)
    result[second] = np.stack([j, m, q], axis=1)
    added = [np.stack([m, j, p], axis=1), np.stack([m, i, q], axis=1)]
    return np.vstack([x, (x[i] + x[j]) / 2]), np.vstack([result, *added]), len(todo)


def collapse(
    x: Array, faces: Ints, priority: Array, longest: float | Array
) -> tuple[Array, Ints, int]:
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
    longest : float or (n,) float array
        Positive; of an edge, the mean of that at its ends.

    Returns
    -------
    (m, 3) float array, (S, 3) int array, int
        Vertices, triangles and how many edges were collapsed.

    Raises
    ------
    TypeError, ValueError
        If an argument is not as stated, or the triangulation not closed and oriented.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("icosahedron", 1)
    >>> x, faces, n = collapse(tri.vertices, tri.faces, np.arange(120.0), 2.0)
    >>> n > 0, len(x) == 42 - n, len(faces) == 80 - 2 * n
    (True, True, True)
    """
    x, faces = _mesh(x, faces)
    longest = _at_vertices("longest", longest, len(x))
    e = edges_of(faces)
    priority = real_array("priority", priority, (len(e.ends),))
    todo = np.flatnonzero(priority > 0)
    near = _neighbours(e, len(x))
    todo = todo[_may_be_collapsed(faces, e, todo, near)]
    ends = e.ends[todo[np.argsort(-priority[todo], kind="stable")[::-1]]]  # the best comes last

    # What a collapse does to its neighbourhood is seen when it is tried. Edges that spoil it are
    # no candidates any more, others may come in their place, until all that are chosen are good.
    y, target = x.copy(), np.arange(len(x))  # where a vertex goes, and which it becomes
    owner = np.full(len(x), -1)  # of a vertex that is moved on trial: its edge
    corners = np.ascontiguousarray(faces.T)
    good = np.zeros(len(ends), dtype=bool)
    while len(tried := np.flatnonzero(_far_apart(ends, near) & ~good)):
        i, j = ends[tried].T
        y[i], target[j] = (x[i] + x[j]) / 2, i
        owner[i] = owner[j] = tried
        edge = owner[corners].max(axis=0)  # one owner, as the chosen are far apart
        touched = np.flatnonzero(edge >= 0)
        touched = touched[_proper(target[faces[touched]])]
        spoiled = _spoiled(x, faces[touched], y, target[faces[touched]], longest)
        good[tried] = True
        good[edge[touched[spoiled]]] = False
        owner[i] = owner[j] = -1
        refused = tried[~good[tried]]
        i, j = ends[refused].T
        y[i], target[j] = x[i], j
        ends, good = np.delete(ends, refused, axis=0), np.delete(good, refused)

    renamed = target[faces]
    renamed = renamed[_proper(renamed)]
    used = np.zeros(len(x), dtype=bool)
    used[renamed] = True
    number_of = np.cumsum(used) - 1
    return y[used], number_of[renamed], int(good.sum())


def _may_be_collapsed(faces: Ints, e: Edges, todo: Ints, near: "_Neighbours") -> Bools:
    """Whether collapses of the edges `todo` keep the topology and four triangles at each vertex.

    The ends have p and q as neighbours in common. If there is a third one, r, the collapse makes
    one edge of (i, r) and (j, r), with four triangles.
    """
    valence = np.bincount(faces.ravel())
    allowed: Bools = _common_neighbours(e, near, todo) == 2
    allowed &= (valence[e.opposite[todo]] > 4).all(axis=1)  # p and q lose one triangle each
    allowed &= valence[e.ends[todo]].sum(axis=1) > 7  # the new vertex has the sum minus four
    return allowed


def _proper(faces: Ints) -> Bools:
    """Which triangles have three different corners."""
    a, b, c = faces.T
    return np.asarray((a != b) & (b != c) & (c != a))


def _spoiled(x: Array, faces: Ints, y: Array, renamed: Ints, longest: Array) -> Bools:
    """Which triangles turn by more than 60 degrees or get a side longer than `longest`."""
    old, new = normals_of(x, faces), normals_of(y, renamed)
    bad = _dot(old, new) < MAX_TURN * np.sqrt(_dot(old, old) * _dot(new, new))
    a, b, c = renamed.T
    for p, q in ((a, b), (b, c), (c, a)):
        bad |= _dot(y[p] - y[q], y[p] - y[q]) > ((longest[p] + longest[q]) / 2) ** 2
    return bad


def _at_vertices(name: str, value: float | Array, n: int) -> Array:
    """A positive number for each vertex, (n,)."""
    if np.ndim(value) == 0:
        return np.full(n, number(name, value, above=0))
    values = finite_array(name, value, (n,))
    if not (values > 0).all():
        raise ValueError(f"{name} must be positive, got {values.min():g}")
    return values


def _mesh(x: Array, faces: Ints) -> tuple[Array, Ints]:
    x, faces = finite_array("x", x, ("n", 3)), integer_array("faces", faces, ("T", 3))
    if faces.size and not 0 <= faces.min() <= faces.max() < len(x):
        raise ValueError(
            f"faces must hold numbers of the {len(x)} vertices, from 0, "
            f"got {faces.min()} to {faces.max()}"
        )
    return x, faces


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _cotangents(x: Array, faces: Ints) -> Array:
    """Cotangents of the angles opposite to each side, in the order of ``Edges.halves``.

    By the law of cosines that opposite to a is (b^2 + c^2 - a^2)/(4 area).
    """
    a, b, c = np.take(x, faces.T, axis=0)
    squares = np.stack([_dot(side, side) for side in (b - a, c - b, a - c)], axis=1)
    half = (squares[:, 0] + squares[:, 1] + squares[:, 2]) / 2
    normals = normals_of(x, faces)
    double_area = np.sqrt(_dot(normals, normals))
    with np.errstate(divide="ignore"):  # a triangle without area asks for a flip above all
        cotangents = (half[:, None] - squares) / double_area[:, None]
    return np.asarray(cotangents.ravel())


def _independent(priority: Array, patches: Ints, n: int) -> Bools:
    """Choose patches of vertices that share none.

    Each vertex remembers the best of its patches, among equals the first, and a patch is chosen if
    all of its vertices remember it. Of three patches in a row, the last is lost to the second
    although that is lost to the first; the next sweep can have it.

    >>> _independent(np.array([3.0, 2.0, 1.0]), np.array([[0, 1], [1, 2], [2, 3]]), 4)
    array([ True, False, False])
    """
    order = np.argsort(-priority, kind="stable")[::-1]
    best = np.empty(n, dtype=np.int64)
    best[patches[order]] = order[:, None]  # what is assigned last remains
    return np.asarray((best[patches] == np.arange(len(patches))[:, None]).all(axis=1))


class _Neighbours(NamedTuple):
    """The vertices around each vertex, and itself: those of v are vertices[start[v]:start[v+1]]."""

    start: Ints
    vertices: Ints


def _neighbours(e: Edges, n: int) -> _Neighbours:
    i, j = e.ends.T
    itself = np.arange(n)
    of, others = np.r_[itself, i, j], np.r_[itself, j, i]
    return _Neighbours(np.r_[0, np.cumsum(np.bincount(of))], others[np.argsort(of)])


def _far_apart(ends: Ints, near: _Neighbours) -> Bools:
    """Choose edges such that no triangle has corners that are neighbours of two of them.

    Of two that are too close to each other, the later one is the better one.
    A collapse changes the triangles at both ends and the number of triangles at p and q, one edge
    away. So ranks are passed on along three edges: from a neighbour of the one, over a side of
    the triangle, to a neighbour of the other.
    """
    rank = np.arange(1, len(ends) + 1)
    best = np.zeros(len(near.start) - 1, dtype=np.int64)
    best[ends] = rank[:, None]  # what is assigned last remains
    for _ in range(3):
        best = np.maximum.reduceat(best[near.vertices], near.start[:-1])
    i, j = ends.T
    return np.asarray((best[i] == rank) & (best[j] == rank))


def _keys(a: Ints, b: Ints) -> Ints:
    """One number for each pair of vertices, in whichever order."""
    return np.asarray(np.minimum(a, b) * 2**31 + np.maximum(a, b))


def _joined(e: Edges, a: Ints, b: Ints) -> Bools:
    """Whether there is an edge between the vertices of each pair."""
    keys, wanted = _keys(*e.ends.T), _keys(a, b)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)  # edges are sorted by key
    return np.asarray(keys[place] == wanted)


def _common_neighbours(e: Edges, near: _Neighbours, todo: Ints) -> Ints:
    """How many neighbours the ends of each edge have in common."""
    i, j = e.ends[todo].T
    count = near.start[i + 1] - near.start[i]
    edge = np.repeat(np.arange(len(todo)), count)
    place = np.arange(len(edge)) + np.repeat(near.start[i] + count - np.cumsum(count), count)
    common = _joined(e, near.vertices[place], j[edge])
    return np.bincount(edge[common], minlength=len(todo)) - 1  # without i itself
