"""The Ritz projection between an exact surface and a discrete one ([LMV] Section 5, Remark 1).

Integrals over the exact surface Γ are taken over a discrete surface of higher degree, on the same
triangulation, with all its nodes on Γ. If its nodes are closest points, then functions that agree
in the reference triangle agree there up to the lift of [LMV] (5.4), and an error of higher order.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from esfem_core.checks import Array, finite_array, object_of
from esfem_core.elements import SurfaceSpace, node_indices, tabulate
from esfem_core.solvers import superlu

__all__ = ["prolongation", "ritz_projection"]


def prolongation(space: SurfaceSpace, fine: SurfaceSpace) -> csr_array:
    """Matrix that takes nodal values of a finite element function to those in a larger space.

    Parameters
    ----------
    space, fine : SurfaceSpace
        Of degrees k <= m on one triangulation. In the reference triangle the function stays the
        same.

    Returns
    -------
    (N_fine, N) CSR array
        Its transpose takes loads of the larger space to those of the smaller.

    Raises
    ------
    TypeError, ValueError
        If the triangulations differ, or `fine` has the lower degree.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 2)
    >>> linear, quartic = ec.SurfaceSpace(tri), ec.SurfaceSpace(tri, 4)
    >>> bool(np.allclose(prolongation(linear, quartic) @ linear.nodes, quartic.nodes))
    True
    """
    object_of("space", space, SurfaceSpace)
    object_of("fine", fine, SurfaceSpace)
    if fine.degree < space.degree:
        raise ValueError(f"fine must have degree {space.degree} or more, but has {fine.degree}")
    if not np.array_equal(space.cells[:, :3], fine.cells[:, :3]):
        raise ValueError("fine must be on the triangulation of space, but is on another")
    values = tabulate(space.degree, node_indices(fine.degree)[:, 1:] / fine.degree).values
    nodes, first = np.unique(fine.cells, return_index=True)  # each from one of its elements
    cell, local = np.divmod(first, fine.cells.shape[1])
    rows = np.repeat(nodes, values.shape[1])
    entries = (values[local].ravel(), (rows, space.cells[cell].ravel()))
    matrix = csr_array(coo_array(entries, shape=(len(fine.nodes), len(space.nodes))))
    matrix.eliminate_zeros()
    return matrix


def ritz_projection(
    space: SurfaceSpace, x: ArrayLike, fine: SurfaceSpace, y: ArrayLike, z: ArrayLike
) -> Array:
    r"""Finite element function on Γ_h[x] with the stiffness and the integral of a function on Γ.

    For all :math:`\varphi_h \in S_h[x]` and their lifts :math:`\varphi_h^l`,

    .. math::

        \int_{\Gamma_h} \nabla P_h z \cdot \nabla \varphi_h
            &= \int_\Gamma \nabla z \cdot \nabla \varphi_h^l \\
        \int_{\Gamma_h} P_h z &= \int_\Gamma z

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
    fine : SurfaceSpace
        Of higher degree on the same triangulation.
    y : (N_fine, 3) float array
        Its nodes on Γ: points closest to ``prolongation(space, fine) @ x``.
    z : (N_fine,) float array
        Values of the function there.

    Returns
    -------
    (N,) float array
        Nodal values of P_h z.

    Raises
    ------
    TypeError, ValueError
        If the two spaces do not belong together, the surface has several components, on each of
        which a constant is free, or an array has the wrong shape or is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 3)
    >>> space, fine = ec.SurfaceSpace(tri), ec.SurfaceSpace(tri, 4, ec.to_unit_sphere)
    >>> P = ritz_projection(space, space.nodes, fine, fine.nodes, fine.nodes[:, 0])
    >>> print(f"{np.abs(P - space.nodes[:, 0]).max():.3f}")
    0.005
    """
    up = prolongation(space, fine)
    parts = connected_components(space.pattern, directed=False)[0]
    if parts > 1:
        raise ValueError(f"space must be on a connected surface, but has {parts} components")
    x = finite_array("x", x, space.nodes.shape)
    y = finite_array("y", y, fine.nodes.shape)
    z = finite_array("z", z, (len(fine.nodes),))
    M, A = space.mass_stiffness(x)
    M_exact, A_exact = fine.mass_stiffness(y)
    # A is zero on the constants, and so is the load. One more entry on the diagonal makes the
    # matrix definite and leaves the solution that vanishes at this node.
    definite = A.copy()
    definite[0, 0] += A[0, 0]
    w = superlu(definite, space.elimination_order).solve(up.T @ (A_exact @ z))
    ones = np.ones(len(w))
    shift = ((M_exact @ z).sum() - (M @ w).sum()) / (ones @ (M @ ones))
    return np.asarray(w + shift)
