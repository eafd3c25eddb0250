"""Sums of element entries into sparse matrices and nodal vectors, with patterns made once."""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, Ints
from esfem_core.solvers import pieces, side_by_side, times_rows

__all__ = ["NodalSum", "SparsePattern", "combination", "keep_freed_memory", "with_data"]

PIECE = 2**16  # entries of a matrix that are worked on at a time
MANY = 10**7  # entries of a matrix whose places take half the memory, at some cost
LEAST = 5 * 10**5  # entries of a matrix that several threads compute from those of two others


def keep_freed_memory() -> None:
    """Let the C library keep the memory of arrays up to 32 MiB for the arrays after them.

    glibc returns freed blocks above a threshold to the system, and every page of the next block
    costs up to 2 microseconds: half of an assembly at 16,386 nodes. The threshold follows the
    largest block freed so far, up to 32 MiB. Elsewhere this changes nothing.
    """
    np.empty(2**25 - 2**16, dtype=np.uint8)  # never written to, so it takes none; freed at once


def _sums(order: Ints, starts: Ints, ones: Array) -> csr_array:
    """Matrix whose row i adds up the entries order[starts[i]:starts[i + 1]] of a vector."""
    ends = np.r_[starts, len(order)].astype(np.int32)
    entries = ones[: len(order)], order.astype(np.int32), ends
    return csr_array(entries, shape=(len(starts), len(order)))


def _distinct(i: Ints, j: Ints, n: int) -> tuple[Ints, Ints, Ints]:
    """The distinct ones of pairs of numbers below n, sorted, and which of them each pair is.

    To transpose a sparse matrix sorts its entries, in a time that grows like their number.

    Examples
    --------
    >>> i, j = np.array([2, 0, 2]), np.array([1, 3, 1])
    >>> [numbers.tolist() for numbers in _distinct(i, j, 4)]
    [[0, 2], [3, 1], [1, 0, 1]]
    """

    def order_of(numbers: Ints) -> Ints:
        entries = np.ones(len(numbers), dtype=np.int8), numbers, np.arange(len(numbers) + 1)
        return csr_array(entries, shape=(len(numbers), n)).tocsc().indices.astype(np.int64)

    order = order_of(j)
    order = order[order_of(i[order])]
    starts = _first_of_each(i[order] * n + j[order])
    which = np.empty_like(i)
    which[order] = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(i)]))
    first = order[starts]
    return i[first], j[first], which


def _first_of_each(in_order: Ints) -> Ints:
    """Where another number begins in numbers that are sorted."""
    return np.flatnonzero(np.r_[True, in_order[1:] != in_order[:-1]][: len(in_order)])


