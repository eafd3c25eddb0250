"""Symmetric positive definite systems that change a little from step to step.

A matrix of one time step is a good preconditioner for those of many later steps. So
:class:`LaggedSolver` factorises rarely, and solves by conjugate gradients in between, to a
residual it checks. :class:`DirectSolver` factorises every time. Both take the factorisation as a
function from a matrix to something that solves with it: :func:`superlu`, :func:`cholmod`, or, on a
dissected mesh, :func:`esfem_core.solvers.multifrontal.factorise`.
"""

from collections.abc import Callable
from math import ceil, log

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.solvers.factors import Factor, superlu

__all__ = ["LaggedSolver"]

Array = NDArray[np.float64]


class LaggedSolver:
    """Conjugate gradients preconditioned with the factorisation of an earlier matrix.

    Parameters
    ----------
    rtol : float
        The Euclidean norm of each column's residual is brought below ``rtol`` times that of its
        right-hand side (or to rounding level, whichever is larger), and the sum of its entries to
        zero: a finite element solution then has its exact integral.
    price : int
        What a factorisation costs, in iterations; no solve takes more. It is made anew when the
        iterations that its age has cost add up to that: the least total cost where they grow
        linearly from solve to solve, and never more than twice the least. What a solve would take
        with a new one is judged by the first solve after it was made.
    factorise : callable
        From a matrix to its :class:`Factor`.

    Attributes
    ----------
    iterations, factorisations : int
        Totals since the solver was made.

    Examples
    --------
    >>> from scipy.sparse import diags_array
    >>> solver = LaggedSolver()
    >>> A = diags_array([[-1.0] * 4, [3.0] * 5, [-1.0] * 4], offsets=[-1, 0, 1], format="csr")
    >>> b = np.arange(5.0)
    >>> x = solver.solve(A, b, np.zeros(5))
    >>> x = solver.solve(1.1 * A, b, x)
    >>> bool(np.allclose(1.1 * (A @ x), b)), solver.factorisations
    (True, 1)
    """

    def __init__(
        self,
        rtol: float = 1e-11,
        price: int = 30,
        factorise: Callable[[csr_array], Factor] = superlu,
    ) -> None:
        if not 0 < rtol < 1:
            raise ValueError(f"rtol must lie in (0, 1), got {rtol!r}")
        if price < 1:
            raise ValueError(f"price must be at least 1, got {price!r}")
        self.rtol, self.price = rtol, price
        self.iterations = self.factorisations = 0
        self._factorise = factorise
        self._factor: Factor | None = None
        self._lost = 0  # iterations that its age has cost
        self._rate = 0.0  # what an iteration achieved while it was new; 0 until there was one

    def solve(self, A: csr_array, b: Array, guess: Array) -> Array:
        """Solve A x = b for symmetric positive definite A.

        Parameters
        ----------
        A : (N, N) CSR array
        b : (N,) or (N, m) float array
        guess : array like `b`

        Returns
        -------
        array like `b`

        Raises
        ------
        numpy.linalg.LinAlgError
            If the residual asked for is not reached with a factorisation of `A` itself.
        FloatingPointError
            If the norm of a right-hand side is not finite.
        """
        # Right-hand sides as contiguous rows: NumPy is slow on many short rows.
        rows, x = _rows(b), _rows(guess).copy()
        with np.errstate(over="ignore"):
            squares = np.vecdot(rows, rows)
        if not np.isfinite(squares).all():
            raise FloatingPointError("the right-hand side of a linear system is not finite")
        x[squares == 0] = 0.0
        usable = self._factor is not None and self._lost < self.price
        if not (usable and self._conjugate_gradients(A, rows, x, squares)):
            self._factor, self._lost, self._rate = self._factorise(A), 0, 0.0
            self.factorisations += 1
            x[~np.isfinite(x)] = 0.0
            if not self._conjugate_gradients(A, rows, x, squares):
                raise np.linalg.LinAlgError(
                    f"no solution to a relative residual of {self.rtol:g} in {self.price} "
                    "iterations: the matrix is singular, indefinite or not finite"
                )
        return np.ascontiguousarray(x.T).reshape(b.shape)

    def _conjugate_gradients(self, A: csr_array, b: Array, x: Array, squares: Array) -> bool:
        """Improve x in place, all rows at once; tell whether the residuals are small enough.

        `squares` are those of the norms of the right-hand sides b.
        """
        assert self._factor is not None
        bound = self.rtol**2 * np.where(squares > 0, squares, 1.0)
        # The largest entry of a positive definite matrix is on its diagonal and bounds the
        # rounding errors in A x, below which no residual can be brought.
        rounding = 4 * np.finfo(float).eps * A.data.max()

        def worst(margin: float = 1.0) -> float:
            """Largest quotient of a squared residual and its bound."""
            rr = np.vecdot(r, r)
            quotient = (rr / bound).max()
            if not quotient <= 1:
                floor = (margin * rounding) ** 2 * np.vecdot(x, x)
                quotient = (rr / np.maximum(bound, floor)).max()
            return float(quotient)

        r = b - _times(A, x)
        p, rz_old = np.zeros((len(r), 1)), np.ones(len(r))  # no direction yet
        row_sums = A @ np.ones(A.shape[0])
        k, start = 0, worst()
        end = start
        while True:
            if end <= 1:
                # A constant added to x makes the residual's sum zero, at little cost to its norm.
                shift = (r.sum(axis=1) / row_sums.sum())[:, None]
                x += shift
                r -= shift * row_sums
                if worst(margin=4) <= 1:
                    break
            if k == self.price or not np.isfinite(end):
                return False
            z = self._factor.solve(r.T).T
            rz = np.vecdot(r, z)
            p = z + (rz / rz_old)[:, None] * p
            Ap = _times(A, p)
            pAp = np.vecdot(p, Ap)
            alpha = np.divide(rz, pAp, out=np.zeros_like(rz), where=pAp > 0)[:, None]
            x += alpha * p
            Ap *= alpha
            r -= Ap
            rz_old = np.where(rz > 0, rz, 1.0)
            k, end = k + 1, worst()
            self.iterations += 1
        if self._rate == 0 < k:
            self._rate = log(start / max(end, 1e-30)) / k
        elif k > 0:
            self._lost += max(0, k - ceil(log(start) / self._rate))
        return True


def _rows(b: Array) -> Array:
    """Columns (N,) or (N, m) as contiguous rows (m, N)."""
    return np.ascontiguousarray(b.reshape(len(b), -1).T)


def _times(A: csr_array, x: Array) -> Array:
    """A times each row of x."""
    return np.stack([A @ row for row in x])
