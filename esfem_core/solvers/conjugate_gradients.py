"""Preconditioned conjugate gradients, for several right-hand sides at once.

Vectors are rows here, those of (m, N) arrays: NumPy is slow on many short rows.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array
from esfem_core.solvers.products import times_rows

__all__ = ["ROUNDING", "Approximation", "Tolerance", "pcg", "tolerance"]

# The largest entry of a positive definite matrix is on its diagonal and bounds the rounding errors
# in A x, below which no residual can be brought.
ROUNDING = 4 * np.finfo(float).eps
"""Share of the largest entry of A, times the norm of x, that residuals are always allowed."""


class Tolerance(NamedTuple):
    """How large residuals may be.

    Attributes
    ----------
    squares : (m,) float array
        Squared Euclidean norms that are allowed.
    rounding : float
        A bound of the rounding errors in A x, divided by the norm of x: what is less is allowed.
    """

    squares: Array
    rounding: float

    def excess(self, r: Array, x: Array) -> float:
        """Largest quotient of a squared residual and what is allowed: at most 1 is small enough.

        Parameters
        ----------
        r, x : (m, N) float arrays
            Residuals and solutions.
        """
        rr = np.vecdot(r, r)
        quotient = (rr / self.squares).max()
        if not quotient <= 1:  # also if it is NaN
            floor = self.rounding**2 * np.vecdot(x, x)
            quotient = (rr / np.maximum(self.squares, floor)).max()
        return float(quotient)


def tolerance(A: csr_array, squares: Array, rtol: float) -> Tolerance:
    """Residuals of `rtol` relative to right-hand sides, or of rounding level if that is larger.

    Parameters
    ----------
    A : (N, N) CSR array
        Symmetric positive definite.
    squares : (m,) float array
        Squared Euclidean norms of the right-hand sides.
    rtol : float
        Where a right-hand side is zero, it is absolute.

    Returns
    -------
    Tolerance
    """
    return Tolerance(rtol**2 * np.where(squares > 0, squares, 1.0), ROUNDING * A.data.max())


class Approximation(NamedTuple):
    """What conjugate gradients have come to.

    Attributes
    ----------
    x : (m, N) float array
    iterations : int
    start, end : float
        The excess of the residuals, see :meth:`Tolerance.excess`, at the first guess and after the
        last iteration.
    converged : bool
        Whether the residuals of `x` are small enough.
    """

    x: Array
    iterations: int
    start: float
    end: float
    converged: bool


def pcg(
    A: csr_array,
    b: Array,
    x: Array,
    precondition: Callable[[Array], Array],
    allowed: Tolerance,
    most: int,
) -> Approximation:
    """Solve A x = b by conjugate gradients, each row of b on its own (Saad, 2003, algorithm 9.1).

    In the end a constant is added to each solution, such that the sum of its residual is zero; its
    error becomes smaller in the norm of A by that.

    Parameters
    ----------
    A : (N, N) CSR array
        Symmetric positive definite.
    b : (m, N) float array
        Right-hand sides.
    x : (m, N) float array
        First guesses; one with a larger residual than zero is not used. What is found is written
        over them.
    precondition : callable
        From residuals as columns, (N, m), to approximate solutions with them.
    allowed : Tolerance
        For the residuals of all rows.
    most : int
        Iterations after which to give up.

    Returns
    -------
    Approximation

    References
    ----------
    Y. Saad, Iterative Methods for Sparse Linear Systems, second edition, SIAM, 2003.

    Examples
    --------
    >>> from scipy.sparse import diags_array
    >>> A = diags_array([[-1.0] * 4, [3.0] * 5, [-1.0] * 4], offsets=[-1, 0, 1], format="csr")
    >>> b = np.arange(5.0)[None]
    >>> allowed = tolerance(A, np.vecdot(b, b), rtol=1e-12)
    >>> found = pcg(A, b, np.zeros((1, 5)), lambda r: r / 3, allowed, most=10)
    >>> found.iterations, bool(np.allclose(A @ found.x[0], b[0]))
    (5, True)
    """
    r = b - times_rows(A, x)  # step 1
    # A guess that is worse than none: if it is much larger than the solution, its rounding errors
    # stay in x, and the residual r of step 5, which is not computed anew, does not know of them.
    with np.errstate(over="ignore", invalid="ignore"):
        worse = ~(np.vecdot(r, r) <= np.vecdot(b, b))  # also if it is not finite
    x[worse], r[worse] = 0.0, b[worse]
    start = end = allowed.excess(r, x)
    # With p = 0, steps 6 to 8 of the first round set z = M^{-1} r and p = z, as step 1 does.
    p, rz_old = np.zeros_like(r), np.ones(len(r))
    k = 0
    while True:  # step 2
        if end <= 1:
            _balance(A, x, r, allowed)
            return Approximation(x, k, start, end, converged=True)
        if k == most or not np.isfinite(end):
            return Approximation(x, k, start, end, converged=False)
        z = precondition(r.T).T  # step 6
        rz = np.vecdot(r, z)
        p *= (rz / rz_old)[:, None]  # steps 7 and 8, beta = rz / rz_old
        p += z
        Ap = times_rows(A, p)
        pAp = np.vecdot(p, Ap)
        alpha = np.divide(rz, pAp, out=np.zeros_like(rz), where=pAp > 0)[:, None]  # step 3
        Ap *= alpha
        r -= Ap  # step 5
        x += np.multiply(alpha, p, out=Ap)  # step 4, in the memory of A p
        rz_old = np.where(rz > 0, rz, 1.0)  # a row that is solved exactly stays where it is
        k, end = k + 1, allowed.excess(r, x)


def _balance(A: csr_array, x: Array, r: Array, allowed: Tolerance) -> None:
    """Add a constant to each row of x, such that the sum of its residual is zero.

    The error becomes A-orthogonal to constants, hence smaller in the norm of A.
    """
    total = float(A.data.sum())
    # If it is less, A takes constants to rounding errors.
    if total > A.shape[0] * allowed.rounding:
        x += (r.sum(axis=1) / total)[:, None]
