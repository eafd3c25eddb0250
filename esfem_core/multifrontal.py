"""Sparse factorisations made of small dense matrices, in NumPy.

The nodes of a dissected mesh are eliminated part by part, from the smallest parts to the whole
(Duff and Reid, 1983). A part's front is a dense symmetric matrix on the nodes I that it owns and
the nodes B around it, which larger parts own:

    F = [F_II  F_IB]     the entries of A that come in with I, and the S of the part's two halves
        [F_BI  F_BB]
    W = F_II^{-1} F_IB
    S = F_BB - F_BI W    handed on to the part that this one is a half of

Then A x = b is solved by y_B -= W^T y_I from the smallest parts upwards, starting from y = b, and
x_I = F_II^{-1} y_I - W x_B downwards. Parts of one depth do not wait for each other: those of
similar size form a batch, are padded to one shape and worked on at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.sparse import csr_array

from esfem_core.dissection import Dissection

__all__ = ["BlockFactor", "Fronts"]

BATCH = 32  # parts that a batch has at least, where there are so many
BATCHES = 4  # batches that a depth has at most

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Batch(NamedTuple):
    """F fronts of one shape (m, m), each with m_I nodes of its own.

    Attributes
    ----------
    own : slice
        Slots of the nodes I, front by front.
    slots : (F, m) int array
        Slots of all the nodes, I before B.
    outer : (F (m - m_I),) int array
        Those of the nodes B alone.
    memory : slice
        Where the fronts stand in the memory of their depth.
    rows, columns : (F, m - m_I) int arrays
        Entry (i, j) of S belongs to rows[i] + columns[j] in the memory of the next smaller depth.
    """

    own: slice
    slots: Ints
    outer: Ints
    memory: slice
    rows: Ints
    columns: Ints


class Level(NamedTuple):
    """The fronts of one depth.

    Attributes
    ----------
    batches : list of Batch
    size : int
        Length of the memory for all fronts.
    entries, places : int arrays
        Entries of A that come in here, by their positions in its data, and where in the memory.
    padding : int array
        Where in the memory the diagonals of padded nodes I stand.
    """

    batches: list[Batch]
    size: int
    entries: Ints
    places: Ints
    padding: Ints


class _Layout:
    """Which nodes the parts of one depth have, and where their fronts stand in the memory.

    Attributes
    ----------
    part, node, local : int arrays
        Triples of a part, a node of it and the node's number in the part's front.
    inner : bool array
        Whether the part owns the node.
    groups : list of int arrays
        Parts that form a batch.
    owned, width, base : (parts,) int arrays
        m_I, m and the start of the front in the memory.
    """

    def __init__(self, tree: Dissection, cells: Ints, depth: int) -> None:
        self._n_nodes, self._outer = len(tree.node_depth), tree.node_depth < depth
        part = (tree.cell_part >> (tree.depth - depth)).repeat(cells.shape[1])
        node = cells.ravel()
        relevant = tree.node_depth[node] <= depth  # others have been eliminated in smaller parts
        self._keys = np.unique(self._key(part[relevant], node[relevant]))
        twice, self.node = np.divmod(self._keys, self._n_nodes)
        self.part, self.inner = twice // 2, twice % 2 == 0
        counts = np.bincount(twice, minlength=2 << depth)
        rank = np.arange(len(twice)) - (np.cumsum(counts) - counts)[twice]
        inner, outer = counts.reshape(-1, 2).T

        self.owned, self.width, self.base = np.empty((3, 1 << depth), dtype=np.int64)
        self.groups = np.array_split(
            np.argsort(inner + outer, kind="stable"), np.clip((1 << depth) // BATCH, 1, BATCHES)
        )
        self.size = 0
        for parts in self.groups:
            self.owned[parts] = inner[parts].max()
            self.width[parts] = m = inner[parts].max() + outer[parts].max()
            self.base[parts] = self.size + m * m * np.arange(len(parts))
            self.size += m * m * len(parts)
        self.local = np.where(self.inner, rank, rank + self.owned[self.part])

    def _key(self, part: Ints, node: Ints) -> Ints:
        """Numbers that sort by part, then inner nodes before outer ones."""
        return (2 * part + self._outer[node]) * self._n_nodes + node

    def find(self, part: Ints, node: Ints) -> Ints:
        """Numbers of nodes in the fronts of parts."""
        return self.local[np.searchsorted(self._keys, self._key(part, node))]


class Fronts:
    """The fronts of a mesh, for all matrices of one sparsity pattern; made once.

    Parameters
    ----------
    tree : Dissection
    cells : (T, n) int array
        Nodes of each element.
    pattern : (N, N) CSR array
        Nodes that it couples share an element.

    Attributes
    ----------
    slot : (N,) int array
        Place of each node in the padded order, in which all else is numbered.
    size : int
        Number of slots. Slot 0 stands for padded nodes B: zeros are read and written there.
    levels : list of Level
        Those of the tree, the whole mesh first.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> factor = space.fronts.factorise(M + A, dtype=np.float64)
    >>> b = space.nodes.prod(axis=1)
    >>> bool(np.allclose((M + A) @ factor.solve(b), b, rtol=0, atol=1e-14))
    True
    """

    def __init__(self, tree: Dissection, cells: Ints, pattern: csr_array) -> None:
        column = pattern.indices.astype(np.int64)
        row = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
        # An entry comes in where the first of its two nodes is eliminated.
        first = tree.node_depth[row] >= tree.node_depth[column]
        entry_depth = np.where(first, tree.node_depth[row], -1)
        self.slot = np.zeros(pattern.shape[0], dtype=np.int64)
        self.size = 1
        self.levels: list[Level] = []
        above = None
        for depth in range(tree.depth + 1):
            layout = _Layout(tree, cells, depth)
            entries = np.flatnonzero(entry_depth == depth)
            part = tree.node_part[row[entries]]
            i, j = (layout.find(part, nodes[entries]) for nodes in (row, column))
            places = layout.base[part] + i * layout.width[part] + j
            batches, padding = self._batches(layout, above)
            self.levels.append(Level(batches, layout.size, entries, places, padding))
            above = layout

    def _batches(self, layout: _Layout, above: _Layout | None) -> tuple[list[Batch], Ints]:
        """Batches of a depth, and its padding; gives the nodes it owns their slots."""
        offset, start = np.empty((2, len(layout.owned)), dtype=np.int64)
        total = 0
        for parts in layout.groups:
            count, n_own, m = len(parts), layout.owned[parts[0]], layout.width[parts[0]]
            start[parts] = self.size + n_own * np.arange(count)
            offset[parts] = total + m * np.arange(count)
            self.size += n_own * count
            total += m * count
        part, node, inner, outer = layout.part, layout.node, layout.inner, ~layout.inner
        self.slot[node[inner]] = start[part[inner]] + layout.local[inner]
        at = offset[part] + layout.local
        slots, rows, columns = np.zeros((3, total), dtype=np.int64)
        slots[at] = self.slot[node]
        if above is not None:
            whole = part[outer] // 2
            columns[at[outer]] = above.find(whole, node[outer])
            rows[at[outer]] = above.base[whole] + columns[at[outer]] * above.width[whole]
        used = np.zeros(total, dtype=bool)
        used[at] = True

        batches, padding = [], []
        for parts in layout.groups:
            first, n_own, m = parts[0], layout.owned[parts[0]], layout.width[parts[0]]
            shape = len(parts), m
            a, b = offset[first], offset[first] + len(parts) * m
            own = slice(start[first], start[first] + len(parts) * n_own)
            front_slots = slots[a:b].reshape(shape)
            front_slots[:, :n_own] = np.arange(own.start, own.stop).reshape(len(parts), n_own)
            front, i = np.nonzero(~used[a:b].reshape(shape)[:, :n_own])
            padding.append(layout.base[parts[front]] + i * (m + 1))
            batches.append(
                Batch(
                    own,
                    front_slots,
                    front_slots[:, n_own:].ravel(),
                    slice(layout.base[first], layout.base[first] + len(parts) * m * m),
                    rows[a:b].reshape(shape)[:, n_own:],
                    columns[a:b].reshape(shape)[:, n_own:],
                )
            )
        return batches, np.concatenate(padding)

    def factorise(self, A: csr_array, dtype: DTypeLike = np.float32) -> "BlockFactor":
        """Factorise a symmetric positive definite matrix of this pattern.

        Parameters
        ----------
        A : (N, N) CSR array
        dtype : float type
            In which the factor is kept. It is computed in double precision. Solving is bound by
            memory: single precision, enough for a preconditioner, takes half the time.

        Returns
        -------
        BlockFactor

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is singular or not finite.
        """
        scale = float(abs(A.data).max())
        if not 0 < scale < np.inf:
            raise np.linalg.LinAlgError(
                "the matrix of a linear system is singular or not finite: "
                f"its largest entry is {scale}"
            )
        blocks = []
        # What overflows here is no solution: whoever checks the residual will see it.
        with np.errstate(over="ignore", invalid="ignore"):
            memory = np.zeros(self.levels[-1].size)
            for level, size in self._upwards():
                memory[level.places] += A.data[level.entries] / scale
                memory[level.padding] = 1.0
                larger = np.zeros(size)
                for batch in level.batches:
                    blocks.append((batch, _eliminate(batch, memory, larger, dtype)))
                memory = larger
        return BlockFactor(self, scale, blocks)

    def _upwards(self) -> Iterator[tuple[Level, int]]:
        """Levels, smallest parts first, with the size of the memory of the next."""
        sizes = [0, *(level.size for level in self.levels)]
        return zip(reversed(self.levels), reversed(sizes[:-1]), strict=True)


def _eliminate(batch: Batch, memory: Array, larger: Array, dtype: DTypeLike) -> Array:
    """Eliminate the nodes I of a batch of fronts: return [F_II^{-1}  -W], and hand on S."""
    count, m = batch.slots.shape
    k = m - batch.rows.shape[1]
    F = memory[batch.memory].reshape(count, m, m)
    inverse = np.linalg.inv(F[:, :k, :k])
    W = inverse @ F[:, :k, k:]
    S = F[:, k:, k:] - F[:, :k, k:].swapaxes(1, 2) @ W
    np.add.at(larger, (batch.rows[:, :, None] + batch.columns[:, None]).ravel(), S.ravel())
    block = np.empty((count, k, m), dtype=dtype)
    block[:, :, :k] = inverse
    block[:, :, k:] = -W
    return block


class BlockFactor:
    """A factorised matrix; made by :meth:`Fronts.factorise`."""

    def __init__(self, fronts: Fronts, scale: float, blocks: list[tuple[Batch, Array]]) -> None:
        self._fronts, self._scale, self._blocks = fronts, scale, blocks

    def solve(self, b: Array) -> Array:
        """Solve for the columns of `b`.

        Parameters
        ----------
        b : (N,) or (N, m) float array

        Returns
        -------
        array like `b`
        """
        rows = b.reshape(len(b), -1).T
        # Whatever its size, a right-hand side is well within the range of single precision.
        size = abs(rows).max(axis=1, keepdims=True)
        size[size == 0] = 1.0
        y = np.zeros((len(rows), self._fronts.size), dtype=self._blocks[0][1].dtype)
        for y_row, row, factor in zip(y, rows, 1 / size, strict=True):
            y_row[self._fronts.slot] = factor * row
        for batch, block in self._blocks:
            _upwards(y, batch, block)
        for batch, block in reversed(self._blocks):
            _downwards(y, batch, block)
        x: Array = y.take(self._fronts.slot, axis=1) * (size / self._scale)
        return x.T.reshape(b.shape)


# In both, the blocks meet one right-hand side after the other: for so few of them a product with a
# vector is faster than one with a matrix, except on processors with AVX-512.


def _upwards(y: Array, batch: Batch, block: Array) -> None:
    """y_B -= W^T y_I."""
    count, k, _ = block.shape
    y_I = y[:, batch.own].reshape(len(y), count, k).swapaxes(0, 1)[..., None]
    change = (block[:, None, :, k:].swapaxes(2, 3) @ y_I).swapaxes(0, 1)
    for row, values in zip(y, change, strict=True):
        np.add.at(row, batch.outer, values.ravel())


def _downwards(y: Array, batch: Batch, block: Array) -> None:
    """x_I = F_II^{-1} y_I - W x_B."""
    count, k, _ = block.shape
    front = y.take(batch.slots, axis=1).swapaxes(0, 1)[..., None]
    x_I = block[:, None] @ front
    y[:, batch.own] = x_I.swapaxes(0, 1).reshape(len(y), count * k)
