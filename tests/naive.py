"""Assembly that is slow and obvious: a second way to compute.

`mass_stiffness` goes element by element as written in [N] 7.2: the differential of the element map
is the 3 x 3 matrix whose third column is the unit normal. It shares only the quadrature rule with
the package: its basis comes from a Vandermonde matrix. Those with weights take the basis and its
gradients from the package, and sum products.
"""

import numpy as np

from esfem_core.elements import tabulate


def monomials(degree, points):
    """Monomials xi^i eta^j up to a degree, and their derivatives, at points (Q, 2)."""
    xi, eta = points.T
    powers = [(i, m - i) for m in range(degree + 1) for i in range(m + 1)]
    values = np.stack([xi**i * eta**j for i, j in powers], axis=1)
    d_xi = np.stack([i * xi ** max(i - 1, 0) * eta**j for i, j in powers], axis=1)
    d_eta = np.stack([j * xi**i * eta ** max(j - 1, 0) for i, j in powers], axis=1)
    return values, d_xi, d_eta


def reference_nodes(degree):
    """Equispaced nodes in VTK's order, walked along the boundary and inwards."""
    corners = [(0, 0), (degree, 0), (0, degree)]
    nodes = list(corners) if degree else [(0, 0)]
    for (a0, a1), (b0, b1) in zip(corners, corners[1:] + corners[:1], strict=True):
        for s in range(1, degree):
            nodes.append((a0 + s * (b0 - a0) // degree, a1 + s * (b1 - a1) // degree))
    if degree >= 3:
        inner = reference_nodes(degree - 3) * (degree - 3) if degree > 3 else [(0, 0)]
        nodes += [(i + 1, j + 1) for i, j in np.rint(inner).astype(int).tolist()]
    return np.array(nodes) / max(degree, 1)


def mass_stiffness(space, x):
    """Dense mass and stiffness matrices."""
    vandermonde = monomials(space.degree, reference_nodes(space.degree))[0]
    coefficients = np.linalg.inv(vandermonde)
    phi, d_xi, d_eta = (m @ coefficients for m in monomials(space.degree, space.rule.points))
    M, A = np.zeros((2, len(x), len(x)))
    for cell in space.cells:
        for q, weight in enumerate(space.rule.weights):
            t1, t2 = d_xi[q] @ x[cell], d_eta[q] @ x[cell]
            normal = np.cross(t1, t2) / np.linalg.norm(np.cross(t1, t2))
            DPhi = np.column_stack([t1, t2, normal])
            gradients = np.linalg.inv(DPhi).T @ np.stack([d_xi[q], d_eta[q], 0 * d_xi[q]])
            dA = weight * abs(np.linalg.det(DPhi))
            M[np.ix_(cell, cell)] += dA * np.outer(phi[q], phi[q])
            A[np.ix_(cell, cell)] += dA * gradients.T @ gradients
    return M, A


def weighted_mass(space, x, weight):
    """Dense mass matrix with a weight (T, Q)."""
    phi = tabulate(space.degree, space.rule.points).values
    density = weight * space.density(x) * space.rule.weights
    return _summed(space, np.einsum("tq,qa,qb->tab", density, phi, phi))


def weighted_stiffness(space, x, tensor):
    """Dense stiffness matrix with a tensor (T, Q, 3, 3)."""
    gradients, density = space.basis_gradients(x), space.density(x) * space.rule.weights
    return _summed(
        space,
        np.einsum("tq,tqai,tqij,tqbj->tab", density, gradients, tensor, gradients, optimize=True),
    )


def gradient_load(space, x, field):
    """Integrals of a field (T, Q, 3) and the gradients of the basis functions."""
    gradients, density = space.basis_gradients(x), space.density(x) * space.rule.weights
    entries = np.einsum("tq,tqi,tqai->ta", density, field, gradients)
    return np.bincount(space.cells.ravel(), entries.ravel(), len(x))


def _summed(space, entries):
    """The matrix of element matrices (T, n, n)."""
    matrix = np.zeros((len(space.nodes), len(space.nodes)))
    np.add.at(matrix, (space.cells[:, :, None], space.cells[:, None, :]), entries)
    return matrix
