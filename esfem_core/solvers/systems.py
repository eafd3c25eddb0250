"""What a linear system A x = b is made of, checked where it comes in."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, issparse

from esfem_core.checks import Array, real_array, shown

__all__ = [
    "check_factor",
    "check_halves",
    "require_finite",
    "require_small_residual",
    "require_solved",
    "right_hand_side",
    "square",
]

SYMMETRIC = 1e-9  # of the largest entry, by which one and its mirror image may differ
RESIDUAL = 1e-9  # relative to what rounding is relative to; a good factorisation gives 1e-15
LEFT = 0.1  # share of b that a residual leaves where x has not one right digit
TINY = np.finfo(float).tiny  # numbers below it have fewer digits
NOISE = 1e-10  # mean of a residual where b may be zero but for rounding: that is in no range


def square(A: csr_array) -> int:
    """Number of unknowns of a sparse matrix.

    Raises
    ------
    TypeError
        If it is not in CSR format, or its entries are not real numbers.
    ValueError
        If it is not square, or has none.

    Examples
    --------
    >>> square(csr_array((5, 4)))
    Traceback (most recent call last):
        ...
    ValueError: A must be square, got shape (5, 4)
    """
    if not issparse(A) or A.format != "csr":
        raise TypeError(f"A must be a sparse matrix in CSR format, got a {type(A).__name__}")
    if len(A.shape) != 2 or A.shape[0] != A.shape[1]:
        raise ValueError(f"A must be square, got shape {A.shape}")
    if A.shape[0] == 0:
        raise ValueError("A must have at least one unknown, got shape (0, 0)")
    if A.dtype.kind not in "fiu":
        raise TypeError(f"A must hold real numbers, got {A.dtype}")
    return int(A.shape[0])


def require_finite(A: csr_array) -> None:
    """Refuse a matrix that is not finite: CHOLMOD would solve with it to NaN.

    Examples
    --------
    >>> require_finite(csr_array([[np.nan]]))
    Traceback (most recent call last):
        ...
    numpy.linalg.LinAlgError: A must be finite, but has entries that are not
    """
    if not np.isfinite(A.data).all():
        raise np.linalg.LinAlgError("A must be finite, but has entries that are not")


def check_halves(A: csr_array) -> None:
    """Refuse a matrix whose halves differ: factorisations that read one would solve another system.

    Examples
    --------
    >>> check_halves(csr_array([[1.0, 0.5], [0.0, 1.0]]))
    Traceback (most recent call last):
        ...
    ValueError: A must be symmetric and positive definite, but is not symmetric
    """
    turned = A.tocsc()  # its columns are the rows of the transpose
    parts = ("indptr", "indices", "data")
    if all(np.array_equal(getattr(A, part), getattr(turned, part)) for part in parts):
        return  # symmetric to the last bit, as matrices of elements are
    with np.errstate(all="ignore"):
        largest = np.abs(A.data).max(initial=0.0)
        difference = np.abs((A - A.T).data).max(initial=0.0)
    if difference > SYMMETRIC * largest:
        raise ValueError("A must be symmetric and positive definite, but is not symmetric")


def check_factor(factor: object) -> None:
    """Refuse what a function that factorises has returned and cannot solve.

    Examples
    --------
    >>> check_factor(None)
    Traceback (most recent call last):
        ...
    TypeError: factorise must return a Factor, an object with a method solve(b), got None
    """
    if isinstance(factor, type) or not callable(getattr(factor, "solve", None)):
        raise TypeError(
            f"factorise must return a Factor, an object with a method solve(b), got {shown(factor)}"
        )


def right_hand_side(n: int, b: ArrayLike) -> Array:
    """Right-hand sides of n equations: one column, (n,), or several, (n, m), as floats.

    Raises
    ------
    TypeError
        If they are not real numbers.
    ValueError
        If the shape is another.

    Examples
    --------
    >>> right_hand_side(5, [1.0, 2.0])
    Traceback (most recent call last):
        ...
    ValueError: b must have shape (5,) or (5, m) beside A of shape (5, 5), got (2,)
    """
    columns = real_array("b", b, ("...",))
    if columns.ndim not in (1, 2) or len(columns) != n:
        raise ValueError(
            f"b must have shape ({n},) or ({n}, m) beside A of shape {(n, n)}, got {columns.shape}"
        )
    return columns


def require_small_residual(A: csr_array, b: Array, x: Array) -> None:
    """Refuse x that does not solve A x = b to many digits.

    ``max|b - A x|`` is compared with ``|A| max|x| + max|b|``, where ``|A|`` is the largest sum of
    absolute values in a row: stable factorisations bring this quotient to 1e-15, also where A is
    ill-conditioned. Where A is singular it is no larger, since x is; see :func:`require_solved`.

    Raises
    ------
    FloatingPointError
        If b is not finite.
    numpy.linalg.LinAlgError
        If the quotient is above 1e-9, or more than a tenth of b is left.

    Examples
    --------
    >>> require_small_residual(csr_array(np.eye(2)), np.ones(2), np.array([1.0, 1.1]))
    Traceback (most recent call last):
        ...
    numpy.linalg.LinAlgError: no solution: x has a relative residual of 0.048 (allowed: 1e-09); A...
    """
    if not np.isfinite(b).all():
        raise FloatingPointError(
            "b must be finite, but the right-hand side of a linear system is not finite"
        )
    with np.errstate(all="ignore"):
        sizes = np.add.reduceat(np.abs(A.data), A.indptr[:-1]) if A.nnz else np.zeros(1)
        allowed = sizes.max(initial=0.0) * np.abs(x).max(initial=0.0) + np.abs(b).max(initial=0.0)
        r = b - A @ x
        found = np.abs(r).max(initial=0.0)
        share = 0.0 if found <= TINY else found / allowed  # NaN is refused
    if not share <= RESIDUAL:
        raise np.linalg.LinAlgError(
            f"no solution: x has a relative residual of {share:.2g} (allowed: {RESIDUAL:g}); A "
            "must be symmetric and positive definite, but is not, or its condition number is too "
            "large for double precision"
        )
    require_solved(b, r)


def require_solved(b: Array, r: Array) -> None:
    """Refuse residuals that leave more than a tenth of their right-hand sides.

    If A is singular and b not in its range, x becomes so large that any residual is one of
    rounding: relative to A times x it is small. Sums over all entries are compared, since a needle
    of an element makes a few entries of A large and the residual there, but costs x no digit.

    Parameters
    ----------
    b, r : (N,) or (N, m) float arrays
        Right-hand sides and what is left of them, b - A x.

    Raises
    ------
    numpy.linalg.LinAlgError
        If in some column more than a tenth is left, and that is more than rounding of a right-hand
        side that is meant to be zero.

    Examples
    --------
    >>> A = csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> b, x = np.ones(2), np.array([1e16, 1e16 + 2])
    >>> require_solved(b, b - A @ x)
    Traceback (most recent call last):
        ...
    numpy.linalg.LinAlgError: no solution: x leaves 2 of b, in the mean over its entries (allowed...
    """
    with np.errstate(all="ignore"):  # numbers beyond 1e308 are refused elsewhere
        whole, left = np.abs(b).sum(axis=0), np.abs(r).sum(axis=0)
        lost = (whole > 0) & (left > LEFT * whole + NOISE * len(b))
    if lost.any():
        share = float((left[lost] / whole[lost]).max())
        raise np.linalg.LinAlgError(
            f"no solution: x leaves {share:.2g} of b, in the mean over its entries (allowed: "
            f"{LEFT:g}); A must be positive definite, but may be singular to rounding, with b out "
            "of its range: if it takes constants to zero, as a stiffness matrix alone does, "
            "add a multiple of the mass matrix to it"
        )
