"""Factorisations of sparse symmetric positive definite matrices, by libraries."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import SuperLU, splu

__all__ = ["DirectSolver", "Factor", "Solver", "cholmod", "superlu"]

Array = NDArray[np.float64]

Solve = Callable[[Array], Array]


class Factor(Protocol):
    """A factorised matrix."""

    def solve(self, b: Array) -> Array:
        """Solve with the columns of b, (N, m)."""


class Solver(Protocol):
    """What :func:`esfem_core.evolve` asks of a linear solver."""

    def solve(self, A: csr_array, b: Array, guess: Array) -> Array:
        """Solve A x = b, for one or several columns b, starting from a guess if of use."""


class _Reordered:
    """A factorised matrix that wants its unknowns in another order."""

    def __init__(
        self, A: csr_array, order: NDArray[np.int64] | None, solve: Callable[[csr_array], Solve]
    ) -> None:
        self._order = np.arange(A.shape[0]) if order is None else order
        self._position = np.argsort(self._order)
        self._solve = solve(A[self._order][:, self._order])

    def solve(self, b: Array) -> Array:
        return self._solve(b.take(self._order, axis=0)).take(self._position, axis=0)


def superlu(A: csr_array, order: NDArray[np.int64] | None = None) -> Factor:
    """Sparse LU factorisation without pivoting, of a symmetric positive definite matrix.

    Parameters
    ----------
    A : (N, N) CSR array
    order : (N,) int array, optional
        Order of elimination, see :func:`esfem_core.solvers.dissect`; it makes solving several times
        faster than the orders SuperLU finds itself.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is singular.
    """

    def factorise(A: csr_array) -> Solve:
        try:
            lu: SuperLU = splu(
                A.T,  # CSC, and A is symmetric
                permc_spec="COLAMD" if order is None else "NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise np.linalg.LinAlgError(
                f"the matrix of a linear system is singular: {error}"
            ) from None
        return lambda b: np.asarray(lu.solve(b))

    return _Reordered(A, order, factorise)


def cholmod(A: csr_array, order: NDArray[np.int64] | None = None) -> Factor:
    """Sparse Cholesky factorisation by CHOLMOD, through the package cholespy (extra ``fast``).

    Parameters
    ----------
    A : (N, N) CSR array
        Symmetric positive definite.
    order : (N,) int array, optional
        Numbering to hand the matrix over in; CHOLMOD still finds its own order of elimination.

    Raises
    ------
    ImportError
        If cholespy is not installed.
    """
    from cholespy import CholeskySolverD, MatrixType

    def factorise(A: csr_array) -> Solve:
        entries = A.tocoo()
        row, column = entries.row.astype(np.int32), entries.col.astype(np.int32)
        solver = CholeskySolverD(A.shape[0], row, column, entries.data, MatrixType.COO)

        def solve(b: Array) -> Array:
            x = np.empty_like(b)
            solver.solve(b, x)
            return x

        return solve

    return _Reordered(A, order, factorise)


class DirectSolver:
    """Factorise every matrix."""

    def __init__(self, factorise: Callable[[csr_array], Factor] = superlu) -> None:
        self._factorise = factorise

    def solve(self, A: csr_array, b: Array, guess: Array) -> Array:
        """Solve A x = b; the guess is not used."""
        return self._factorise(A).solve(b.reshape(len(b), -1)).reshape(b.shape)
