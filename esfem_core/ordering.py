"""Elimination order for sparse factorisations: nested dissection by coordinates."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["nested_dissection"]

LEAF = 8  # parts of at most this many elements are not divided further


def nested_dissection(cells: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order the nodes of a mesh so that a factorisation has little fill and large supernodes.

    Halve the elements by a plane across their longest direction, number the nodes inside either
    half before those that both halves share, and go on likewise in the halves. On a surface the n
    nodes of a part are separated by O(sqrt(n)) of them, and a Cholesky factor has O(n log n)
    entries (George, 1973).

    Parameters
    ----------
    cells : (T, n) int array
        Nodes of each element, corners first.
    points : (N, 3) float array
        Positions of the nodes.

    Returns
    -------
    (N,) int array
        Node numbers in the order of elimination.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> order = nested_dissection(space.cells, space.nodes)
    >>> bool((np.sort(order) == np.arange(len(space.nodes))).all())
    True
    """
    centers = points[cells[:, :3]].mean(axis=1)
    separating = np.zeros(len(points), dtype=bool)
    in_left = np.zeros(len(points), dtype=bool)

    def inner(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.unique(nodes[~separating[nodes]])

    def dissect(part: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        centered = centers[part] - centers[part].mean(axis=0)
        position = centered @ np.linalg.eigh(centered.T @ centered)[1][:, -1]
        right = position > np.median(position)
        if len(part) <= LEAF or not right.any():
            return [inner(cells[part].ravel())]
        left_nodes, right_nodes = cells[part[~right]], cells[part[right]]
        in_left[left_nodes] = True
        separator = inner(right_nodes[in_left[right_nodes]])
        in_left[left_nodes] = False
        separating[separator] = True
        return [*dissect(part[~right]), *dissect(part[right]), separator]

    return np.concatenate(dissect(np.arange(len(cells))))
