"""Nested dissection: a permutation with less fill than a general-purpose order."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

import esfem_core as ec
from esfem_core.ordering import nested_dissection


@pytest.mark.parametrize(
    "space",
    [
        ec.SurfaceSpace(ec.sphere("octahedron", 5), 1),
        ec.SurfaceSpace(ec.sphere("icosahedron", 4), 2, ec.to_unit_sphere),
        ec.SurfaceSpace(ec.sphere("octahedron", 3), 4, ec.to_unit_sphere),
    ],
    ids=str,
)
def test_less_fill_than_colamd(space):
    M, _ = space.mass_stiffness(space.nodes)
    order = space.elimination_order
    np.testing.assert_array_equal(np.sort(order), np.arange(len(space.nodes)))
    ours = splu(M[order][:, order].T, permc_spec="NATURAL", options={"SymmetricMode": True})
    theirs = splu(M.T, permc_spec="COLAMD", options={"SymmetricMode": True})
    assert ours.nnz < 0.8 * theirs.nnz


def test_nodes_in_one_place_and_few_nodes():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2)
    order = nested_dissection(space.cells, np.zeros_like(space.nodes))
    np.testing.assert_array_equal(np.sort(order), np.arange(len(space.nodes)))
    assert len(ec.SurfaceSpace(ec.sphere("octahedron", 0)).elimination_order) == 6
