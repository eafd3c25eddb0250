"""Eigenvalues of M^{-1} A on the sphere are n (n + 1), 2 n + 1 times each, to their order."""

import numpy as np
import pytest
from scipy.linalg import eigh

import esfem_core as ec
from esfem_core.study import observed_orders

MOST = 3  # n
EXACT = np.concatenate([[n * (n + 1)] * (2 * n + 1) for n in range(MOST + 1)])


def eigenvalues(refinements, degree):
    space = ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)
    M, A = space.mass_stiffness(space.nodes)
    lowest = [0, len(EXACT) - 1]
    found = eigh(A.toarray(), M.toarray(), eigvals_only=True, subset_by_index=lowest)
    return space.mesh_size(space.nodes), found


@pytest.mark.parametrize(("degree", "order", "most"), [(1, 2, 3), (2, 4, 3), (3, 4, 2)])
def test_eigenvalues_of_the_sphere_have_their_order(degree, order, most):
    """Order 2k from the functions, and k + 1 (for even k one more) from the geometry.

    For k = 3 the two have opposite signs, and at n = 3 they nearly cancel on these meshes.
    """
    spectra = [eigenvalues(refinements, degree) for refinements in (1, 2)]
    for n in range(most + 1):
        own = slice(n**2, (n + 1) ** 2)
        errors = [abs(found - EXACT)[own].max() for _, found in spectra]
        if n == 0:
            assert max(errors) < 1e-11
            continue
        assert errors[1] < 0.1 * EXACT[own][0]
        halved = [1.0, 0.5]  # the parameter of the mesh
        assert observed_orders(halved, errors)[0] == pytest.approx(order, abs=0.35)
