r"""Dense fronts of a dissected mesh: which nodes each has, and where they stand in memory.

The nodes of a mesh are eliminated part by part, from the smallest parts of a dissection to the
whole. The front of a part is a dense matrix on the nodes I that the part owns and the nodes B
around it, which larger parts own. Parts of one depth do not wait for each other: those of similar
size form a batch, are padded to one shape and worked on at once. On large meshes the tree is cut
below its largest parts: what is left are subtrees that do not wait for each other either, and may
have threads of their own. All of that depends on the mesh alone;
:mod:`esfem_core.solvers.multifrontal` fills the fronts with numbers.

A small mesh shows what is remembered. Three triangles on five nodes lie in two parts, the first
triangle in part 0, the others in part 1::

      1-----3          part 0 owns node 0        (depth 1)
     / \   / \         part 1 owns nodes 3, 4    (depth 1)
    /   \ /   \        the whole owns 1, 2       (depth 0), which separate its parts
   0-----2-----4

>>> cells = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3]])
>>> tree = Dissection(
...     depth=1,
...     cell_part=np.array([0, 1, 1]),
...     node_depth=np.array([1, 0, 0, 1, 1]),
...     node_part=np.array([0, 0, 0, 1, 1]),
... )

First, which nodes each part of depth 1 has. Those it owns come before those around it:

>>> nodes = nodes_of_parts(tree, cells, depth=1)
>>> list(zip(nodes.part.tolist(), nodes.node.tolist(), strict=True))
[(0, 0), (0, 1), (0, 2), (1, 3), (1, 4), (1, 1), (1, 2)]
>>> nodes.outer.tolist()  # 1 and 2 are the nodes B of both parts
[False, True, True, False, False, True, True]
>>> nodes.counts.tolist()  # nodes I and B of each part
[[1, 2], [2, 2]]

Second, both parts are put into one batch and padded to its largest: 2 nodes I and 2 nodes B::

             part 0          part 1
    nodes    0 . | 1 2       3 4 | 1 2       the dot is a padded node
    row      0 1 | 2 3       0 1 | 2 3       of the front

>>> batches = batches_of_similar_size(nodes.counts)
>>> [parts.tolist() for parts in batches.parts], batches.padded.tolist()
([[0, 1]], [[2, 2], [2, 2]])

Third, places in memory: both fronts, of 4 x 4 entries each, stand one behind the other:

>>> places = places_in_memory(nodes, batches)
>>> places.row.tolist()  # of the front, for each of the pairs above
[0, 2, 3, 0, 1, 2, 3]
>>> places.own.tolist(), places.nodes.tolist(), places.front.tolist()
([0, 2], [0, 4], [0, 16])
>>> int(places.entry(part=1, i=2, j=3))  # what couples nodes 1 and 2 in the front of part 1
27

The fronts of all depths put that together. In the vectors of a solve the nodes stand in the order
of their fronts, padded nodes I included; slot 0 is that of all padded nodes B (here are none)::

    slot     0 | 1 2 | 3 4 | 5 6
    node       | 1 2 | 0 . | 3 4
               whole, part 0, part 1

>>> coupled = np.zeros((5, 5))
>>> for nodes_of_cell in cells:
...     coupled[np.ix_(nodes_of_cell, nodes_of_cell)] = 1.0
>>> fronts = Fronts(tree, cells, csr_array(coupled))
>>> fronts
Fronts(nodes=5, levels=2, fronts=3, largest front=4 x 4, entries of a factor per node=4.0)
>>> fronts.slot.tolist(), fronts.node.tolist()
([3, 1, 2, 5, 6], [5, 1, 2, 0, 5, 3, 4])
>>> level = fronts.levels[1]
>>> batch = level.batches[0]
>>> batch.own, batch.slots.tolist()  # slots of the nodes I, and of all
(slice(3, 7, None), [[3, 4, 1, 2], [5, 6, 1, 2]])
>>> level.padding.tolist()  # the dot's diagonal entry, set to 1: its front stays regular
[5]

Of the 19 entries of the matrix, the 4 of nodes 1 and 2 come in at depth 0 and the 10 in the rows
of nodes 0, 3 and 4 at depth 1; the other 5 mirror some of those and are not needed:

>>> [len(level.entries) for level in fronts.levels]
[4, 10]

What is left of a front when its nodes I are eliminated is a matrix S on its nodes 1 and 2. They are
rows and columns 0 and 1 of the front of the whole, where the S of both parts are added up:

>>> batch.rows.tolist(), batch.above.tolist()  # of the front number 0 of the next smaller depth
([[0, 1], [0, 1]], [0, 0])
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Bools, Ints
from esfem_core.solvers.dissection import Dissection
from esfem_core.solvers.systems import square

__all__ = [
    "Batch",
    "Batching",
    "Fronts",
    "Level",
    "PartNodes",
    "Places",
    "batches_of_similar_size",
    "nodes_of_parts",
    "places_in_memory",
]

BATCH = 32  # parts that a batch has at least, where there are so many
BATCHES = 4  # batches that a depth has at most
SMALL = 9  # depth of a tree that is not cut
MOST_CUT = 2  # depth at which a tree is cut at most, into 4 subtrees


class Batch(NamedTuple):
    """F fronts of one shape (m, m), each with m_I nodes of its own.

    Attributes
    ----------
    subtree : int
        Its number.
    own : slice
        Slots of the nodes I, front by front.
    slots : (F, m) int array
        Slots of the nodes I and B.
    outer : (F, m - m_I) int array
        Those of the nodes B once more, in one piece.
    number, place : int
        Of the first front among those of its depth, and where it stands in their memory.
    above : (F,) int array
        The fronts of the next smaller depth that take up what is left of these.
    rows : (F, m - m_I) int array
        Rows, and columns, of those fronts that the nodes B are.
    """

    subtree: int
    own: slice
    slots: Ints
    outer: Ints
    number: int
    place: int
    above: Ints
    rows: Ints

    @property
    def shape(self) -> tuple[int, int, int]:
        """F, m_I and m."""
        count, m = self.slots.shape
        return count, m - self.outer.shape[1], m


class Level(NamedTuple):
    """The fronts of one depth.

    Attributes
    ----------
    batches : list of Batch
    entries, places : int arrays
        Entries of A that come in here, by their positions in its data, and where in the memory,
        in increasing order.
    padding : int array
        Where in the memory the diagonals of padded nodes I stand, in increasing order.
    """

    batches: list[Batch]
    entries: Ints
    places: Ints
    padding: Ints


class PartNodes(NamedTuple):
    """The nodes of all parts of one depth: pairs of a part and a node.

    Attributes
    ----------
    part, node : (n,) int arrays
        The pairs, sorted by part, and in each part I before B.
    outer : (n,) bool array
        Whether the node is one of B, owned by a larger part.
    rank : (n,) int array
        Number of the node among I or among B of its part.
    counts : (P, 2) int array
        How many nodes I and nodes B each part has.
    keys : (n,) int array
        Numbers in increasing order that stand for the pairs, see :meth:`find`.
    in_larger : (N,) bool array
        Whether a node of the mesh is owned by a part of a smaller depth.
    """

    part: Ints
    node: Ints
    outer: Bools
    rank: Ints
    counts: Ints
    keys: Ints
    in_larger: Bools

    def find(self, part: Ints, node: Ints) -> Ints:
        """Numbers of pairs: ``self.part[n], self.node[n]`` are `part` and `node`."""
        return np.searchsorted(self.keys, _keys(self.in_larger, part, node))


class Batching(NamedTuple):
    """The batches of one depth.

    Attributes
    ----------
    parts : list of int arrays
        Parts of each batch; those of the first subtree come first, and so on.
    padded : (P, 2) int array
        m_I and m_B of each part: the largest numbers of nodes I and nodes B in its batch.
    """

    parts: list[Ints]
    padded: Ints


class Places(NamedTuple):
    """Where the fronts of one depth and their nodes stand, one behind the other.

    Attributes
    ----------
    row : (n,) int array
        Row of each of the pairs in the front of its part.
    width : (P,) int array
        m, the number of rows of each front.
    number, own, nodes, front : (P,) int arrays
        How many fronts, nodes I, nodes and entries of fronts stand before those of each part,
        padded ones included.
    """

    row: Ints
    width: Ints
    number: Ints
    own: Ints
    nodes: Ints
    front: Ints

    def entry(self, part: Ints, i: Ints, j: Ints) -> Ints:
        """Where entry (i, j) of the front of a part stands in the memory."""
        return self.front[part] + i * self.width[part] + j


def nodes_of_parts(tree: Dissection, cells: Ints, depth: int) -> PartNodes:
    """Nodes that are left in the parts of a depth when all smaller parts have been eliminated.

    Parameters
    ----------
    tree : Dissection
    cells : (T, n) int array
        Nodes of each element.
    depth : int
        That of the P = 2^depth parts.

    Returns
    -------
    PartNodes
    """
    in_larger = tree.node_depth < depth
    # The first digits of the number of a smallest part are that of the part of this depth.
    part = (tree.cell_part >> (tree.depth - depth)).repeat(cells.shape[1])
    node = cells.ravel()
    left = tree.node_depth[node] <= depth
    keys = np.sort(_keys(in_larger, part[left], node[left]))
    keys = keys[np.diff(keys, prepend=-1) > 0]  # elements share nodes
    part_and_side, node = np.divmod(keys, len(in_larger))
    part, side = np.divmod(part_and_side, 2)
    counts = np.bincount(part_and_side, minlength=2 << depth)
    first = np.cumsum(counts) - counts
    rank = np.arange(len(keys)) - first[part_and_side]
    return PartNodes(part, node, side == 1, rank, counts.reshape(-1, 2), keys, in_larger)


def _keys(in_larger: Bools, part: Ints, node: Ints) -> Ints:
    """Numbers of pairs that sort by part, then side (0 for I, 1 for B), then node."""
    part_and_side = 2 * part + in_larger[node]
    return part_and_side * len(in_larger) + node


def batches_of_similar_size(counts: Ints, subtrees: int = 1) -> Batching:
    """Divide the parts of a depth into batches.

    Parameters
    ----------
    counts : (P, 2) int array
        Numbers of nodes I and B of each part.
    subtrees : int
        Number of subtrees that the parts, equally many, belong to: no batch has parts of two.

    Returns
    -------
    Batching
        Of at most 4 batches for each subtree, and of one alone if they had less than 32 parts, or
        64 where there are several subtrees.
    """
    size = counts.sum(axis=1)
    batches = []
    for parts in np.arange(len(counts)).reshape(subtrees, -1):
        number = np.clip(len(parts) // (BATCH * min(subtrees, 2)), 1, BATCHES)
        by_size = parts[np.argsort(size[parts], kind="stable")]
        batches += np.array_split(by_size, number)
    padded = np.empty_like(counts)
    for parts in batches:
        padded[parts] = counts[parts].max(axis=0)
    return Batching(batches, padded)


def places_in_memory(nodes: PartNodes, batches: Batching) -> Places:
    """Let the fronts of a depth stand one behind the other, batch by batch.

    Parameters
    ----------
    nodes : PartNodes
    batches : Batching
        Of those parts.

    Returns
    -------
    Places
    """
    order = np.concatenate(batches.parts)
    m_I, width = batches.padded[:, 0], batches.padded.sum(axis=1)
    # The nodes B of a front come after all its nodes I, padded ones included.
    row = np.where(nodes.outer, m_I[nodes.part] + nodes.rank, nodes.rank)
    sizes = np.ones_like(width), m_I, width, width**2
    return Places(row, width, *(_before(size, order) for size in sizes))


def _before(sizes: Ints, order: Ints) -> Ints:
    """Total size of all that stands before each part when the parts stand in an order."""
    before = np.empty_like(sizes)
    before[order] = np.cumsum(sizes[order]) - sizes[order]
    return before


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
    node : (size,) int array
        The other way round: the node of each slot, N for slots of none.
    size : int
        Number of slots. Slot 0 stands for padded nodes B: zeros are read and written there.
    subtrees : int
        How many there are.
    shared : int
        Number of slots that all subtrees write to: slot 0 and the nodes of larger parts. They are
        the first ones, and after them each subtree but the first has a copy of its own of all.
    levels : list of Level
        Those of the tree, the whole mesh first.

    Raises
    ------
    TypeError
        If the pattern is not in CSR format.
    ValueError
        If it has not as many rows and columns as the tree has nodes.

    Examples
    --------
    >>> import esfem_core as ec
    >>> ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere).fronts
    Fronts(nodes=1026, levels=5, fronts=31, largest front=95 x 95,
        entries of a factor per node=81.4)
    """

    def __init__(self, tree: Dissection, cells: Ints, pattern: csr_array) -> None:
        n = square(pattern)
        if n != len(tree.node_depth):
            raise ValueError(
                f"pattern must have a row for each of the {len(tree.node_depth)} nodes of the "
                f"tree, got shape {pattern.shape}"
            )
        node_j = pattern.indices.astype(np.int64)
        node_i = np.repeat(np.arange(n), np.diff(pattern.indptr))
        # An entry comes in where the first of its two nodes is eliminated, in the row of that node.
        # Its mirror image is not needed: elimination does not read F_BI.
        first = tree.node_depth[node_i] >= tree.node_depth[node_j]
        entry_depth = np.where(first, tree.node_depth[node_i], -1)
        self.n_entries, self.pattern = len(node_j), pattern
        cut = int(np.clip(tree.depth - SMALL, 0, MOST_CUT))  # depth of the subtrees' largest parts
        self.subtrees, self.shared = 2**cut, 0
        self.slot = np.zeros(n, dtype=np.int64)
        self.size = 1
        self.levels: list[Level] = []
        above = None
        for depth in range(tree.depth + 1):
            if depth == cut:
                self.shared = self.size
                self.size *= self.subtrees
            nodes = nodes_of_parts(tree, cells, depth)
            subtrees = self.subtrees if depth >= cut else 1
            batches = batches_of_similar_size(nodes.counts, subtrees)
            places = places_in_memory(nodes, batches)

            own = ~nodes.outer
            first_slot = self.size + places.own
            self.slot[nodes.node[own]] = first_slot[nodes.part[own]] + places.row[own]
            self.size += int(batches.padded[:, 0].sum())

            entries = np.flatnonzero(entry_depth == depth)
            part = tree.node_part[node_i[entries]]
            i, j = (places.row[nodes.find(part, node[entries])] for node in (node_i, node_j))
            place = places.entry(part, i, j)
            order = np.argsort(place, kind="stable")
            shared = self.shared if subtrees > 1 else 0
            level = Level(
                _batches(nodes, batches, places, self.slot, first_slot, above, subtrees, shared),
                _compact(entries[order]),
                _compact(place[order]),
                _padding(nodes, batches, places),
            )
            self.levels.append(level)
            above = nodes, places
        self.node = np.full(self.size, n)
        self.node[self.slot] = np.arange(n)

    @property
    def top(self) -> list[Level]:
        """The levels of the parts that are larger than the subtrees."""
        return self.levels[: self.subtrees.bit_length() - 1]

    def below(self, subtree: int) -> list[Level]:
        """The levels of a subtree."""
        return [
            level._replace(batches=[b for b in level.batches if b.subtree == subtree])
            for level in self.levels[len(self.top) :]
        ]

    @property
    def n_stored(self) -> int:
        """Number of entries that a factor stores: the rows of the nodes I of all fronts."""
        batches = [batch for level in self.levels for batch in level.batches]
        return sum(count * m_I * m for count, m_I, m in (batch.shape for batch in batches))

    @property
    def largest(self) -> int:
        """Rows of the largest front."""
        return max(batch.shape[2] for level in self.levels for batch in level.batches)

    def __repr__(self) -> str:
        fronts = sum(batch.shape[0] for level in self.levels for batch in level.batches)
        return (
            f"Fronts(nodes={len(self.slot)}, levels={len(self.levels)}, fronts={fronts}, largest "
            f"front={self.largest} x {self.largest}, entries of a factor per node="
            f"{self.n_stored / len(self.slot):.1f})"
        )


