"""Nested dissection: a binary tree of parts of a mesh, and who separates them.

Halve the elements by a plane across their longest direction, then the halves, and so on. Where
elements are long themselves, as those of cylinders from CAD programs, such a plane may run along a
whole ring of them: where it cuts many edges, planes across the other two principal directions are
tried as well. A node belongs to the smallest part that holds all elements around it: inside a part,
the nodes that its two halves share separate them. Eliminated from the smallest parts to the whole
mesh, the nodes of a part see no others than those of the parts around it. On a surface a part of n
nodes is bounded by O(sqrt(n)) of them, and a Cholesky factor has O(N log N) entries (George, 1973).
"""

from typing import NamedTuple

import numpy as np

from esfem_core.checks import (
    Array,
    Ints,
    check_node_numbers,
    finite_array,
    integer_array,
    whole_number,
)

__all__ = ["Dissection", "dissect"]

# Among directions of equal length rounding errors would choose. These weights prefer x to y to z:
# on round surfaces the coordinate planes are the separators with the fewest nodes.
PREFERENCE = np.array([1.0, 0.99, 0.98])
WIDE = 1.5  # times sqrt(T): edges between the halves of T elements; well-shaped parts have fewer
FEWER = 1.3  # another direction must cut this many times fewer edges to be chosen


class Dissection(NamedTuple):
    """A binary tree of parts: part q of depth d has the halves 2q and 2q + 1 of depth d + 1.

    Attributes
    ----------
    depth : int
        That of the smallest parts; the whole mesh is part 0 of depth 0.
    cell_part : (T,) int array
        The smallest part that each element lies in.
    node_depth, node_part : (N,) int arrays
        The part that each node belongs to.
    """

    depth: int
    cell_part: Ints
    node_depth: Ints
    node_part: Ints

    @property
    def order(self) -> Ints:
        """Nodes in an order of elimination, (N,): each part's after those of its halves."""
        last_leaf = (self.node_part + 1) << (self.depth - self.node_depth)
        return np.lexsort((-self.node_depth, last_leaf))

    def __repr__(self) -> str:
        separators = np.count_nonzero(self.node_depth < self.depth)
        return (
            f"Dissection(depth={self.depth}, parts={2**self.depth}, "
            f"elements={len(self.cell_part)}, nodes={len(self.node_depth)}, "
            f"nodes in separators={separators})"
        )


def dissect(cells: Ints, points: Array, part_size: int = 100) -> Dissection:
    """Divide a mesh until its parts have about `part_size` nodes.

    Parameters
    ----------
    cells : (T, n) int array
        Nodes of each element, corners first.
    points : (N, 3) float array
        Positions of the nodes, each of them in some element.
    part_size : int
        At least 1. No part is divided further than to one element.

    Returns
    -------
    Dissection

    Raises
    ------
    TypeError
        If an argument does not hold numbers.
    ValueError
        If `part_size` is not an integer or less than 1, if an array has the wrong shape, if `cells`
        holds other numbers than those of nodes, if a position is not finite, or if a node lies in
        no element.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> tree = dissect(space.cells, space.nodes)
    >>> tree
    Dissection(depth=4, parts=16, elements=512, nodes=1026, nodes in separators=306)
    >>> tree.depth, np.bincount(tree.cell_part).tolist()[:3]
    (4, [32, 32, 32])
    >>> np.bincount(tree.node_depth).tolist()[:3]  # on one great circle, on the next, ...
    [64, 62, 60]
    """
    part_size = whole_number("part_size", part_size, least=1)
    points = finite_array("points", points, ("N", 3))
    cells = integer_array("cells", cells, ("T", "n"))
    _check_elements(cells, len(points))
    divisions = np.log2(max(len(points) / part_size, 1))
    depth = int(min(np.ceil(divisions), np.log2(len(cells))))
    corners = cells[:, :3]
    cell_part = _bisect(PREFERENCE * points[corners].mean(axis=1), _neighbours(corners), depth)
    first = np.full(len(points), 2**depth)
    last = np.full(len(points), -1)
    for nodes in cells.T:
        np.minimum.at(first, nodes, cell_part)
        np.maximum.at(last, nodes, cell_part)
    if (last < 0).any():
        raise ValueError(f"node {int(np.argmin(last))} lies in no element")
    # Numbers of parts are paths from the root: where two of them part, all digits below differ.
    height = np.frexp((first ^ last).astype(float))[1].astype(np.int64)
    return Dissection(depth, cell_part, depth - height, first >> height)


def _check_elements(cells: Ints, n_points: int) -> None:
    """Refuse what holds no elements of these points.

    Examples
    --------
    >>> _check_elements(np.zeros((0, 3), dtype=int), 4)
    Traceback (most recent call last):
        ...
    ValueError: cells must have shape (T, n) with T >= 1 and n >= 3, got (0, 3)
    """
    if len(cells) < 1 or cells.shape[1] < 3:
        raise ValueError(f"cells must have shape (T, n) with T >= 1 and n >= 3, got {cells.shape}")
    check_node_numbers("cells", cells, n_points)


def _neighbours(corners: Ints) -> tuple[Ints, Ints]:
    """Pairs of elements that share an edge."""
    others = np.roll(corners, -1, axis=1)
    edges = np.minimum(corners, others) * (corners.max() + 1) + np.maximum(corners, others)
    order = np.argsort(edges, axis=None, kind="stable")
    twice = np.flatnonzero(np.diff(edges.ravel()[order]) == 0)
    return order[twice] // 3, order[twice + 1] // 3


def _bisect(centers: Array, neighbours: tuple[Ints, Ints], depth: int) -> Ints:
    """Halve a set of elements `depth` times, all parts of a depth at once; number of the part."""
    order, counts = np.arange(len(centers)), np.array([len(centers)])
    for _ in range(depth):
        first, part = np.cumsum(counts) - counts, _numbered(counts)
        c = centers[order]
        c -= (np.add.reduceat(c, first) / counts[:, None])[part]
        axes = np.linalg.eigh(np.add.reduceat(c[:, :, None] * c[:, None], first))[1]
        shortest, middle, longest = np.moveaxis(axes, 2, 0)
        halves = np.column_stack([counts // 2, counts - counts // 2]).ravel()

        best = order[_sorted_along(longest, c, part)]
        cut = _cut_edges(best, halves, neighbours)
        if (cut > WIDE * np.sqrt(counts)).any():
            for direction in (middle, shortest):
                other = order[_sorted_along(direction, c, part)]
                other_cut = _cut_edges(other, halves, neighbours)
                better = FEWER * other_cut < cut
                best = np.where(better[part], other, best)
                cut = np.where(better, other_cut, cut)
        order, counts = best, halves
    parts = np.empty(len(centers), dtype=np.int64)
    parts[order] = _numbered(counts)
    return parts


def _numbered(counts: Ints) -> Ints:
    """0 as often as the first count says, then 1, and so on."""
    return np.repeat(np.arange(len(counts)), counts)


def _sorted_along(direction: Array, c: Array, part: Ints) -> Ints:
    """Order of the elements of each part along its direction."""
    return np.lexsort((np.vecdot(c, direction[part]), part))


def _cut_edges(order: Ints, halves: Ints, neighbours: tuple[Ints, Ints]) -> Ints:
    """How many edges lie between the two halves of each part."""
    half = np.empty_like(order)
    half[order] = _numbered(halves)
    one, other = half[neighbours[0]], half[neighbours[1]]
    return np.bincount(one[one ^ other == 1] // 2, minlength=len(halves) // 2)
