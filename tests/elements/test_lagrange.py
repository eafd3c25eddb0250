"""Node order and basis functions of the reference triangle."""

import numpy as np
import pytest

from esfem_core.elements import node_indices, tabulate

DEGREES = range(1, 8)


@pytest.mark.parametrize("degree", DEGREES)
def test_nodes_are_all_the_lattice_points_once(degree):
    nodes = node_indices(degree)
    assert len(nodes) == len(np.unique(nodes, axis=0)) == (degree + 1) * (degree + 2) // 2
    assert (nodes.sum(axis=1) == degree).all()
    assert nodes.min() == 0


def test_vtk_order_of_the_quartic():
    """Corners, edges (0,1), (1,2), (2,0), then the interior triangle."""
    expected = [
        *[(4, 0, 0), (0, 4, 0), (0, 0, 4)],
        *[(3, 1, 0), (2, 2, 0), (1, 3, 0)],
        *[(0, 3, 1), (0, 2, 2), (0, 1, 3)],
        *[(1, 0, 3), (2, 0, 2), (3, 0, 1)],
        *[(2, 1, 1), (1, 2, 1), (1, 1, 2)],
    ]
    assert node_indices(4).tolist() == [list(node) for node in expected]


@pytest.mark.parametrize("degree", DEGREES)
def test_one_at_its_node_and_zero_at_the_others(degree):
    points = node_indices(degree)[:, 1:] / degree
    np.testing.assert_allclose(tabulate(degree, points).values, np.eye(len(points)), atol=1e-14)


@pytest.mark.parametrize("degree", DEGREES)
def test_reproduces_polynomials_and_their_derivatives(degree):
    rng = np.random.default_rng(1)
    points = rng.dirichlet([1, 1, 1], 20)[:, 1:]
    nodes = node_indices(degree)[:, 1:] / degree
    basis = tabulate(degree, points)
    for i in range(degree + 1):
        j = degree - i
        values = nodes[:, 0] ** i * nodes[:, 1] ** j
        xi, eta = points.T
        np.testing.assert_allclose(basis.values @ values, xi**i * eta**j, atol=1e-13)
        d_xi = i * xi ** max(i - 1, 0) * eta**j
        d_eta = j * xi**i * eta ** max(j - 1, 0)
        np.testing.assert_allclose(basis.derivatives @ values, [d_xi, d_eta], atol=3e-12)
