"""Which of many balls come near to which of many points."""

from collections.abc import Iterator
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Ints

__all__ = ["Balls"]

CHUNK = 50_000  # pairs that are treated at once
ROUNDING = 1 + 1e-12


class Balls:
    """Balls around pieces of a surface, for searches of closest points.

    Parameters
    ----------
    centre : (n, 3) float array
    radius : (n,) float array
        Positive.

    Examples
    --------
    >>> balls = Balls(np.array([[0.0, 0, 0], [5, 0, 0]]), np.array([1.0, 1.0]))
    >>> [(p.tolist(), b.tolist()) for p, b in balls.near(np.array([[2.0, 0, 0]]), np.array([1.5]))]
    [([0], [0])]
    """

    def __init__(self, centre: Array, radius: Array) -> None:
        # One large ball must not blow up the search for all: a tree for each size.
        octave = np.frexp(radius)[1]
        members = [np.flatnonzero(octave == i) for i in np.unique(octave)]
        self._trees = [(m, cKDTree(centre[m]), radius[m].max()) for m in members]

    def near(self, points: Array, bound: Array) -> Iterator[tuple[Ints, Ints]]:
        """Pairs of a point and a ball that may be closer than a bound, (n,), chunk by chunk.

        Balls of about equal size are taken as equally large: some pairs are farther apart.
        """
        for members, tree, radius in self._trees:
            reach = (bound + radius) * ROUNDING
            count = tree.query_ball_point(points, reach, return_length=True)
            ends = np.flatnonzero(np.diff(np.cumsum(count) // CHUNK)) + 1
            for part in np.split(np.arange(len(points)), ends):
                lists = tree.query_ball_point(points[part], reach[part])
                ball = members[np.fromiter(chain.from_iterable(lists), np.int64)]
                yield np.repeat(part, count[part]), ball
