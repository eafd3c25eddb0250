"""Dense fronts of a dissected mesh: which nodes each has, and where they stand in memory.

The nodes of a mesh are eliminated part by part, from the smallest parts of a dissection to the
whole. The front of a part is a dense matrix on the nodes I that the part owns and the nodes B
around it, which larger parts own. Parts of one depth do not wait for each other: those of similar
size form a batch, are padded to one shape and worked on at once. All of that depends on the mesh
alone; :mod:`esfem_core.solvers.multifrontal` fills the fronts with numbers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.solvers.dissection import Dissection

__all__ = ["Batch", "Fronts", "Level"]

BATCH = 32  # parts that a batch has at least, where there are so many
BATCHES = 4  # batches that a depth has at most

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
    owned, width : (parts,) int arrays
        m_I and m of each front.
    start, offset, base : (parts,) int arrays
        Where its nodes I, all its nodes and the front itself begin among those of this depth.
    totals : (int, int, int)
        How many nodes I, nodes and entries of fronts there are, padded ones included.
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

        self.groups = np.array_split(
            np.argsort(inner + outer, kind="stable"), np.clip((1 << depth) // BATCH, 1, BATCHES)
        )
        numbers = np.empty((5, 1 << depth), dtype=np.int64)
        self.owned, self.width, self.start, self.offset, self.base = numbers
        totals = np.zeros((3, 1), dtype=np.int64)
        for parts in self.groups:
            m_I, m = inner[parts].max(), inner[parts].max() + outer[parts].max()
            sizes = np.array([[m_I], [m], [m * m]])
            numbers[:2, parts] = sizes[:2]
            numbers[2:, parts] = totals + sizes * np.arange(len(parts))
            totals += sizes * len(parts)
        self.totals = tuple(totals[:, 0].tolist())
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
    n_entries : int
        Of the pattern.
    slot : (N,) int array
        Place of each node in the padded order, in which all else is numbered.
    size : int
        Number of slots. Slot 0 stands for padded nodes B: zeros are read and written there.
    levels : list of Level
        Those of the tree, the whole mesh first.
    """

    def __init__(self, tree: Dissection, cells: Ints, pattern: csr_array) -> None:
        column = pattern.indices.astype(np.int64)
        row = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
        # An entry comes in where the first of its two nodes is eliminated.
        first = tree.node_depth[row] >= tree.node_depth[column]
        entry_depth = np.where(first, tree.node_depth[row], -1)
        self.n_entries = len(column)
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
            self.levels.append(Level(batches, layout.totals[2], entries, places, padding))
            self.size += layout.totals[0]
            above = layout

    def _batches(self, layout: _Layout, above: _Layout | None) -> tuple[list[Batch], Ints]:
        """Batches of a depth, and its padding; gives the nodes it owns their slots."""
        part, node, inner, outer = layout.part, layout.node, layout.inner, ~layout.inner
        self.slot[node[inner]] = self.size + layout.start[part[inner]] + layout.local[inner]
        at = layout.offset[part] + layout.local
        slots, rows, columns = np.zeros((3, layout.totals[1]), dtype=np.int64)
        slots[at] = self.slot[node]
        if above is not None:
            whole = part[outer] // 2
            columns[at[outer]] = above.find(whole, node[outer])
            rows[at[outer]] = above.base[whole] + columns[at[outer]] * above.width[whole]
        padded = np.ones(layout.totals[1], dtype=bool)
        padded[at] = False

        batches, padding = [], []
        for parts in layout.groups:
            first, count = parts[0], len(parts)
            m_I, m = layout.owned[first], layout.width[first]
            own = slice(
                self.size + layout.start[first], self.size + layout.start[first] + count * m_I
            )
            flat = slice(layout.offset[first], layout.offset[first] + count * m)
            memory = slice(layout.base[first], layout.base[first] + count * m * m)
            front_slots = slots[flat].reshape(count, m)
            front_slots[:, :m_I] = np.arange(own.start, own.stop).reshape(count, m_I)
            batches.append(
                Batch(
                    own,
                    front_slots,
                    front_slots[:, m_I:].ravel(),
                    memory,
                    rows[flat].reshape(count, m)[:, m_I:],
                    columns[flat].reshape(count, m)[:, m_I:],
                )
            )
            front, i = np.nonzero(padded[flat].reshape(count, m)[:, :m_I])
            padding.append(layout.base[parts[front]] + i * (m + 1))
        return batches, np.concatenate(padding)
