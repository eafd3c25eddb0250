"""Closest points of flat triangles: the triangle, and where in it."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Ints
from esfem_core.surfaces.balls import Balls

__all__ = ["FootPoints"]


LONGEST = 1000.0  # sides over heights: no more balls for a triangle from there on


class FootPoints:
    """The closest points of given triangles, for many points.

    Called with points, (n, 3), it returns their triangles, (n,), and barycentric coordinates in
    them, (n, 3).

    A point of a hub, where n long triangles meet, lies in the balls around all of them, and all
    its points with all triangles are n^2 pairs. So long triangles have several balls in a row,
    and a point lies in about sqrt(n) of these.

    Parameters
    ----------
    corners : (T, 3, 3) float array
        Corners of triangles; if they have no area, distances of some points are too large.
    slack : float or (T,) float array
        How far what a triangle stands for may be from it: counts in the search of pairs.

    Examples
    --------
    >>> foot = FootPoints(np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    >>> foot(np.array([[0.25, 0.25, 1.0], [2.0, 0.0, 0.0]]))
    (array([0, 0]), array([[0.5 , 0.25, 0.25],
           [0.  , 1.  , 0.  ]]))
    """

    def __init__(self, corners: Array, slack: float | Array = 0.0) -> None:
        self.corners = corners
        self._centre, radius, self._owner = _balls(corners)
        self._radius = radius + np.broadcast_to(slack, len(corners))[self._owner]
        self._tree = cKDTree(self._centre)
        self._balls = Balls(self._centre, self._radius)

    def __call__(self, points: Array) -> tuple[Ints, Array]:
        """Triangles, (n,), and barycentric coordinates in them, (n, 3), of points, (n, 3)."""
        everything, first = np.arange(len(points)), self.near(points)
        rows = [(everything, first, *self.foot(points, first))]
        bound = rows[0][3]
        for point, triangle in self.pairs(points, bound):
            rows.append((point, triangle, *self.foot(points[point], triangle)))
        point, triangle, local, distance = (np.concatenate(r) for r in zip(*rows, strict=True))
        order = np.lexsort((triangle, distance, point))
        best = order[np.unique(point[order], return_index=True)[1]]
        return triangle[best], local[best]

    def near(self, points: Array) -> Ints:
        """A triangle near each point, (n,)."""
        return self._owner[self._tree.query(points)[1]]

    def foot(self, points: Array, triangle: Ints) -> tuple[Array, Array]:
        """Barycentric coordinates of closest points of one triangle each, (n, 3), and distances."""
        return _foot(points, self.corners[triangle])

    def pairs(self, points: Array, bound: Array) -> Iterator[tuple[Ints, Ints]]:
        """Pairs of a point and a triangle that may be closer than a bound, chunk by chunk.

        Some come more than once.
        """
        for point, ball in self._balls.near(points, bound):
            away = np.linalg.norm(points[point] - self._centre[ball], axis=1)
            keep = away <= (bound[point] + self._radius[ball]) * (1 + 1e-12)
            pairs = np.unique(point[keep] * len(self.corners) + self._owner[ball[keep]])
            yield np.divmod(pairs, len(self.corners))


def _balls(corners: Array) -> tuple[Array, Array, Ints]:
    """Balls that hold triangles: centres, (B, 3), radii, and whose they are, (B,).

    Those of one stand in a row over its longest side, and hold a rectangle.
    """
    every = np.arange(len(corners))
    sides = np.roll(corners, -1, axis=1) - corners
    squares = (sides * sides).sum(axis=2)
    n = squares.argmax(axis=1)
    start, side, square = corners[every, n], sides[every, n], np.maximum(squares[every, n], 1e-300)
    up = corners[every, (n + 2) % 3] - start
    up -= ((up * side).sum(axis=1) / square)[:, None] * side
    length, height = np.sqrt(square), np.linalg.norm(up, axis=1)
    count = np.rint(np.sqrt(length / np.maximum(height, length / LONGEST))).astype(np.int64)

    owner = np.repeat(every, count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    share = ((place + 0.5) / count[owner])[:, None]
    centre = start[owner] + share * side[owner] + up[owner] / 2
    radius = np.hypot(length / count, height) / 2 + 1e-12 * length  # with rounding
    return centre, radius[owner], owner


def _foot(points: Array, corners: Array) -> tuple[Array, Array]:
    """Barycentric coordinates of the closest points, (n, 3), and distances, (n,)."""
    sides = np.roll(corners, -1, axis=1) - corners  # from each corner to the next
    normal = np.cross(sides[:, 0], sides[:, 1])
    relative = points[:, None] - corners
    # The share of corner n is the area over the side opposite to it, from corner n + 1 to n + 2.
    areas = np.einsum("nci,ni->nc", np.cross(sides, relative), normal)
    square = np.maximum((normal * normal).sum(axis=1), 1e-300)
    inside = np.roll(areas, -1, axis=1) / square[:, None]

    along = (relative * sides).sum(axis=2) / np.maximum((sides * sides).sum(axis=2), 1e-300)
    t = np.clip(along, 0, 1)
    off = np.linalg.norm(relative - t[..., None] * sides, axis=2)
    side = off.argmin(axis=1)
    rows = np.arange(len(points))
    on_side = np.zeros_like(inside)
    on_side[rows, side] = 1 - t[rows, side]
    on_side[rows, (side + 1) % 3] = t[rows, side]

    length = np.linalg.norm(normal, axis=1)
    within = (inside >= 0).all(axis=1) & (length > 0)
    local = np.where(within[:, None], inside, on_side)
    above = np.abs((relative[:, 0] * normal).sum(axis=1)) / np.maximum(length, 1e-300)
    return local, np.where(within, above, off[rows, side])
