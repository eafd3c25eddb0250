"""Points at one place: vertices that files and programs give more than once."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Bools, Ints
from esfem_core.surfaces.orientation import components, normals_of, sides_of

__all__ = [
    "NEAR",
    "PIECES",
    "diagonal_of",
    "gap_of",
    "is_rounding",
    "joined",
    "merged",
    "merging",
    "repeated",
    "without_unused",
]

NEAR = (0.0, 1e-8, 1e-6)  # distances at which vertices are one, over the diagonal of all
BESIDE = 0.1  # distance of the ends of two edges that were one, over their length
PIECES = 0.1  # pieces that are too much to be lost, over all triangles, by number or by area
VANISH = 0.1  # triangles that may vanish where vertices are merged, over the edges that it closes


def diagonal_of(points: Array) -> float:
    """Diagonal of the box around those points, (n, 3), that are finite.

    Examples
    --------
    >>> diagonal_of(np.array([[0.0, 0, 0], [3, 4, 0], [0, np.nan, 0]]))
    5.0
    """
    finite = points[np.isfinite(points).all(axis=1)]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 0.0


def merged(points: Array, distance: float) -> Ints:
    """Number of the first of the points at each one's place, (n,).

    Examples
    --------
    >>> merged(np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1e-9]]), 1e-8).tolist()
    [0, 1, 0]
    """
    # Adding 0 makes 0 of -0.
    _, first, place = np.unique(points + 0.0, axis=0, return_index=True, return_inverse=True)
    place = place.ravel()
    if distance > 0:
        # The middle of a disc may be given a thousand times: pairs are those of different points.
        place = _near(points[first], distance)[place]
        _, first, place = np.unique(place, return_index=True, return_inverse=True)
    return np.asarray(first[place], dtype=np.int64)


def _near(points: Array, distance: float) -> Ints:
    """A number for each place, (n,): points that a chain of short steps joins are at one."""
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    pairs = finite[cKDTree(points[finite]).query_pairs(distance, output_type="ndarray")]
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(points),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def merging(before: int, what: str, after: int, distance: float) -> str:
    """What :func:`merged` has done, for the notes of a repair."""
    where = f"within {distance:.1g}" if distance else "at the same places"
    return f"merged {before} {what} into {after} {where}"


def joined(vertices: Array, faces: Ints) -> tuple[Ints, float]:
    """Triangles, (T, 3), whose vertices at one place are one if that closes more of the surface.

    Vertices may be merged that are as far apart as rounding puts them, and as little as closes
    most: along seams, where programs go once around. Of triangles whose vertices are at three
    places no more may vanish than :func:`is_rounding` allows; these are left out.

    Returns
    -------
    faces : (T, 3) int array
    distance : float
        Within which vertices are one.

    Examples
    --------
    >>> x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 1e-9], [0, 1, 0], [1, 1, 0]])
    >>> joined(x, np.array([[0, 1, 2], [3, 5, 4]]))[0].tolist()
    [[0, 1, 2], [1, 5, 2]]
    """
    best, distance, size = faces, 0.0, diagonal_of(vertices)
    is_open = _open_edges(faces)
    whole = ~repeated(merged(vertices, 0)[faces])
    for near in NEAR:
        if is_open == 0:
            break
        moved = merged(vertices, near * size)[faces]
        moved = moved[~(repeated(moved) & whole)]
        left = _open_edges(moved)
        if left < is_open and is_rounding(len(best) - len(moved), is_open - left):
            best, distance, is_open = moved, near * size, left
    return best, distance


def is_rounding(gone: int, closed: int) -> bool:
    """Whether so many triangles may vanish where merging closes so many edges.

    Triangles smaller than the gaps between the others must not keep a surface in pieces; but where
    many of them vanish for few edges, it is the shape that is lost.

    Examples
    --------
    >>> is_rounding(1, 9), is_rounding(1, 10)
    (False, True)
    """
    return gone <= VANISH * closed


def gap_of(vertices: Array, faces: Ints) -> float:
    """How far corners are apart across the cracks of a surface in pieces, or 0 if it is in one.

    A piece is joined within itself by edges, and ends mostly where another one goes on, its edges
    beside those of the other, but not joined with them. Few pieces of little area beside a large
    one are none: a triangle or two may be lost.

    Examples
    --------
    >>> x = np.vstack([np.eye(3), np.eye(3) + [0, 0, 1e-3]])
    >>> print(f"{gap_of(x, np.array([[0, 1, 2], [5, 4, 3]])):.1e}")
    1.0e-03
    >>> gap_of(x, np.array([[0, 1, 2], [2, 1, 3]]))
    0.0
    """
    sides = sides_of(faces)
    rim = np.flatnonzero(sides.times == 1)
    if len(rim) < 2:
        return 0.0
    ends = vertices[np.stack([sides.start[rim], sides.end[rim]])]  # (2, R, 3)
    middle = ends.mean(axis=0)
    near = np.asarray(cKDTree(middle).query(middle, k=2)[1])
    other = np.where(near[:, 0] == np.arange(len(rim)), near[:, 1], near[:, 0])
    gap = np.minimum(*(_apart(ends, there[:, other]) for there in (ends, ends[::-1])))
    label = components(sides.edge.reshape(-1, 3))
    area = np.bincount(label, np.linalg.norm(normals_of(vertices, faces), axis=1))
    own = label[rim // 3]
    beside = (own != own[other]) & (gap <= BESIDE * np.linalg.norm(ends[1] - ends[0], axis=1))
    open_edges, beside_others = (np.bincount(own, n, len(area)) for n in (1 + 0 * own, beside))
    area[(open_edges > 0) & (beside_others == 0)] = 0  # sheets apart, such as a ground
    piece = 2 * beside_others > open_edges
    piece[np.argmax(area)] = False
    many = any(size[piece].sum() > PIECES * size.sum() for size in (area, np.bincount(label)))
    return float(gap[beside].max()) if many else 0.0


def _apart(ends: Array, others: Array) -> Array:
    return np.asarray(np.linalg.norm(ends - others, axis=2).max(axis=0))


def _open_edges(faces: Ints) -> int:
    return int((sides_of(faces).times == 1).sum())


def repeated(cells: Ints) -> Bools:
    """Which rows have a number twice."""
    ordered = np.sort(cells, axis=1)
    return np.asarray((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))


def without_unused(vertices: Array, cells: Ints) -> tuple[Array, Ints]:
    """Vertices without those that no cell uses, and the cells with their new numbers.

    Examples
    --------
    >>> vertices, cells = without_unused(np.eye(3), np.array([[2, 0, 2]]))
    >>> len(vertices), cells.tolist()
    (2, [[1, 0, 1]])
    """
    used, renumbered = np.unique(cells, return_inverse=True)
    return vertices[used], renumbered.reshape(cells.shape)
