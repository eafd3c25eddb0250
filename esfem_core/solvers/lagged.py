"""Symmetric positive definite systems that change a little from step to step.

A matrix of one time step is a good preconditioner for those of many later steps. So
:class:`LaggedSolver` factorises rarely, and solves by conjugate gradients in between, to a
residual it checks; `DirectSolver` factorises every time. Both take the factorisation as a function
from a matrix to something that solves with it: `superlu`, `cholmod`, or, on a dissected mesh,
`multifrontal.factorise`.
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, Ints, function, number, real_array, whole_number
from esfem_core.solvers.ageing import Ageing
from esfem_core.solvers.conjugate_gradients import Tolerance, pcg, tolerance
from esfem_core.solvers.factors import Factor, superlu
from esfem_core.solvers.products import times_rows
from esfem_core.solvers.systems import (
    LEFT,
    check_factor,
    require_finite,
    require_solved,
    right_hand_side,
    square,
)

__all__ = ["RTOL", "LaggedSolver"]

RTOL = 1e-11
"""Residual over right-hand side to which conjugate gradients go if nothing else is said."""

LARGEST = 1e135  # of rounding errors in A x, about those of entries of 1e150
FAR = 1e100  # above it, and below its inverse, products of residuals may leave the range of numbers


class LaggedSolver:
    """Conjugate gradients preconditioned with the factorisation of an earlier matrix.

    Parameters
    ----------
    rtol : float
        Between 0 and 1. The Euclidean norm of each column's residual is brought below ``rtol``
        times that of its right-hand side (or to rounding level, whichever is larger). Then a
        constant is added to the column, which makes the sum of its residual zero: a finite element
        solution has its exact integral.
    price : int
        What a factorisation costs, in iterations, at least 1; a solve takes more only where one is
        made anew in it. That is when the iterations that its age has cost add up to the price: the
        least total cost where they grow linearly from solve to solve, and never more than twice the
        least. What a solve would take with a new one is judged by the first solve after it was
        made.
    factorise : callable
        From a matrix to its :class:`~esfem_core.solvers.factors.Factor`.

    Attributes
    ----------
    iterations, factorisations : int
        Totals since the solver was made.

    Raises
    ------
    TypeError
        If `rtol` or `price` is not a number.
    ValueError
        If it is outside its range, or `price` is not an integer.

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
    >>> solver
    LaggedSolver(rtol=1e-11, price=30, iterations=2, factorisations=1,
        factor=SuperLU(unknowns=5, entries per unknown=..., memory=0.0 MB))
    """

    def __init__(
        self,
        rtol: float = RTOL,
        price: int = 30,
        factorise: Callable[[csr_array], Factor] = superlu,
    ) -> None:
        self.rtol = number("rtol", rtol, above=0, below=1)
        self.iterations = self.factorisations = 0
        self._ageing = Ageing(whole_number("price", price, least=1))
        self._factorise = function("factorise", factorise, "from a matrix to its Factor")
        self._factor: Factor | None = None

    @property
    def price(self) -> int:
        """What a factorisation costs, in iterations."""
        return self._ageing.price

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
        TypeError
            If `A` is not in CSR format, or its entries, `b` or `guess` are not real.
        ValueError
            If `A` is not square, or not as large as those before; if `b` or `guess` does not fit
            it; or if it is factorised and not symmetric.
        numpy.linalg.LinAlgError
            If `A` is not finite, or the residual asked for is not reached with a factorisation of
            `A` itself, at last with that by SuperLU; or if rounding level is so high, since `A` is
            singular, that more than a tenth of `b` is left.
        FloatingPointError
            If a right-hand side or the solution is not finite.
        """
        b = right_hand_side(square(A), b)
        guess = real_array("guess", guess, b.shape)
        if b.size == 0:
            return np.zeros(b.shape)
        self._check_size(len(b))
        rows = np.ascontiguousarray(b.reshape(len(b), -1).T)
        with np.errstate(over="ignore", under="ignore"):
            squares = np.vecdot(rows, rows)
        if not ((squares > FAR**-2) & (squares < FAR**2)).all():
            power = _to_one(b)
            if power.any():
                with np.errstate(over="ignore"):
                    guess = np.ldexp(guess, power)
                    x = np.ldexp(self.solve(A, np.ldexp(b, power), guess), -power)
                if not np.isfinite(x).all():
                    raise FloatingPointError("the solution of a linear system is beyond 1e308")
                return x
        x = np.array(guess.reshape(len(b), -1).T, order="C")
        x[squares == 0] = 0.0
        allowed = tolerance(A, squares, self.rtol)
        if LARGEST < allowed.rounding < np.inf:
            raise np.linalg.LinAlgError(
                "the numbers of A must be at most 1e150, so that their squares can be added up, "
                f"got {A.data.max():.2g}"
            )

        converged = False
        if self._factor is not None and not self._ageing.due:
            x, converged = self._iterate(self._factor, A, rows, x, allowed)
        # Of elements as flat as needles, a factor in single precision may have no right digit.
        for factorise in (self._factorise, superlu):
            if converged:
                break
            require_finite(A)
            self._factor = factorise(A)
            check_factor(self._factor)
            self._ageing = Ageing(self.price)
            self.factorisations += 1
            x, converged = self._iterate(self._factor, A, rows, x, allowed)
        if not converged:
            raise np.linalg.LinAlgError(
                f"no solution to a relative residual of {self.rtol:g} in {self.price} iterations "
                "(the price of LaggedSolver), not even with a new factorisation by SuperLU: A must "
                "be symmetric and positive definite, but is not, or its condition number is too "
                "large for double precision"
            )
        _require_solved_rows(A, rows, x, allowed)
        return np.ascontiguousarray(x.T).reshape(b.shape)

    def _check_size(self, n: int) -> None:
        """Refuse a matrix of another size than the one whose factor is kept, where that tells."""
        before = getattr(self._factor, "unknowns", n)
        if before != n:
            raise ValueError(
                f"A must have the shape of the matrices before, {(before, before)}, got {(n, n)}: "
                "make a new LaggedSolver"
            )

    def _iterate(
        self, factor: Factor, A: csr_array, b: Array, x: Array, allowed: Tolerance
    ) -> tuple[Array, bool]:
        """Conjugate gradients from x on, and whether they converged."""
        with np.errstate(over="ignore", invalid="ignore"):  # they do not converge then
            found = pcg(A, b, x, factor.solve, allowed, self.price)
        self.iterations += found.iterations
        if found.converged:
            self._ageing.record(found.iterations, found.start, found.end)
        return found.x, found.converged

    def __repr__(self) -> str:
        return (
            f"LaggedSolver(rtol={self.rtol:g}, price={self.price}, iterations={self.iterations}, "
            f"factorisations={self.factorisations}, factor={self._factor})"
        )


def _require_solved_rows(A: csr_array, b: Array, x: Array, allowed: Tolerance) -> None:
    """Refuse rows of x that are accepted for their rounding level only, but solve nothing."""
    # A sum over N entries is at most sqrt(N) times as large as the Euclidean norm: where rounding
    # is far from b, as in almost all runs, no product with A is needed to know it.
    with np.errstate(over="ignore"):
        level = allowed.rounding**2 * b.shape[1] * np.vecdot(x, x)
    if (level > LEFT**2 * np.vecdot(b, b)).any():
        r = b - times_rows(A, x)
        loose = np.vecdot(r, r) > allowed.squares
        require_solved(b[loose].T, r[loose].T)


def _to_one(b: Array) -> Ints:
    """Exponents of powers of two that bring those columns of b near one that are far from it."""
    largest = np.abs(b).max(axis=0)
    if not np.isfinite(largest).all():
        raise FloatingPointError(
            "b must be finite, but the right-hand side of a linear system is not finite"
        )
    near = (largest > 1 / FAR) & (largest < FAR)
    exponents: Ints = np.where(near, 0, -np.frexp(largest)[1])  # 0 for a column of zeros
    return exponents
