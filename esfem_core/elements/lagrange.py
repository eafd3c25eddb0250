"""Lagrange elements of degree k on the reference triangle, in VTK's node order."""

from typing import NamedTuple

import numpy as np

from esfem_core.checks import Array, Ints

__all__ = ["MOST_DEGREE", "Basis", "node_indices", "tabulate"]

MOST_DEGREE = 12  # with equispaced nodes, rounding grows with the degree: to 1e-12 here


def node_indices(degree: int) -> Ints:
    """Barycentric indices of the equispaced nodes, in VTK's order.

    The three corners, then the edges (0, 1), (1, 2), (2, 0) with ``degree - 1`` nodes each in
    that direction, then the interior, which is the same pattern for degree - 3.

    Parameters
    ----------
    degree : int
        Polynomial degree, 0 or more (0 is the single interior node of a cubic).

    Returns
    -------
    ((degree+1)(degree+2)/2, 3) int array
        Row i holds ``degree`` times the barycentric coordinates of node i.

    Examples
    --------
    >>> node_indices(2).tolist()
    [[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [0, 1, 1], [1, 0, 1]]
    """
    if degree < 0:
        return np.zeros((0, 3), dtype=np.int64)
    if degree == 0:
        return np.zeros((1, 3), dtype=np.int64)
    corners = degree * np.eye(3, dtype=np.int64)
    steps = np.arange(1, degree)[:, None]
    edges = [
        ((degree - steps) * corners[a] + steps * corners[b]) // degree
        for a, b in ((0, 1), (1, 2), (2, 0))
    ]
    return np.vstack([corners, *edges, node_indices(degree - 3) + 1])


class Basis(NamedTuple):
    """Basis functions and their reference derivatives at given points.

    Attributes
    ----------
    values : (Q, n) float array
        phi_a(q).
    derivatives : (2, Q, n) float array
        d phi_a / d xi and d phi_a / d eta at q.
    """

    values: Array
    derivatives: Array


def tabulate(degree: int, points: Array) -> Basis:
    """Evaluate the Lagrange basis of a degree and its gradient at reference points.

    Silvester's product formula: the function of the node with indices (a, b, c) is
    P_a(l0) P_b(l1) P_c(l2) with P_a(l) = prod_{m < a} (k l - m)/(m + 1) and the barycentric
    coordinates l0 = 1 - xi - eta, l1 = xi, l2 = eta.

    Parameters
    ----------
    degree : int
        Polynomial degree k, 1 or more.
    points : (Q, 2) float array
        Reference coordinates (xi, eta).

    Returns
    -------
    Basis
        Functions in the order of :func:`node_indices`.

    Examples
    --------
    >>> tabulate(1, np.array([[0.25, 0.25]])).values
    array([[0.5 , 0.25, 0.25]])
    """
    xi, eta = np.asarray(points, dtype=float).T
    barycentric = np.stack([1 - xi - eta, xi, eta])
    p = np.ones((degree + 1, 3, len(xi)))
    dp = np.zeros_like(p)
    for m in range(degree):
        factor = (degree * barycentric - m) / (m + 1)
        p[m + 1] = p[m] * factor
        dp[m + 1] = dp[m] * factor + p[m] * degree / (m + 1)
    a, b, c = node_indices(degree).T
    values = p[a, 0] * p[b, 1] * p[c, 2]
    d0 = dp[a, 0] * p[b, 1] * p[c, 2]
    d1 = p[a, 0] * dp[b, 1] * p[c, 2]
    d2 = p[a, 0] * p[b, 1] * dp[c, 2]
    return Basis(values.T, np.stack([(d1 - d0).T, (d2 - d0).T]))
