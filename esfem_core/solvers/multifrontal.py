"""Sparse factorisations made of small dense matrices, in NumPy (Duff and Reid, 1983).

The front of a part of a dissected mesh, a dense symmetric matrix on the nodes I that the part owns
and the nodes B around it, is::

    F = [F_II  F_IB]     the entries of A that come in with I, and the S of the part's two halves
        [F_BI  F_BB]
    W = F_II^{-1} F_IB
    S = F_BB - F_BI W    handed on to the part that this one is a half of

Then A x = b is solved by y_B -= W^T y_I from the smallest parts upwards, starting from y = b, and
x_I = F_II^{-1} y_I - W x_B downwards. Subtrees do not wait for each other: on the way up each adds
to its own copy of the nodes of larger parts, and these are added up in the order of the subtrees.

In M + tau A with a small tau, F_II^{-1} and W decay over a front like exp(-distance/sqrt(tau)). At
1e-38 single precision has no normal numbers left, and processors take up to a hundred times as long
for subnormal ones. So what is tiny becomes zero before it is a factor of a product.
"""

from bisect import bisect_left
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike
from scipy.sparse import csr_array

from esfem_core.checks import Array, object_of, shown
from esfem_core.solvers.fronts import Batch, Fronts, Level
from esfem_core.solvers.systems import check_halves, right_hand_side, square
from esfem_core.solvers.threads import pieces, side_by_side

__all__ = ["BlockFactor", "factorise"]

PRECISIONS = (np.dtype(np.float32), np.dtype(np.float64))
LARGE = 10**5  # entries of right-hand sides that several threads put into place
GOOD = 0.05  # residual up to which errors of single precision cost an iteration at most
HALVED = 16  # rows of a matrix, above which it is inverted half by half
# Added and subtracted, this leaves zero of numbers whose squares are not normal.
FLOOR = {d: d.type(2 * np.sqrt(np.finfo(d).tiny) / np.finfo(d).eps) for d in PRECISIONS}
RUN = 2**21  # entries of the fronts that are eliminated at a time


class Run(NamedTuple):
    """Some successive fronts of a batch, and the slots of their nodes I."""

    batch: Batch
    fronts: slice
    own: slice


Step = tuple[Run, Array]  # the block [F_II^{-1}  -W] of some fronts
Rest = tuple[Run, Array]  # their S


