"""Sums of element entries: whatever the chunks, what a COO matrix adds up."""

import numpy as np
import pytest
from scipy.sparse import coo_array

import esfem_core as ec
from esfem_core.elements.scatter import NodalSum, SparsePattern

CELLS = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere).cells
N = int(CELLS.max()) + 1
PAIRS = np.stack(np.triu_indices(6))


@pytest.mark.parametrize("length", [1, 7, 100, 10**6])
def test_matrices(length):
    slices = [slice(i, min(i + length, len(CELLS))) for i in range(0, len(CELLS), length)]
    entries = np.random.default_rng(0).standard_normal((2, PAIRS.shape[1], len(CELLS)))
    pattern = SparsePattern(CELLS, PAIRS, N, slices)
    matrices = pattern.matrices(lambda i: tuple(entries[:, :, slices[i]]), 2)
    assert len(matrices) == 2
    a, b = PAIRS
    off = a != b
    row, column = CELLS.T[np.r_[a, b[off]]].ravel(), CELLS.T[np.r_[b, a[off]]].ravel()
    for matrix, values in zip(matrices, entries, strict=True):
        data = np.concatenate([values, values[off]]).ravel()
        expected = coo_array((data, (row, column)), shape=(N, N)).tocsr()
        assert matrix.nnz == expected.nnz
        assert abs(matrix - expected).max() < 1e-14
        assert abs(matrix - matrix.T).max() == 0


def test_another_number_of_matrices_than_was_said_is_refused():
    pattern = SparsePattern(CELLS, PAIRS, N, [slice(0, len(CELLS))])
    entries = (np.ones((21, len(CELLS))), np.ones((21, len(CELLS))))
    for count, message in [(1, "longer"), (3, "shorter")]:
        with pytest.raises(ValueError, match=message):
            pattern.matrices(lambda _: entries, count)
    assert pattern.matrices(lambda _: (), 0) == []


def test_nodal_vectors():
    entries = np.random.default_rng(0).standard_normal((2, 6, len(CELLS)))
    sums = NodalSum(CELLS, N)(entries)
    assert sums.shape == (N, 2)
    for column, values in zip(sums.T, entries, strict=True):
        np.testing.assert_allclose(column, np.bincount(CELLS.T.ravel(), values.ravel()), atol=1e-14)