class SparsePattern:
    """Where the element entries go in a symmetric (N, N) CSR matrix; made once per space.

    The entries of a chunk of elements are summed while they are in the cache. Those sums that no
    other chunk adds to stand together, chunk by chunk; the others follow at the end.

    Parameters
    ----------
    cells : (T, n) int array
    pairs : (2, P) int array
        Local index pairs a <= b.
    n_nodes : int
        N.
    slices : sequence of slice
        The chunks.

    Attributes
    ----------
    pattern : (N, N) CSR array
        Its data tell for each entry which of the sums it is.
    """

    def __init__(
        self,
        cells: Ints,
        pairs: Ints,
        n_nodes: int,
        slices: Sequence[slice],
    ) -> None:
        # The entries of the upper triangle, and which of them each element entry adds to.
        a, b = cells.T[pairs[0]], cells.T[pairs[1]]  # (P, T)
        rows, columns, sums = _distinct(np.minimum(a, b).ravel(), np.maximum(a, b).ravel(), n_nodes)
        counts = np.bincount(sums)
        sums = sums.reshape(a.shape)
        first, last = np.empty((2, len(rows)), dtype=np.int64)  # chunks that add to them
        for i, c in enumerate(slices):
            last[sums[:, c]] = i
        for i, c in reversed(list(enumerate(slices))):
            first[sums[:, c]] = i
        alone = first == last
        # Runs of sums with equally many terms: the processor predicts their loops.
        place = np.empty_like(first)
        place[np.lexsort((counts, np.where(alone, first, len(slices))))] = np.arange(len(rows))
        self._shared = int(np.count_nonzero(alone))  # places from here on are shared
        ones = np.ones(max(sums[:, c].size for c in slices))  # for all of them
        self._parts = [self._part(place[sums[:, c]], ones) for c in slices]

        off = rows != columns
        self.pattern = csr_array(
            (
                np.r_[place, place[off]],
                (np.r_[rows, columns[off]], np.r_[columns, rows[off]]),
            ),
            shape=(n_nodes, n_nodes),
        )
        self.pattern.sort_indices()
        self.pattern.has_canonical_format = True
        if len(self.pattern.data) > MANY:
            self.pattern.data = self.pattern.data.astype(np.int32)
        self.pattern.indices = self.pattern.indices.astype(np.int32)
        self.pattern.indptr = self.pattern.indptr.astype(np.int32)
        self._n_sums = len(rows)

    def _part(self, places: Ints, ones: Array) -> tuple[csr_array, slice, Ints]:
        """What sums the entries of a chunk, and the places of its own and of the shared sums."""
        order = np.argsort(places, axis=None, kind="stable")
        in_order = places.ravel()[order]
        starts = _first_of_each(in_order)
        used = in_order[starts]
        own, shared = np.split(used, [np.searchsorted(used, self._shared)])
        first = own[0] if len(own) else 0
        return _sums(order, starts, ones), slice(first, first + len(own)), shared.copy()

    def matrices(self, entries: Callable[[int], tuple[Array, ...]], count: int) -> list[csr_array]:
        """Sum the element entries of several matrices into CSR.

        Parameters
        ----------
        entries : callable
            From the number of a chunk to its entries, (P, C) for each matrix.
        count : int
            How many matrices.
        """
        sums = self._summed(entries, count)
        data = [np.empty(len(self.pattern.data)) for _ in sums]

        def place(part: tuple[int, slice]) -> None:
            i, piece = part
            where = self.pattern.data[piece].astype(np.intp, copy=False)
            sums[i].take(where, out=data[i][piece], mode="clip")  # other modes fill a copy first

        n = len(self.pattern.data)
        side_by_side(place, product(range(count), pieces(n, PIECE)), worth=n > LEAST)
        return [with_data(self.pattern, values) for values in data]

    def _summed(self, entries: Callable[[int], tuple[Array, ...]], count: int) -> list[Array]:
        """The sums of each matrix, in their places."""
        if len(self._parts) == 1:  # all sums are its own
            gather, _, _ = self._parts[0]
            return [
                gather @ values.ravel() for _, values in zip(range(count), entries(0), strict=True)
            ]
        sums = np.empty((count, self._n_sums))

        def sum_chunk(i: int) -> list[Array]:
            """Put the chunk's own sums in their places, and return what it adds to shared ones."""
            gather, own, _ = self._parts[i]
            n_own = own.stop - own.start
            to_shared = []
            for out, values in zip(sums, entries(i), strict=True):
                chunk_sums = gather @ values.ravel()
                out[own] = chunk_sums[:n_own]
                to_shared.append(chunk_sums[n_own:].copy())  # the rest stays in the cache
            return to_shared

        parts = side_by_side(sum_chunk, range(len(self._parts)))
        sums[:, self._shared :] = 0.0
        for (_, _, shared), to_shared in zip(self._parts, parts, strict=True):
            for out, values in zip(sums, to_shared, strict=True):
                out[shared] += values
        return list(sums)


def with_data(pattern: csr_array, data: Array) -> csr_array:
    """Return a matrix with the pattern of another, without the checks that making one costs."""
    matrix = object.__new__(type(pattern))  # what copy.copy does, in a tenth of its time
    vars(matrix).update(vars(pattern), data=data)
    return matrix


def combination(a: float, M: csr_array, b: float, A: csr_array) -> csr_array:
    """The matrix a M + b A of two matrices with the same sparsity pattern."""
    data = np.empty_like(M.data)
    if a == 1:
        a, M, b, A = b, A, a, M  # a sum of the same two numbers

    def combine(piece: slice) -> None:
        np.multiply(a, M.data[piece], out=data[piece])
        data[piece] += A.data[piece] if b == 1 else b * A.data[piece]

    side_by_side(combine, pieces(len(data), PIECE), worth=len(data) > LEAST)
    return with_data(M, data)


class NodalSum:
    """Sum of element vectors into nodal vectors; made once per space."""

    def __init__(self, cells: Ints, n_nodes: int) -> None:
        nodes = cells.T.ravel()
        order = np.argsort(nodes, kind="stable")
        counts = np.bincount(nodes, minlength=n_nodes)
        self._gather = _sums(order, np.cumsum(counts) - counts, np.ones(len(order)))

    def __call__(self, entries: Array) -> Array:
        """Sum m vectors of element entries, (m, n, T), into an (N, m) array."""
        rows = entries.reshape(len(entries), self._gather.shape[1])
        sums: Array = times_rows(self._gather, rows).T
        return np.ascontiguousarray(sums)