def factorise(A: csr_array, fronts: Fronts, dtype: DTypeLike | None = None) -> "BlockFactor":
    """Factorise a symmetric positive definite matrix.

    Single precision is enough for a preconditioner of all but nearly singular matrices, and takes
    half the time and memory of double.

    Parameters
    ----------
    A : (N, N) CSR array
        Of the pattern that the fronts were made for.
    fronts : Fronts
        Of a mesh, for example :attr:`esfem_core.SurfaceSpace.fronts`.
    dtype : float32 or float64, optional
        Of the computation and the factor. Default: single precision, if that leaves a small
        residual where the solution is constant; else double in the computation, and in the factor
        as well if rounding it left a residual as large as the right-hand side.

    Returns
    -------
    BlockFactor

    Raises
    ------
    TypeError
        If the matrix is not in CSR format, or its entries are not real.
    ValueError
        If it is not square, not symmetric or its pattern differs from that of the fronts, or if
        `dtype` is another one.
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
    of_a, made_for = (A.indptr, A.indices), (fronts.pattern.indptr, fronts.pattern.indices)
    for own, wanted in zip(of_a, made_for, strict=True):
        if own is not wanted and not np.array_equal(own, wanted):
            raise ValueError(
                "A must have the pattern that the fronts were made for, that of space.pattern; got "
                "as many entries at other places"
            )
    check_halves(A)  # a twentieth of the time of the factorisation, or less
    if dtype is not None:
        return _factorise(A, fronts, _precision(dtype))
    single = _in_single(A, fronts)
    if single is not None:
        return single
    double = _factorise(A, fronts, np.dtype(np.float64))
    with np.errstate(over="ignore", invalid="ignore"):  # numbers beyond 1e38, seen below
        single = double.astype(np.dtype(np.float32))
        return single if _leaves(1.0, single, A) else double


def _precision(dtype: DTypeLike) -> np.dtype:
    """One of the dtypes that a factor can have."""
    with suppress(TypeError):  # names of no dtype
        found = np.dtype(dtype)
        if found in PRECISIONS:
            return found
    raise ValueError(f"dtype must be float32, float64 or None, got {shown(dtype)}")


def _in_single(A: csr_array, fronts: Fronts) -> "BlockFactor | None":
    """A factor computed in single precision, if that is good enough for a preconditioner."""
    with suppress(np.linalg.LinAlgError):  # it may be singular in single precision alone
        factor = _factorise(A, fronts, np.dtype(np.float32))
        if _leaves(GOOD, factor, A):
            return factor
    return None


def _leaves(share: float, factor: "BlockFactor", A: csr_array) -> bool:
    """Whether a constant solution leaves less than this share of the right-hand side."""
    # A single-precision solution has rough rounding errors of relative size 1e-7, which A
    # multiplies by its largest eigenvalues, and constants, as a rule, by its smallest.
    with np.errstate(over="ignore", invalid="ignore"):  # then it does not
        b = A @ np.ones(A.shape[0])
        return bool(np.linalg.norm(b - A @ factor.solve(b)) < share * np.linalg.norm(b))


def _factorise(A: csr_array, fronts: Fronts, dtype: np.dtype) -> "BlockFactor":
    """Eliminate all nodes, from the smallest parts to the whole."""
    scale = float(abs(A.data).max())
    if not 0 < scale < np.inf:
        raise np.linalg.LinAlgError(
            "the matrix of a linear system must be positive definite and finite, but its largest "
            f"entry is {scale}"
        )
    numbers = A.data, scale, dtype
    # What overflows here is no solution: whoever checks the residual will see it.
    with np.errstate(over="ignore", invalid="ignore"):
        done = side_by_side(
            lambda n: _eliminate_all(fronts.below(n), [], *numbers), range(fronts.subtrees)
        )
        subtrees = [steps for steps, _ in done]
        top, _ = _eliminate_all(fronts.top, [rest for _, left in done for rest in left], *numbers)
    return BlockFactor(fronts, scale, subtrees, top)


def _eliminate_all(
    levels: list[Level], left: list[Rest], data: Array, scale: float, dtype: np.dtype
) -> tuple[list[Step], list[Rest]]:
    """Eliminate the nodes of a part of the tree, from the smallest parts up; also what is left."""
    steps = []
    for level in reversed(levels):
        runs = _runs(level)
        rests = []
        for run in runs:
            block, S = _eliminate(_assembled(level, left, data, scale, dtype, run), run)
            steps.append((run, block))
            rests.append((run, S))
        left = rests
    return steps, left


def _runs(level: Level) -> list[Run]:
    """Divide the batches of a depth into runs of about 16 MiB at most, if that is not one front."""
    runs = []
    for batch in level.batches:
        count, k, m = batch.shape
        for fronts in pieces(count, 1 + RUN // (m * m + 1)):
            own = slice(*(batch.own.start + k * i for i in (fronts.start, fronts.stop)))
            runs.append(Run(batch, fronts, own))
    return runs


def _eliminate(F: Array, run: Run) -> tuple[Array, Array]:
    """Eliminate the nodes I of some fronts: [F_II^{-1}  -W], and S."""
    k = F.shape[1] - run.batch.rows.shape[1]
    inverse = _without_tiny(_inverse(F[:, :k, :k]))
    W = _without_tiny(inverse @ F[:, :k, k:])
    S = _without_tiny(F[:, k:, k:] - F[:, :k, k:].swapaxes(1, 2) @ W)
    return np.concatenate([inverse, -W], axis=2), S


def _without_tiny(x: Array) -> Array:
    """Make zeros of entries below 1e-19, or 1e-154 in double precision, in place.

    Examples
    --------
    >>> x = np.array([1.0, -1e-15, 1e-20], dtype=np.float32)
    >>> [f"{number:.3g}" for number in _without_tiny(x)]
    ['1', '-1e-15', '0']
    """
    floor = FLOOR[x.dtype]
    x += floor
    x -= floor
    return x


def _inverse(F: Array) -> Array:
    """Inverses of symmetric positive definite matrices, (n, k, k), half by half.

    Nearly all of it are products of matrices: a half to a fifth of the time of LAPACK's.
    """
    k = F.shape[1]
    if k <= HALVED:
        return np.asarray(np.linalg.inv(F), dtype=F.dtype)
    first, second = slice(0, k // 2), slice(k // 2, k)
    P, B = _inverse(F[:, first, first]), F[:, first, second]
    Q = _without_tiny(P @ B)
    R = _inverse(F[:, second, second] - B.swapaxes(1, 2) @ Q)
    T = _without_tiny(Q @ R)
    inverse = np.empty_like(F)
    inverse[:, first, first] = P + T @ Q.swapaxes(1, 2)
    inverse[:, first, second] = -T
    inverse[:, second, first] = -T.swapaxes(1, 2)
    inverse[:, second, second] = R
    return inverse


def _assembled(
    level: Level, left: list[Rest], data: Array, scale: float, dtype: np.dtype, run: Run
) -> Array:
    """Fronts with what is left of their halves, and the entries of A that come in with them."""
    batch, fronts, m = run.batch, run.fronts, run.batch.shape[2]
    count = fronts.stop - fronts.start
    F = np.zeros(count * m * m, dtype)
    for half, S in left:
        number = half.batch.above[half.fronts] - (batch.number + fronts.start)
        own = np.flatnonzero((number >= 0) & (number < count))
        rows = half.batch.rows[half.fronts][own]
        place = m * (m * number[own, None] + rows)
        # Several halves may add to one entry.
        np.add.at(F, (place[:, :, None] + rows[:, None]).ravel(), S[own].ravel())
    start = batch.place + fronts.start * m * m
    here = slice(*(bisect_left(level.places, start + n) for n in (0, len(F))))
    F[level.places[here] - start] += data[level.entries[here]] / scale
    padding = slice(*(bisect_left(level.padding, start + n) for n in (0, len(F))))
    F[level.padding[padding] - start] = 1.0
    return F.reshape(count, m, m)


class BlockFactor:
    """A factorised matrix; made by :func:`factorise`."""

    def __init__(
        self, fronts: Fronts, scale: float, subtrees: list[list[Step]], top: list[Step]
    ) -> None:
        self._fronts, self._scale, self._subtrees, self._top = fronts, scale, subtrees, top
        self._blocks = [block for steps in (*subtrees, top) for _, block in steps]

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
        size = abs(rows).max(axis=1)
        size[size == 0] = 1.0
        y = np.empty((len(rows), self._fronts.size), dtype=self._blocks[0].dtype)
        x = np.empty(rows.shape)
        node, slot, worth = self._fronts.node, self._fronts.slot, rows.size > LARGE

        def put(i: int) -> None:
            row = np.zeros(len(slot) + 1, dtype=y.dtype)  # the last one for slots of no node
            row[:-1] = 1 / size[i] * rows[i]
            row.take(node, out=y[i], mode="clip")  # other modes fill a copy first

        def take(i: int) -> None:
            np.multiply(y[i].take(slot), size[i] / self._scale, out=x[i])

        side_by_side(put, range(len(y)), worth)
        side_by_side(partial(_upwards, y), self._subtrees)
        if self._top:
            n, shared = self._fronts.subtrees, self._fronts.shared
            copies = y[:, : n * shared].reshape(len(y), n, shared)
            for i in range(1, n):
                copies[:, 0] += copies[:, i]
            _upwards(y, self._top)
            _downwards(y, self._top)
            copies[:, 1:] = copies[:, :1]
        side_by_side(partial(_downwards, y), self._subtrees)
        side_by_side(take, range(len(y)), worth)
        return x.T.reshape(b.shape)

    def astype(self, dtype: np.dtype) -> "BlockFactor":
        """The same factor in another precision."""
        subtrees, top = (
            [[(run, _without_tiny(block.astype(dtype))) for run, block in steps] for steps in part]
            for part in (self._subtrees, [self._top])
        )
        return BlockFactor(self._fronts, self._scale, subtrees, top[0])

    def __repr__(self) -> str:
        n, blocks = len(self._fronts.slot), self._blocks
        entries, n_bytes = sum(b.size for b in blocks), sum(b.nbytes for b in blocks)
        return (
            f"BlockFactor(unknowns={n}, levels={len(self._fronts.levels)}, entries per unknown="
            f"{entries / n:.1f}, memory={n_bytes / 1e6:.1f} MB, dtype={blocks[0].dtype})"
        )


def _upwards(y: Array, steps: list[Step]) -> None:
    """y_B -= W^T y_I, from the smallest parts up."""
    for run, block in steps:
        count, k, _ = block.shape
        y_I = _without_tiny(y[:, run.own]).reshape(len(y), count, k).swapaxes(0, 1)
        change = (y_I @ block[:, :, k:]).swapaxes(0, 1)
        outer = run.batch.outer[run.fronts].ravel()
        for row, values in zip(y, change, strict=True):
            np.add.at(row, outer, values.ravel())


def _downwards(y: Array, steps: list[Step]) -> None:
    """x_I = F_II^{-1} y_I - W x_B, from the largest parts down."""
    for run, block in reversed(steps):
        count, k, _ = block.shape
        front = y.take(run.batch.slots[run.fronts], axis=1).swapaxes(0, 1)[..., None]
        # One right-hand side after the other: a product of a transposed matrix with few columns at
        # once is slower, except with AVX-512.
        x_I = _without_tiny(block[:, None] @ front)
        y[:, run.own] = x_I.swapaxes(0, 1).reshape(len(y), count * k)
