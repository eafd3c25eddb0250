"""Loops of open edges, and the triangles of smallest area that fill them."""

from collections.abc import Iterator

import numpy as np

from esfem_core.checks import Array
from esfem_core.surfaces.orientation import Sides

__all__ = ["lid_of", "rims"]


def rims(sides: Sides, reverse: bool = False) -> Iterator[list[int]]:
    """Closed loops of open sides, each as its vertices in the direction that a lid needs.

    A walk from side to side; where it comes back to a vertex it has passed, the loop since then
    is cut off.

    Parameters
    ----------
    sides : Sides
    reverse : bool
        The other direction: that in which the sides themselves run.

    Examples
    --------
    >>> from esfem_core.surfaces import sides_of
    >>> sides = sides_of(np.array([[0, 1, 2]]))
    >>> list(rims(sides)), list(rims(sides, reverse=True))
    ([[1, 0, 2]], [[0, 1, 2]])
    """
    is_open = sides.times == 1
    start, end = sides.start[is_open], sides.end[is_open]
    if reverse:
        start, end = end, start
    after: dict[int, list[int]] = {}
    for i, j in zip(start.tolist(), end.tolist(), strict=True):
        after.setdefault(j, []).append(i)
    for begin in list(after):
        walk, place = [begin], {begin: 0}
        while walk:
            ways = after.get(walk[-1])
            if not ways:
                del place[walk.pop()]
                continue
            vertex = ways.pop()
            if vertex not in place:
                place[vertex] = len(walk)
                walk.append(vertex)
                continue
            n = place[vertex]
            yield walk[n:]
            for passed in walk[n + 1 :]:
                del place[passed]
            del walk[n + 1 :]


def lid_of(
    vertices: Array, rim: list[int], taken: set[tuple[int, int]]
) -> list[tuple[int, int, int]]:
    """Triangles of the smallest area that fill a loop; [] if there are none.

    Dynamic programming over the parts of the loop from i to j (Barequet and Sharir 1995): the
    best triangle on the chord from i to j has its third corner m between them. Chords that are
    edges of the surface already are not allowed, and flat triangles are the last resort.

    Parameters
    ----------
    vertices : (n, 3) float array
    rim : list of int
        Vertices of the loop, in the direction of the triangles.
    taken : set of (int, int)
        Edges of the surface, in one direction or both; those of the lid are added.

    Examples
    --------
    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> lid_of(square, [0, 1, 2, 3], {(1, 3)})
    [(0, 2, 3), (0, 1, 2)]
    """
    n = len(rim)
    x = vertices[rim] - vertices[rim[0]]
    cost, third = np.full((n, n), np.inf), np.zeros((n, n), dtype=np.int64)
    cost[np.arange(n - 1), np.arange(1, n)] = 0
    scale = float((np.ptp(x, axis=0) ** 2).sum())
    closed = np.zeros((n, n), dtype=bool)
    for one in range(n):
        for other in range(one + 2, n):
            ends = rim[one], rim[other]
            closed[one, other] = ends in taken or ends[::-1] in taken
    closed[0, n - 1] = False
    for length in range(2, n):
        i = np.arange(n - length)
        j = i + length
        m = i[:, None] + np.arange(1, length)
        a, b, c = x[i][:, None], x[m], x[j][:, None]
        area = np.linalg.norm(np.cross(b - a, c - a), axis=2) / 2
        squares = ((b - a) ** 2 + (c - b) ** 2).sum(axis=2) + ((c - a) ** 2).sum(axis=2)
        flat = area < 1e-6 * squares
        total = cost[i[:, None], m] + cost[m, j[:, None]] + area + 1e3 * scale * flat
        best = total.argmin(axis=1)
        cost[i, j] = np.where(closed[i, j], np.inf, total[i, best])
        third[i, j] = m[i, best]
    if not np.isfinite(cost[0, n - 1]):
        return []
    lid, parts = [], [(0, n - 1)]
    while parts:
        one, other = parts.pop()
        if other - one < 2:
            continue
        between = int(third[one, other])
        lid.append((rim[one], rim[between], rim[other]))
        taken |= {(rim[one], rim[other]), (rim[other], rim[one])}
        parts += [(one, between), (between, other)]
    return lid
