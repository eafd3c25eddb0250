"""Element integrals over Γ_h[x], for all elements at once.

An element is the image of the reference triangle under Phi(xi, eta) = sum_a x_a phi_a(xi, eta).
With its tangents t1 = d Phi/d xi, t2 = d Phi/d eta and the metric E = t1.t1, F = t1.t2, G = t2.t2,
s = sqrt(EG - F^2) is the area density, and for functions on the element

    grad u . grad w = (G u1 w1 - F (u1 w2 + u2 w1) + E u2 w2) / s^2,      u1 = d u/d xi, ...

This is [N] 7.2 with the third column of its 3 x 3 differential, the normal, eliminated. Each
integral is then (products of basis functions at the quadrature points) @ (metric factors), one
small matrix product for many elements. Arrays here have the elements last.
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.lagrange import Basis
from esfem_core.quadrature import TriangleRule

__all__ = ["DegenerateElementError", "ElementTables", "SparsePattern"]

CHUNK = 12288  # points at which the metric is computed at a time: their arrays stay in the cache
FLATNESS = 1e-8  # smallest allowed 2 s/(E + G), which is 1 for a conformal element map
ROUNDING = 1e-14  # tangents shorter than this share of the coordinates are rounding errors

Array = NDArray[np.float64]


class DegenerateElementError(ArithmeticError):
    """An element has lost its area, or a nodal position is not finite.

    Attributes
    ----------
    element : int
        Row of ``space.cells``.
    """

    def __init__(self, message: str, element: int) -> None:
        super().__init__(message)
        self.element = element


class Metric(NamedTuple):
    """Nodes of some elements, and tangents and metric at their quadrature points.

    Flat elements have Q = 1 here, whatever the number of quadrature points.
    """

    nodes: Array  # (3, n, C)
    t1: Array  # (3, Q, C)
    t2: Array  # (3, Q, C)
    E: Array  # (Q, C)
    F: Array
    G: Array
    s: Array  # area density
    inverse: Array  # 1/s

    def normals(self) -> Array:
        """Unit normals, (3, Q, C)."""
        n = np.empty_like(self.t1)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(self.t1[j], self.t2[k], out=n[i])
            n[i] -= self.t1[k] * self.t2[j]
        n *= self.inverse
        return n


class ElementTables:
    """Basis functions, their derivatives and their products, tabulated once.

    Parameters
    ----------
    basis : Basis
        At the points of `rule`.
    rule : TriangleRule
    """

    def __init__(self, basis: Basis, rule: TriangleRule) -> None:
        phi, (d1, d2) = basis.values, basis.derivatives
        w = rule.weights
        a, b = np.triu_indices(phi.shape[1])
        self.values = phi
        self.tests = np.ascontiguousarray((phi * w[:, None]).T)  # (n, Q)
        self.pairs = np.stack([a, b])  # local index pairs a <= b of the symmetric half
        mass = (phi[:, a] * phi[:, b]).T * w  # (P, Q)
        cross = -(d1[:, a] * d2[:, b] + d2[:, a] * d1[:, b])
        stiffness = [c.T * w for c in (d1[:, a] * d1[:, b], cross, d2[:, a] * d2[:, b])]
        if phi.shape[1] == 3:
            # A flat element has one metric: one point stands for all.
            d1, d2, mass = d1[:1], d2[:1], mass.sum(axis=1, keepdims=True)
            stiffness = [c.sum(axis=1, keepdims=True) for c in stiffness]
        self.gradients = np.vstack([d1, d2])  # (2Q, n)
        self.mass = np.ascontiguousarray(mass)
        self.stiffness = np.hstack(stiffness)  # (P, 3Q), for the factors G/s, F/s, E/s

    def metric(self, nodes: Array, first: int = 0) -> Metric:
        """Metric of elements with the given node positions.

        Parameters
        ----------
        nodes : (3, n, C) float array
        first : int
            Number of the first of these elements, for error messages.

        Raises
        ------
        DegenerateElementError
        """
        t1, t2 = np.split(self.gradients @ nodes, 2, axis=1)
        # A degenerate or overflowing element is recognised and reported below.
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            E, F, G = _dot(t1, t1), _dot(t1, t2), _dot(t2, t2)
            s2 = E * G - F * F
            smallest = (ROUNDING * np.abs(nodes[:, 0]).max()) ** 2
            # One comparison for all; where it fails, element by element.
            if not s2.min() > (FLATNESS / 2 * (E.max() + G.max()) + smallest) ** 2:
                sound = s2 > (FLATNESS / 2 * (E + G) + smallest) ** 2
                _report_first(~np.isfinite(s2), "is not finite", nodes, first)
                _report_first(~sound, "is degenerate", nodes, first)
            s = np.sqrt(s2)
            return Metric(nodes, t1, t2, E, F, G, s, 1 / s)

    def mass_stiffness(self, g: Metric) -> tuple[Array, Array]:
        """Element mass and stiffness entries of the index pairs a <= b, each (P, C)."""
        factors = np.empty((3, *g.s.shape))
        for factor, entry in zip(factors, (g.G, g.F, g.E), strict=True):
            np.multiply(entry, g.inverse, out=factor)
        return self.mass @ g.s, self.stiffness @ factors.reshape(-1, g.s.shape[1])

    def gradient(self, g: Metric, u: Array) -> Array:
        """Surface gradient (m, 3, Q, C) of the nodal values u (m, n, C)."""
        u1, u2 = np.split(self.gradients @ u, 2, axis=1)
        square = g.inverse * g.inverse
        c1, c2 = (g.G * u1 - g.F * u2) * square, (g.E * u2 - g.F * u1) * square
        gradient: Array = c1[:, None] * g.t1
        gradient += c2[:, None] * g.t2
        return gradient


def _dot(a: Array, b: Array) -> Array:
    out: Array = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out


def _report_first(bad: NDArray[np.bool_], what: str, nodes: Array, first: int) -> None:
    """Raise for the first element with a bad quadrature point."""
    if bad.any():
        element = int(np.argmax(bad.any(axis=0)))
        center = np.array2string(nodes[:, :3, element].mean(axis=1), precision=4)
        raise DegenerateElementError(
            f"element {first + element} near {center} {what}", first + element
        )


def chunks(n_cells: int, n_points: int) -> Iterator[slice]:
    """Consecutive slices of elements with n_points points each."""
    length = max(CHUNK // n_points, 1)
    return (slice(i, min(i + length, n_cells)) for i in range(0, n_cells, length))


def _sums(order: NDArray[np.int64], starts: NDArray[np.int64]) -> csr_array:
    """Matrix whose row i adds up the entries order[starts[i]:starts[i + 1]] of a vector."""
    ends = np.r_[starts, len(order)].astype(np.int32)
    ones = np.ones(len(order))
    return csr_array((ones, order.astype(np.int32), ends), shape=(len(starts), len(order)))


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
        cells: NDArray[np.int64],
        pairs: NDArray[np.int64],
        n_nodes: int,
        slices: Sequence[slice],
    ) -> None:
        # The entries of the upper triangle, and which of them each element entry adds to.
        a, b = cells.T[pairs[0]], cells.T[pairs[1]]  # (P, T)
        keys, inverse, counts = np.unique(
            np.minimum(a, b) * n_nodes + np.maximum(a, b), return_inverse=True, return_counts=True
        )
        sums = inverse.reshape(a.shape)
        first, last = np.empty((2, len(keys)), dtype=np.int64)  # chunks that add to them
        for i, c in enumerate(slices):
            last[sums[:, c]] = i
        for i, c in reversed(list(enumerate(slices))):
            first[sums[:, c]] = i
        alone = first == last
        # Sums of equally many terms in a row spare the processor wrong guesses.
        place = np.argsort(np.lexsort((counts, np.where(alone, first, len(slices)))))
        self._shared = int(np.count_nonzero(alone))  # places from here on are shared
        self._parts = [self._part(place[sums[:, c]]) for c in slices]

        rows, columns = np.divmod(keys, n_nodes)
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
        self.pattern.indices = self.pattern.indices.astype(np.int32)
        self.pattern.indptr = self.pattern.indptr.astype(np.int32)
        self._n_sums = len(keys)

    def _part(self, places: NDArray[np.int64]) -> tuple[csr_array, slice, NDArray[np.int64]]:
        """What sums the entries of a chunk, and the places of its own and of the shared sums."""
        order = np.argsort(places, axis=None, kind="stable")
        used, starts = np.unique(places.ravel()[order], return_index=True)
        own, shared = np.split(used, [np.searchsorted(used, self._shared)])
        first = own[0] if len(own) else 0
        return _sums(order, starts), slice(first, first + len(own)), shared

    def matrices(self, chunks: Iterable[tuple[Array, Array]]) -> tuple[csr_array, csr_array]:
        """Sum the element entries of two matrices, (P, C) each for every chunk, into CSR."""
        sums = np.empty((2, self._n_sums))
        sums[:, self._shared :] = 0.0
        for (gather, own, shared), entries in zip(self._parts, chunks, strict=True):
            n_own = own.stop - own.start
            for out, values in zip(sums, entries, strict=True):
                chunk_sums = gather @ values.ravel()
                out[own] = chunk_sums[:n_own]
                out[shared] += chunk_sums[n_own:]
        M, A = (with_data(self.pattern, out.take(self.pattern.data)) for out in sums)
        return M, A


def with_data(pattern: csr_array, data: Array) -> csr_array:
    """Return a matrix with the pattern of another, without the checks that making one costs."""
    matrix = copy(pattern)
    matrix.data = data
    return matrix


class NodalSum:
    """Sum of element vectors (m, n, T) into nodal vectors (N, m); made once per space."""

    def __init__(self, cells: NDArray[np.int64], n_nodes: int) -> None:
        nodes = cells.T.ravel()
        order = np.argsort(nodes, kind="stable")
        counts = np.bincount(nodes, minlength=n_nodes)
        self._gather = _sums(order, np.cumsum(counts) - counts)

    def __call__(self, entries: Array) -> Array:
        return np.column_stack([self._gather @ entry.ravel() for entry in entries])
