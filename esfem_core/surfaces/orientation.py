"""Which way the triangles of a surface run: alike with their neighbours, and outwards.

Components are judged one by one. One that lies in no other must be oriented outwards; a cavity,
which lies in an odd number of others, inwards, so that normals point out of the body. One lies in
another if it is smaller, a point deep in it does, and it sticks out by no more than flat triangles
are away from a curved surface: those of the two sides of a thin shell may cross.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Bools, Ints

__all__ = [
    "Shells",
    "Sides",
    "coincident",
    "components",
    "directed",
    "fans",
    "normals_of",
    "open_components",
    "shells",
    "sides_of",
    "turned_to_agree",
    "turned_to_outside",
    "volumes",
    "winding_numbers",
    "with_turned",
]

PROBES = 3  # triangles of a component from which one looks for a point deep in it
DEPTHS = 0.25 ** np.arange(10, 0, -1)  # of such points, over the diagonal of the component
FLAT = 1e-12  # largest volume over area times diameter that is none
SAME = 1e-6  # distance of components at one place, over their diagonal: files have six digits
CHUNK = 2**18  # pairs of points and triangles at a time
ALONG = np.linalg.qr([[0.3127, 1, 0], [0.5413, 0, 1], [0.7805, 0, 0]])[0][:, [1, 2, 0]]
"""Axes of which the last is the direction of a ray, to be multiplied from the right."""


class Sides(NamedTuple):
    """The sides of the triangles (half-edges in the literature), and which of them are one edge.

    Side 3t + n of triangle t runs from its corner n to the next.

    Attributes
    ----------
    start, end : (3T,) int arrays
        Vertices.
    edge : (3T,) int array
        Number of the edge.
    times : (3T,) int array
        How many sides this edge has: 2 on a closed surface.
    """

    start: Ints
    end: Ints
    edge: Ints
    times: Ints

    def pairs(self) -> Ints:
        """The two sides of each edge that has two, (E, 2)."""
        order = np.argsort(self.edge, kind="stable")
        return np.asarray(order[self.times[order] == 2].reshape(-1, 2), dtype=np.int64)


def normals_of(vertices: Array, faces: Ints) -> Array:
    """Normals of triangles, as long as twice their area, (T, 3)."""
    # As by vertices[faces.T] and np.cross, in a quarter of their time.
    a, b, c = np.take(np.asarray(vertices), faces.T, axis=0)
    u, v = (b - a).T, (c - a).T
    normals: Array = np.empty_like(a)
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(u[i] * v[j], u[j] * v[i], out=normals[:, k])
    return normals


def sides_of(faces: Ints) -> Sides:
    """List the sides of triangles, (T, 3), of any mesh.

    Examples
    --------
    >>> sides_of(np.array([[0, 1, 2], [1, 0, 3]])).times.tolist()
    [2, 1, 1, 2, 1, 1]
    """
    faces = np.asarray(faces, dtype=np.int64)  # of a narrower type, the keys would overflow
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(start, end) * (int(faces.max(initial=0)) + 1) + np.maximum(start, end)
    _, edge, count = np.unique(keys, return_inverse=True, return_counts=True)
    return Sides(start, end, edge.ravel(), count[edge.ravel()])


def directed(sides: Sides) -> set[tuple[int, int]]:
    """The sides as pairs of vertices, (start, end).

    Examples
    --------
    >>> sorted(directed(sides_of(np.array([[0, 1, 2]]))))
    [(0, 1), (1, 2), (2, 0)]
    """
    return set(zip(sides.start.tolist(), sides.end.tolist(), strict=True))


def components(faces: Ints) -> Ints:
    """Which component each triangle belongs to, (T,): those that are joined by vertices.

    Examples
    --------
    >>> components(np.array([[0, 1, 2], [5, 6, 7], [2, 1, 3]])).tolist()
    [0, 1, 0]
    """
    faces = np.asarray(faces, dtype=np.int64)
    n = int(faces.max(initial=-1)) + 1
    links = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_array((np.ones(links.shape[1]), tuple(links)), shape=(n, n))
    of_vertex = connected_components(graph, directed=False)[1]
    _, label = np.unique(of_vertex[faces[:, 0]], return_inverse=True)
    return np.asarray(label.ravel(), dtype=np.int64)


def open_components(faces: Ints, sides: Sides) -> Bools:
    """Which triangles belong to a component with a boundary, (T,).

    Examples
    --------
    >>> faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2], [5, 6, 7]])
    >>> open_components(faces, sides_of(faces)).tolist()
    [False, False, False, False, True]
    """
    at_boundary = (sides.times == 1).reshape(-1, 3).any(axis=1)
    if not at_boundary.any():
        return np.asarray(at_boundary)
    label = components(faces)
    return np.asarray(np.isin(label, label[at_boundary]))


def fans(faces: Ints, pairs: Ints) -> Ints:
    """To which fan each corner of the triangles belongs, (3T,).

    Corners of neighbouring triangles at the same end of their common edge are linked; the
    connected corners around a vertex are a fan.

    Parameters
    ----------
    faces : (T, 3) int array
    pairs : (E, 2) int array
        Sides, as :class:`Sides` numbers them, of two neighbours.
    """
    n = faces.size
    next_corner = np.roll(np.arange(n).reshape(-1, 3), -1, axis=1).ravel()
    one, other = pairs.T
    against = faces.ravel()[one] == faces.ravel()[other]
    links = (
        np.concatenate([one, next_corner[one]]),
        np.concatenate(
            [
                np.where(against, other, next_corner[other]),
                np.where(against, next_corner[other], other),
            ]
        ),
    )
    graph = coo_array((np.ones(2 * len(pairs)), links), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def turned_to_agree(faces: Ints) -> tuple[Bools, Bools]:
    """Which triangles to turn so that neighbours run in opposite directions through their edge.

    Take two copies of each triangle, one to each side, and link copies of neighbours that agree.
    Around an orientable component the two copies stay apart: they are its two orientations, and
    that which turns fewer triangles is taken.

    Parameters
    ----------
    faces : (T, 3) int array
        Only edges of two triangles make neighbours.

    Returns
    -------
    turned : (T,) bool array
    orientable : (T,) bool array
        False in components that have no orientation, such as a Klein bottle.

    Examples
    --------
    >>> turned_to_agree(np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))[0].tolist()
    [True, False, False, False]
    """
    n = len(faces)
    sides = sides_of(faces)
    one, other = sides.pairs().T
    against = sides.start[one] == sides.start[other]
    one, other = one // 3, other // 3
    links = (
        np.concatenate([one, one + n]),
        np.concatenate([other + n * against, other + n * ~against]),
    )
    graph = coo_array((np.ones(2 * len(one)), links), shape=(2 * n, 2 * n))
    sheet = connected_components(graph, directed=False)[1].reshape(2, n)
    orientable = sheet[0] != sheet[1]
    turned = sheet[0] > sheet[1]
    patch = sheet.min(axis=0)
    mostly = np.bincount(patch, turned, minlength=2 * n) > np.bincount(patch, minlength=2 * n) / 2
    return (turned ^ mostly[patch]) & orientable, orientable


class Shells(NamedTuple):
    """The components of a closed surface.

    Attributes
    ----------
    label : (T,) int array
        Component of each triangle.
    volume : (C,) float array
        Enclosed volumes, negative if oriented inwards.
    depth : (C,) int array
        In how many others each of them lies.
    flat : (C,) bool array
        Which enclose no volume.
    """

    label: Ints
    volume: Array
    depth: Ints
    flat: Bools

    def wrong(self) -> Bools:
        """Which components are oriented the wrong way, (C,)."""
        return np.asarray((self.volume < 0) != (self.depth % 2 == 1))


def volumes(vertices: Array, faces: Ints, label: Ints) -> Array:
    """Volumes that the components of a closed surface enclose, (C,), negative if inside out.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 0)
    >>> volumes(tri.vertices, tri.faces, components(tri.faces)).round(3)
    array([1.333])
    """
    _, first = np.unique(label, return_index=True)
    # Relative to a vertex of its own, so that places far from the origin cost no digits.
    a, b, c = (vertices[corner] - vertices[faces[first, 0]][label] for corner in faces.T)
    return np.bincount(label, (a * np.cross(b, c)).sum(axis=1)) / 6


def shells(vertices: Array, faces: Ints) -> Shells:
    """Components, volumes and nesting of a closed surface whose neighbours are oriented alike.

    Examples
    --------
    >>> import esfem_core as ec
    >>> x, faces = ec.sphere().vertices, ec.sphere().faces
    >>> nested = shells(np.vstack([x, 0.5 * x]), np.vstack([faces, len(x) + faces[:, ::-1]]))
    >>> nested.depth.tolist(), np.sign(nested.volume).tolist(), nested.wrong().tolist()
    ([0, 1], [1.0, -1.0], [False, False])
    """
    label = components(faces)
    volume = volumes(vertices, faces, label)
    area = np.bincount(label, np.linalg.norm(normals_of(vertices, faces), axis=1)) / 2
    low, high = _boxes(vertices, faces, label, len(volume))
    flat = np.abs(volume) <= FLAT * area * np.linalg.norm(high - low, axis=1)
    return Shells(label, volume, _depths(vertices, faces, label, volume, low, high), flat)


def coincident(vertices: Array, faces: Ints, label: Ints) -> tuple[int, int] | None:
    """The first two components whose corners are at the same places, or None.

    Neither lies in the other, and what their nesting says is chance.

    Examples
    --------
    >>> faces = np.array([[0, 1, 2], [3, 4, 5]])
    >>> coincident(np.vstack([np.eye(3), np.eye(3)]), faces, components(faces))
    (0, 1)
    """
    count = int(label.max()) + 1
    if count == 1:
        return None
    low, high = _boxes(vertices, faces, label, count)
    reach = SAME * np.linalg.norm(high - low, axis=1)
    boxes = np.hstack([low, high])
    for c, others in enumerate(cKDTree(boxes).query_ball_point(boxes, np.sqrt(6) * reach)):
        for other in sorted(o for o in others if o > c):
            own, there = (np.unique(faces[label == n]) for n in (c, other))
            gap, _ = cKDTree(vertices[there]).query(vertices[own])
            if len(own) == len(there) and (gap <= reach[c]).all():
                return c, other
    return None


def turned_to_outside(faces: Ints, nodes: Array, pieces: Ints) -> Bools:
    """Which triangles of an orientable surface to turn so that it is oriented as it must be.

    Those of a closed component so that it is oriented outwards, or inwards if it is a cavity;
    those of one with a boundary so that neighbours agree and most triangles stay.

    Parameters
    ----------
    faces : (T, 3) int array
        Triangles, or the corners of curved elements.
    nodes : (N, 3) float array
    pieces : (mT, 3) int array
        Flat triangles between the nodes that insides are told by, m in succession for each of
        `faces` and oriented as it is; `faces` themselves if nothing is curved.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 1)
    >>> faces = tri.faces[:, ::-1]
    >>> turned_to_outside(faces, np.asarray(tri.vertices), faces).all()
    np.True_
    """
    faces = np.asarray(faces, dtype=np.int64)  # NumPy 2.0 takes no uint64 for numbers of vertices
    turned, _ = turned_to_agree(faces)
    closed = ~open_components(faces, sides_of(faces))
    if closed.any():
        each = len(pieces) // len(faces)
        of_closed = np.repeat(closed, each)
        found = shells(nodes, with_turned(pieces, np.repeat(turned, each))[of_closed])
        turned[closed] ^= found.wrong()[found.label[::each]]
    return turned


def with_turned(faces: Ints, turned: Bools) -> Ints:
    """Triangles of which some are turned, (T, 3)."""
    return np.asarray(np.where(turned[:, None], faces[:, ::-1], faces))


def winding_numbers(points: Array, vertices: Array, faces: Ints) -> Array:
    """How often a closed surface winds around points: 1 inside, 0 outside.

    A ray from the point, in a direction that no mesh has, leaves the surface so many times more
    often than it enters. Seen along it, a triangle is crossed where the point lies on the same side
    of its three edges. On the surface itself the number is that of one side or the other.

    Parameters
    ----------
    points : (P, 3) float array
    vertices : (n, 3) float array
    faces : (T, 3) int array

    Returns
    -------
    (P,) float array

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 1)
    >>> winding_numbers(np.array([[0, 0, 0.5], [0, 0, 2]]), tri.vertices, tri.faces).tolist()
    [1.0, 0.0]
    """
    return _windings(points, np.asarray(vertices)[faces])


def _windings(points: Array, triangles: Array) -> Array:
    """The same for triangles given by their corners, (T, 3, 3)."""
    origin = triangles[0, 0]
    corners = ((triangles - origin) @ ALONG).transpose(1, 2, 0)  # (3, 3, T): corner, axis
    seen = (points - origin) @ ALONG
    begin, end = np.roll(corners, -1, axis=0), np.roll(corners, -2, axis=0)  # sides opposite
    x, y = (end - begin)[:, :2].transpose(1, 0, 2)
    lines = np.stack([-y, x, y * begin[:, 0] - x * begin[:, 1]], axis=2)  # (3, T, 3)
    step = max(1, CHUNK // len(triangles))
    out = np.empty(len(points))
    for n in range(0, len(points), step):
        p = seen[n : n + step]
        left = lines @ np.stack([p[:, 0], p[:, 1], np.ones(len(p))])  # (3, T, step)
        t, i = np.nonzero((left > 0).all(axis=0) | (left < 0).all(axis=0))
        share = left[:, t, i]
        total = share.sum(axis=0)
        height = (share * corners[:, 2, t]).sum(axis=0) / total
        crossed = np.sign(total) * (height > p[i, 2])
        out[n : n + step] = np.bincount(i, crossed, minlength=len(p))
    return out


def _boxes(vertices: Array, faces: Ints, label: Ints, count: int) -> tuple[Array, Array]:
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in faces.T:
        np.minimum.at(low, label, vertices[corner])
        np.maximum.at(high, label, vertices[corner])
    return low, high


def _depths(
    vertices: Array, faces: Ints, label: Ints, volume: Array, low: Array, high: Array
) -> Ints:
    """In how many others each component lies.

    Those are larger, hold a point deep in it, and their boxes hold its box, but for a bulge.
    """
    count = len(low)
    depth = np.zeros(count, dtype=np.int64)
    if count == 1:
        return depth
    size = np.abs(volume)
    inwards = -np.sign(volume) * np.linalg.norm(high - low, axis=1)
    order, ends = np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))
    places = np.split(vertices[faces[order]], ends[:-1])  # the triangles of each component
    points = np.full((count, 3), np.nan)
    bulge = np.zeros(count)
    sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    np.maximum.at(bulge, label, np.linalg.norm(sides, axis=2).max(axis=1) / 4)
    # A box inside another begins there in x, too: of thousands of parts few are compared.
    in_x = np.argsort(low[:, 0], kind="stable")
    begin = np.searchsorted(low[in_x, 0], low[:, 0] - bulge, "left")
    end = np.searchsorted(low[in_x, 0], high[:, 0], "right")
    for outer in range(count):
        near = in_x[begin[outer] : end[outer]]
        near = near[size[near] < size[outer]]
        slack = np.minimum(bulge[outer], np.abs(inwards[near]) / 20)[:, None]
        within = (low[near] >= low[outer] - slack) & (high[near] <= high[outer] + slack)
        inner = near[within.all(axis=1)]
        for c in inner[np.isnan(points[inner, 0])]:
            points[c] = _deep(places[c], inwards[c])
        if len(inner):
            depth[inner] += _windings(points[inner], places[outer]) != 0
    return depth


def _deep(triangles: Array, inwards: float) -> Array:
    """A point that a component encloses, far from its triangles; on one if it encloses nothing.

    Below some triangles one goes down until the surface is left again, and back a third of the way.
    """
    some = triangles[np.arange(PROBES) * len(triangles) // PROBES]
    normal = normals_of(some.reshape(-1, 3), np.arange(3 * PROBES).reshape(-1, 3))
    normal *= inwards / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    centre = some.mean(axis=1)
    tried = centre[:, None] + DEPTHS[:, None] * normal[:, None]
    inside = _windings(tried.reshape(-1, 3), triangles).reshape(PROBES, -1) != 0
    passed = np.where(inside.all(axis=1), len(DEPTHS), inside.argmin(axis=1))  # without a gap
    best = int(passed.argmax())
    reached = DEPTHS[passed[best] - 1] if passed[best] else 0.0
    return np.asarray(centre[best] + 2 / 3 * reached * normal[best])
