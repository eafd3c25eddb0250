"""Closest points of flat triangles: the triangle, and where in it."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Ints
from esfem_core.surfaces.balls import Balls

__all__ = ["FootPoints"]


class FootPoints:
    """The closest points of given triangles, for many points.

    Called with points, (n, 3), it returns their triangles, (n,), and barycentric coordinates in
    them, (n, 3).

    Parameters
    ----------
    corners : (T, 3, 3) float array
        Corners of proper triangles.

    Examples
    --------
    >>> foot = FootPoints(np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    >>> foot(np.array([[0.25, 0.25, 1.0], [2.0, 0.0, 0.0]]))
    (array([0, 0]), array([[0.5 , 0.25, 0.25],
           [0.  , 1.  , 0.  ]]))
    """

    def __init__(self, corners: Array) -> None:
        self.corners = corners
        self.centre = corners.mean(axis=1)
        self.radius = np.linalg.norm(corners - self.centre[:, None], axis=2).max(axis=1)
        self.nearest = cKDTree(self.centre)
        self.balls = Balls(self.centre, self.radius)

    def __call__(self, points: Array) -> tuple[Ints, Array]:
        """Triangles, (n,), and barycentric coordinates in them, (n, 3), of points, (n, 3)."""
        everything = np.arange(len(points))
        first = np.asarray(self.nearest.query(points)[1], dtype=np.int64)
        rows = [(everything, first, *_foot(points, self.corners[first]))]
        bound = rows[0][3]
        for point, triangle in self._pairs(points, bound):
            rows.append((point, triangle, *_foot(points[point], self.corners[triangle])))
        point, triangle, local, distance = (np.concatenate(r) for r in zip(*rows, strict=True))
        order = np.lexsort((triangle, distance, point))
        best = order[np.unique(point[order], return_index=True)[1]]
        return triangle[best], local[best]

    def _pairs(self, points: Array, bound: Array) -> Iterator[tuple[Ints, Ints]]:
        """Pairs of a point and a triangle that may be closer than a bound, chunk by chunk."""
        for point, triangle in self.balls.near(points, bound):
            away = np.linalg.norm(points[point] - self.centre[triangle], axis=1)
            keep = away <= (bound[point] + self.radius[triangle]) * (1 + 1e-12)
            yield point[keep], triangle[keep]


def _foot(points: Array, corners: Array) -> tuple[Array, Array]:
    """Barycentric coordinates of the closest points, (n, 3), and distances, (n,)."""
    sides = np.roll(corners, -1, axis=1) - corners  # from each corner to the next
    normal = np.cross(sides[:, 0], sides[:, 1])
    relative = points[:, None] - corners
    # The share of corner n is the area over the side opposite to it, from corner n + 1 to n + 2.
    areas = np.einsum("nci,ni->nc", np.cross(sides, relative), normal)
    inside = np.roll(areas, -1, axis=1) / (normal * normal).sum(axis=1)[:, None]

    along = (relative * sides).sum(axis=2) / (sides * sides).sum(axis=2)
    t = np.clip(along, 0, 1)
    off = np.linalg.norm(relative - t[..., None] * sides, axis=2)
    side = off.argmin(axis=1)
    rows = np.arange(len(points))
    on_side = np.zeros_like(inside)
    on_side[rows, side] = 1 - t[rows, side]
    on_side[rows, (side + 1) % 3] = t[rows, side]

    within = (inside >= 0).all(axis=1)
    local = np.where(within[:, None], inside, on_side)
    above = np.abs((relative[:, 0] * normal).sum(axis=1)) / np.linalg.norm(normal, axis=1)
    return local, np.where(within, above, off[rows, side])