def _batches(
    nodes: PartNodes,
    batches: Batching,
    places: Places,
    slot: Ints,
    first_slot: Ints,
    above: tuple[PartNodes, Places] | None,
    subtrees: int,
    shared: int,
) -> list[Batch]:
    """Batches of a depth; `above` are nodes and places of the next smaller depth."""
    # Slots, and rows in larger fronts, of all nodes of all fronts. Padded nodes keep the zeros: S
    # is zero in their rows and columns, and slot 0 is theirs.
    at = places.nodes[nodes.part] + places.row
    slots, rows = (np.zeros(int(places.width.sum()), dtype=np.int64) for _ in range(2))
    slots[at] = slot[nodes.node]
    number = np.zeros(len(batches.padded), dtype=np.int64)
    if above is not None:
        # All nodes B of part q are nodes of part q // 2, of which q is a half.
        larger_nodes, larger = above
        whole = nodes.part[nodes.outer] // 2
        rows[at[nodes.outer]] = larger.row[larger_nodes.find(whole, nodes.node[nodes.outer])]
        number = larger.number[np.arange(len(number)) // 2]

    found = []
    for parts in batches.parts:
        q, count = parts[0], len(parts)
        m_I, m = int(batches.padded[q, 0]), int(places.width[q])
        own = _stretch(first_slot[q], count * m_I)
        flat = _stretch(places.nodes[q], count * m)
        of_fronts = slots[flat].reshape(count, m)
        subtree = int(q) * subtrees // len(batches.padded)
        of_fronts[of_fronts < shared] += subtree * shared
        of_fronts[:, :m_I] = np.arange(own.start, own.stop).reshape(count, m_I)
        found.append(
            Batch(
                subtree,
                own,
                of_fronts,
                of_fronts[:, m_I:].copy(),
                int(places.number[q]),
                int(places.front[q]),
                number[parts],
                _compact(rows[flat].reshape(count, m)[:, m_I:]),
            )
        )
    return found


def _padding(nodes: PartNodes, batches: Batching, places: Places) -> Ints:
    """Where the diagonals of padded nodes I stand: rows from the part's own number up to m_I."""
    padding = []
    for parts in batches.parts:
        row = np.arange(batches.padded[parts[0], 0])
        front, i = np.nonzero(row >= nodes.counts[parts, :1])
        padding.append(places.entry(parts[front], i, i))
    return np.concatenate(padding)


def _compact(numbers: Ints) -> Ints:
    """In half the memory, if they are small enough for that."""
    return numbers.astype(np.int32 if numbers.max(initial=0) < 2**31 else np.int64)


def _stretch(start: int, length: int) -> slice:
    return slice(int(start), int(start) + length)
