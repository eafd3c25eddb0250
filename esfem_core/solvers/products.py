"""Sparse matrices times vectors, on several threads."""

from itertools import product

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array
from esfem_core.solvers.threads import pieces, side_by_side, thread_count

__all__ = ["times", "times_rows"]

ROWS = 2**15  # of a matrix that one thread multiplies at a time
LEAST = 600_000  # products of entries that several threads make


def times(A: csr_array, x: Array) -> Array:
    """A @ x.

    Parameters
    ----------
    A : (n, N) CSR array
    x : (N,) or (N, m) float array

    Returns
    -------
    (n,) or (n, m) float array

    Examples
    --------
    >>> A = csr_array([[1.0, 2.0], [0.0, 3.0]])
    >>> times(A, np.array([[1.0, 0.0], [0.0, 1.0]]))
    array([[1., 2.],
           [0., 3.]])
    """
    if not _worth(A, x):
        product: Array = A @ x
        return product
    columns = times_rows(A, np.ascontiguousarray(x.reshape(len(x), -1).T)).T
    return np.ascontiguousarray(columns).reshape(-1, *x.shape[1:])


def times_rows(A: csr_array, x: Array) -> Array:
    """A times each row of x, (m, N), as rows, (m, n).

    Examples
    --------
    >>> times_rows(csr_array([[1.0, 2.0], [0.0, 3.0]]), np.array([[0.0, 1.0]]))
    array([[2., 3.]])
    """
    products = np.empty((len(x), A.shape[0]))
    if not _worth(A, x):
        for i, row in enumerate(x):
            products[i] = A @ row
        return products
    # The sums of rows do not depend on how many are in a part.
    parts = [(rows, _some_rows(A, rows)) for rows in pieces(A.shape[0], ROWS)]

    def multiply(place: tuple[int, tuple[slice, csr_array]]) -> None:
        i, (rows, part) = place
        products[i, rows] = part @ x[i]

    side_by_side(multiply, product(range(len(x)), parts))
    return products


def _worth(A: csr_array, x: Array) -> bool:
    """Whether the product with the rows or columns of x is long enough to be shared."""
    return x.size // A.shape[1] * A.nnz > LEAST and thread_count() > 1


def _some_rows(A: csr_array, rows: slice) -> csr_array:
    """Rows of A, whose entries are not copied."""
    ends = A.indptr[rows.start : rows.stop + 1]
    entries = slice(ends[0], ends[-1])
    part = csr_array((len(ends) - 1, A.shape[1]))
    part.data, part.indices, part.indptr = A.data[entries], A.indices[entries], ends - ends[0]
    return part
