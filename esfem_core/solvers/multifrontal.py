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

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.sparse import csr_array

from esfem_core.solvers.fronts import Batch, Fronts

__all__ = ["BlockFactor", "factorise"]

Array = NDArray[np.float64]


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
    dtype : float type, optional
        In which the factor is kept. Default: single precision, unless that leaves a residual as
        large as the right-hand side where the solution is constant; then double.

    Returns
    -------
    BlockFactor

    Raises
    ------
    ValueError
        If the matrix has not the pattern of the fronts.
    numpy.linalg.LinAlgError
        If it is singular or not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> factor = factorise(M + A, space.fronts, dtype=np.float64)
    >>> b = space.nodes.prod(axis=1)
    >>> bool(np.allclose((M + A) @ factor.solve(b), b, rtol=0, atol=1e-14))
    True
    """
    n = len(fronts.slot)
    if A.shape != (n, n) or len(A.data) != fronts.n_entries:
        raise ValueError(
            f"A must have the pattern that the fronts were made for, shape {(n, n)} with "
            f"{fronts.n_entries} entries; got shape {A.shape} with {len(A.data)}"
        )
    if dtype is None:
        # A single-precision solution has rough rounding errors of relative size 1e-7, which A
        # multiplies by its largest eigenvalues, and constants, as a rule, by its smallest.
        single, b = factorise(A, fronts, np.float32), A @ np.ones(n)
        useful = np.linalg.norm(b - A @ single.solve(b)) < np.linalg.norm(b)
        return single if useful else factorise(A, fronts, np.float64)
    scale = float(abs(A.data).max())
    if not 0 < scale < np.inf:
        raise np.linalg.LinAlgError(
            f"the matrix of a linear system is singular or not finite: its largest entry is {scale}"
        )
    blocks = []
    sizes = [0, *(level.size for level in fronts.levels)]
    # What overflows here is no solution: whoever checks the residual will see it.
    with np.errstate(over="ignore", invalid="ignore"):
        memory = np.zeros(fronts.levels[-1].size)
        for level, size in zip(reversed(fronts.levels), reversed(sizes[:-1]), strict=True):
            memory[level.places] += A.data[level.entries] / scale
            memory[level.padding] = 1.0
            larger = np.zeros(size)
            for batch in level.batches:
                blocks.append((batch, _eliminate(batch, memory, larger, dtype)))
            memory = larger
    return BlockFactor(fronts, scale, blocks)


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
