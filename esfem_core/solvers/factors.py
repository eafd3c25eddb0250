"""Factorisations of sparse symmetric positive definite matrices, by libraries."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import SuperLU, splu

from esfem_core.checks import Array, Ints, function, integer_array, package
from esfem_core.solvers.systems import (
    check_factor,
    check_halves,
    require_finite,
    require_small_residual,
    right_hand_side,
    square,
)

__all__ = ["DirectSolver", "Factor", "Solver", "cholmod", "superlu"]


class Factor(Protocol):
    """A factorised matrix."""

    def solve(self, b: Array) -> Array:
        """Solve for one column, (N,), or for the columns of b, (N, m)."""


class Solver(Protocol):
    """What :func:`esfem_core.evolve` asks of a linear solver.

    It must leave `A`, `b` and `guess` as they are: whether x solves the system is judged with them
    afterwards, and a solver that has changed them in place is judged by another system.
    """

    def solve(self, A: csr_array, b: Array, guess: Array) -> Array:
        """Solve A x = b, for one or several columns b, starting from a guess if of use."""


class _Reordered:
    """The factor of a library, with its unknowns in another order."""

    def __init__(self, name: str, order: Ints, solve: Callable[[Array], Array], stored: str = ""):
        self._name, self._order, self._solve, self._stored = name, order, solve, stored
        self._position = np.argsort(order)

    @property
    def unknowns(self) -> int:
        return len(self._order)

    def solve(self, b: Array) -> Array:
        b = right_hand_side(len(self._order), b)
        if b.size == 0:  # CHOLMOD would end the interpreter
            return np.zeros(b.shape)
        return self._solve(b.take(self._order, axis=0)).take(self._position, axis=0)

    def __repr__(self) -> str:
        return f"{self._name}(unknowns={len(self._order)}{self._stored})"


def _elimination_order(A: csr_array, order: Ints | None) -> Ints:
    """The order given, or that of A, which is refused if it cannot be factorised."""
    n = square(A)
    if np.can_cast(A.dtype, np.float32) or not np.can_cast(A.dtype, np.float64):
        raise TypeError(
            f"A must hold numbers of double precision, got {A.dtype}: A.astype(float) has them"
        )
    require_finite(A)
    check_halves(A)
    if order is None:
        return np.arange(n)
    order = integer_array("order", order, ("N",))
    if order.shape != (n,) or not np.array_equal(np.sort(order), np.arange(n)):
        raise ValueError(
            f"order must hold each of the numbers 0, ..., {n - 1} of unknowns once, but does not"
        )
    return order


def superlu(A: csr_array, order: Ints | None = None) -> Factor:
    """Sparse LU factorisation without pivoting, of a symmetric positive definite matrix.

    Parameters
    ----------
    A : (N, N) CSR array
    order : (N,) int array, optional
        Order of elimination, see :func:`~esfem_core.solvers.dissection.dissect`; it makes solving
        several times faster than the orders SuperLU finds itself.

    Returns
    -------
    Factor

    Raises
    ------
    TypeError
        If `A` is not in CSR format, or its entries are not real and of double precision.
    ValueError
        If `A` is not square, not symmetric or has no unknown, or `order` is no order of its
        unknowns.
    numpy.linalg.LinAlgError
        If `A` is not finite, or a pivot is zero: the matrix is singular, or as good as that in
        rounded numbers.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> factor = superlu(M + A, space.elimination_order)
    >>> factor
    SuperLU(unknowns=1026, entries per unknown=63.8, memory=0.8 MB)
    >>> b = space.nodes.prod(axis=1)
    >>> bool(np.allclose((M + A) @ factor.solve(b), b, rtol=0, atol=1e-14))
    True
    """
    new_order = _elimination_order(A, order)
    try:
        lu: SuperLU = splu(
            A[new_order][:, new_order].T,  # CSC, and A is symmetric
            permc_spec="COLAMD" if order is None else "NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise np.linalg.LinAlgError(
            "the matrix of a linear system must be positive definite, but has a pivot that is zero "
            f"or lost in rounding: {error}"
        ) from None
    n_bytes = lu.nnz * 12  # about: a float and a row number for each entry of L and of U
    stored = f", entries per unknown={lu.nnz / A.shape[0]:.1f}, memory={n_bytes / 1e6:.1f} MB"
    return _Reordered("SuperLU", new_order, lambda b: np.asarray(lu.solve(b)), stored)


def cholmod(A: csr_array, order: Ints | None = None) -> Factor:
    """Sparse Cholesky factorisation by CHOLMOD, through the package cholespy (extra ``fast``).

    Parameters
    ----------
    A : (N, N) CSR array
        Symmetric positive definite.
    order : (N,) int array, optional
        Numbering to hand the matrix over in; CHOLMOD still finds its own order of elimination.

    Returns
    -------
    Factor
        It does not say how many entries it stores: cholespy keeps that to itself.

    Raises
    ------
    ImportError
        If cholespy is not installed.
    TypeError
        If `A` is not in CSR format, or its entries are not real and of double precision.
    ValueError
        If `A` is not square, not symmetric or has no unknown, or `order` is no order of its
        unknowns.
    numpy.linalg.LinAlgError
        If `A` is not finite or not positive definite.
    """
    cholespy = package("CHOLMOD needs cholespy", "cholespy", "fast")
    new_order = _elimination_order(A, order)
    entries = A[new_order][:, new_order].tocoo()
    row, column = entries.row.astype(np.int32), entries.col.astype(np.int32)
    try:
        solver = cholespy.CholeskySolverD(
            A.shape[0], row, column, entries.data, cholespy.MatrixType.COO
        )
    except (RuntimeError, ValueError) as error:
        raise np.linalg.LinAlgError(
            "the matrix of a linear system must be positive definite, but for CHOLMOD it is not, "
            f"which with very flat elements may be rounding: {error}"
        ) from error

    def solve(b: Array) -> Array:
        x = np.empty_like(b)
        solver.solve(b, x)
        return x

    return _Reordered("CHOLMOD", new_order, solve)


class DirectSolver:
    """Factorise every matrix.

    Parameters
    ----------
    factorise : callable
        From a matrix to its :class:`~esfem_core.solvers.factors.Factor`.

    Attributes
    ----------
    factorisations : int
        Their number since the solver was made.

    Raises
    ------
    TypeError
        If `factorise` is no function.

    Examples
    --------
    >>> from scipy.sparse import diags_array
    >>> solver = DirectSolver()
    >>> A = diags_array([[-1.0] * 4, [3.0] * 5, [-1.0] * 4], offsets=[-1, 0, 1], format="csr")
    >>> b = np.arange(5.0)
    >>> bool(np.allclose(A @ solver.solve(A, b, b), b))
    True
    >>> solver
    DirectSolver(factorise=superlu, factorisations=1)
    """

    def __init__(self, factorise: Callable[[csr_array], Factor] = superlu) -> None:
        self.factorisations = 0
        self._factorise = function("factorise", factorise, "from a matrix to its Factor")

    def solve(self, A: csr_array, b: Array, guess: Array) -> Array:
        """Solve A x = b; the guess is not used.

        Parameters
        ----------
        A : (N, N) CSR array
            Symmetric positive definite.
        b : (N,) or (N, m) float array
        guess : array like `b`

        Returns
        -------
        array like `b`

        Raises
        ------
        TypeError
            If `A` is not in CSR format, its entries or `b` are not real, or `factorise` returns no
            Factor.
        ValueError
            If `A` is not square, `b` does not fit it, or a factorisation of this package is to
            take a matrix that is not symmetric.
        numpy.linalg.LinAlgError
            If the matrix is singular, or not symmetric and positive definite, and the residual of
            the answer shows it.
        FloatingPointError
            If `b` is not finite.
        """
        b = right_hand_side(square(A), b)
        factor = self._factorise(A)
        check_factor(factor)
        self.factorisations += 1
        x: Array = factor.solve(b.reshape(len(b), -1)).reshape(b.shape)
        require_small_residual(A, b, x)
        return x

    def __repr__(self) -> str:
        function = self._factorise
        while isinstance(function, partial):
            function = function.func
        name = getattr(function, "__name__", repr(function))
        return f"DirectSolver(factorise={name}, factorisations={self.factorisations})"
