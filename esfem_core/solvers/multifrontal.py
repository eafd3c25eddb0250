"""Sparse factorisations made of small dense matrices, in NumPy (Duff and Reid, 1983).

The front of a part of a dissected mesh, a dense symmetric matrix on the nodes I that the part owns
and the nodes B around it, is::

    F = [F_II  F_IB]     the entries of A that come in with I, and the S of the part's two halves
        [F_BI  F_BB]
    W = F_II^{-1} F_IB
    S = F_BB - F_BI W    handed on to the part that this one is a half of

Then A x = b is solved by y_B -= W^T y_I from the smallest parts upwards, starting from y = b, and
x_I = F_II^{-1} y_I - W x_B downwards.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import DTypeLike
from scipy.sparse import csr_array

from esfem_core.checks import Array, object_of, shown
from esfem_core.solvers.fronts import Batch, Fronts
from esfem_core.solvers.systems import right_hand_side, square

__all__ = ["BlockFactor", "factorise"]

PRECISIONS = (np.dtype(np.float32), np.dtype(np.float64))


def factorise(A: csr_array, fronts: Fronts, dtype: DTypeLike | None = None) -> "BlockFactor":
    """Factorise a symmetric positive definite matrix.

    The factor is computed in double precision. Solving with it is bound by memory: kept in single
    precision, enough for a preconditioner of all but nearly singular matrices, it takes half the
    time.

    Parameters
    ----------
    A : (N, N) CSR array
        Of the pattern that the fronts were made for.
    fronts : Fronts
        Of a mesh, for example :attr:`esfem_core.SurfaceSpace.fronts`.
    dtype : float32 or float64, optional
        In which the factor is kept. Default: single precision, unless that leaves a residual as
        large as the right-hand side where the solution is constant; then double.

    Returns
    -------
    BlockFactor

    Raises
    ------
    TypeError
        If the matrix is not in CSR format.
    ValueError
        If it is not square or its pattern differs from that of the fronts, or if `dtype` is
        another one.
    numpy.linalg.LinAlgError
        If the matrix is singular or not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> factor = factorise(M + A, space.fronts, dtype=np.float64)
    >>> factor
    BlockFactor(unknowns=1026, levels=5, entries per unknown=81.4, memory=0.7 MB, dtype=float64)
    >>> b = space.nodes.prod(axis=1)
    >>> bool(np.allclose((M + A) @ factor.solve(b), b, rtol=0, atol=1e-14))
    True
    """
    n = len(object_of("fronts", fronts, Fronts).slot)
    if square(A) != n or len(A.data) != fronts.n_entries:
        raise ValueError(
            f"A must have the pattern that the fronts were made for, shape {(n, n)} with "
            f"{fronts.n_entries} entries; got shape {A.shape} with {len(A.data)}"
        )
    if dtype is not None:
        return _factorise(A, fronts, _precision(dtype))
    single = _factorise(A, fronts, np.dtype(np.float32))
    return single if _useful(single, A) else _factorise(A, fronts, np.dtype(np.float64))


def _precision(dtype: DTypeLike) -> np.dtype:
    """One of the dtypes that a factor can be kept in."""
    with suppress(TypeError):  # names of no dtype
        found = np.dtype(dtype)
        if found in PRECISIONS:
            return found
    raise ValueError(f"dtype must be float32, float64 or None, got {shown(dtype)}")


def _useful(factor: "BlockFactor", A: csr_array) -> bool:
    """Whether a solution has a smaller residual than zero has."""
    # A single-precision solution has rough rounding errors of relative size 1e-7, which A
    # multiplies by its largest eigenvalues, and constants, as a rule, by its smallest.
    b = A @ np.ones(A.shape[0])
    return bool(np.linalg.norm(b - A @ factor.solve(b)) < np.linalg.norm(b))


def _factorise(A: csr_array, fronts: Fronts, dtype: np.dtype) -> "BlockFactor":
    """Eliminate all nodes, from the smallest parts to the whole."""
    scale = float(abs(A.data).max())
    if not 0 < scale < np.inf:
        raise np.linalg.LinAlgError(
            "the matrix of a linear system must be positive definite and finite, but its largest "
            f"entry is {scale}"
        )
    blocks = []
    # Where a depth hands S on: the memory of the next smaller one. The whole hands on nothing.
    sizes_above = [0, *(level.size for level in fronts.levels[:-1])]
    # What overflows here is no solution: whoever checks the residual will see it.
    with np.errstate(over="ignore", invalid="ignore"):
        memory = np.zeros(fronts.levels[-1].size)
        for level, size_above in zip(reversed(fronts.levels), reversed(sizes_above), strict=True):
            memory[level.places] += A.data[level.entries] / scale
            memory[level.padding] = 1.0
            above = np.zeros(size_above)
            for batch in level.batches:
                blocks.append((batch, _eliminate(batch, memory, above, dtype)))
            memory = above
    return BlockFactor(fronts, scale, blocks)


def _eliminate(batch: Batch, memory: Array, above: Array, dtype: np.dtype) -> Array:
    """Eliminate the nodes I of a batch of fronts: return [F_II^{-1}  -W], and hand on S."""
    count, m = batch.slots.shape
    k = m - batch.rows.shape[1]
    F = memory[batch.memory].reshape(count, m, m)
    inverse = np.linalg.inv(F[:, :k, :k])
    W = inverse @ F[:, :k, k:]
    S = F[:, k:, k:] - F[:, :k, k:].swapaxes(1, 2) @ W
    # Several fronts may add to one entry.
    np.add.at(above, (batch.rows[:, :, None] + batch.columns[:, None]).ravel(), S.ravel())
    block = np.empty((count, k, m), dtype=dtype)
    block[:, :, :k] = inverse
    block[:, :, k:] = -W
    return block


class BlockFactor:
    """A factorised matrix; made by :func:`factorise`."""

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

        Raises
        ------
        TypeError
            If `b` is not real.
        ValueError
            If it does not have N rows.
        """
        b = right_hand_side(len(self._fronts.slot), b)
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

    def __repr__(self) -> str:
        n, blocks = len(self._fronts.slot), [block for _, block in self._blocks]
        entries, n_bytes = sum(b.size for b in blocks), sum(b.nbytes for b in blocks)
        return (
            f"BlockFactor(unknowns={n}, levels={len(self._fronts.levels)}, entries per unknown="
            f"{entries / n:.1f}, memory={n_bytes / 1e6:.1f} MB, dtype={blocks[0].dtype})"
        )


def _upwards(y: Array, batch: Batch, block: Array) -> None:
    """y_B -= W^T y_I."""
    count, k, _ = block.shape
    y_I = y[:, batch.own].reshape(len(y), count, k).swapaxes(0, 1)
    change = (y_I @ block[:, :, k:]).swapaxes(0, 1)
    for row, values in zip(y, change, strict=True):
        np.add.at(row, batch.outer, values.ravel())


def _downwards(y: Array, batch: Batch, block: Array) -> None:
    """x_I = F_II^{-1} y_I - W x_B."""
    count, k, _ = block.shape
    front = y.take(batch.slots, axis=1).swapaxes(0, 1)[..., None]
    # One right-hand side after the other: a product of a transposed matrix with few columns at once
    # is slower, except with AVX-512.
    x_I = block[:, None] @ front
    y[:, batch.own] = x_I.swapaxes(0, 1).reshape(len(y), count * k)
