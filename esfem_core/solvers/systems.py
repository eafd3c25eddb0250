"""What a linear system A x = b is made of, checked where it comes in."""

from numpy.typing import ArrayLike
from scipy.sparse import csr_array, issparse

from esfem_core.checks import Array, real_array

__all__ = ["right_hand_side", "square"]


def square(A: csr_array) -> int:
    """Number of unknowns of a sparse matrix.

    Raises
    ------
    TypeError
        If it is not in CSR format.
    ValueError
        If it is not square.

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
    return int(A.shape[0])


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
