"""Graphs of cubic polynomials that are fitted to the vertices around each vertex.

Seen from vertex i with a mean normal n_i of its triangles, vertex j has coordinates u_j along the
tangent plane and z_j along n_i. The polynomial f_i, zero at the vertex itself, minimises

    sum_j w_ij (f_i(u_j) - z_j)^2.

For points of a smooth surface f_i differs from it by O(h^4), however roughly n_i is known: over a
plane that is tilted the surface is still a smooth graph.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from esfem_core.checks import Array, Ints

__all__ = ["Graphs", "fit_graphs"]

EXPONENTS = np.array([[1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3]])
DEGREES = EXPONENTS.sum(axis=1)
# Roots of binomial coefficients: with them as factors, turning (u, v) is an orthogonal map of the
# monomials of each degree, so that the ridge below does not depend on the choice of the axes.
ROOTS = np.sqrt([1, 1, 1, 2, 1, 1, 3, 3, 1])

RINGS, MOST_RINGS = 2, 4
HUB = 200  # links of a point from which on no second ring goes through it: it would be everything
ENOUGH = 14  # points of a fit: further rings are taken until there are as many
NEEDED = np.array([0, 5, 12])  # points for terms of degree 1, 2, 3
RIDGE = np.array([1e-9, 1e-7, 1e-5])  # on terms of degree 1, 2, 3: decides where points do not
WIDTH = 0.2  # squared length in which weights fall to a quarter, in mean squared distances


class Graphs(NamedTuple):
    """Graphs z = f(u, v), each in axes of its own around an origin where f = 0.

    Attributes
    ----------
    origin : (F, 3) float array
    axes : (F, 3, 3) float array
        Rows: two tangents and the normal.
    coefficients : (F, 9) float array
        Of u, v, u², uv, v², u³, u²v, uv², v³.
    """

    origin: Array
    axes: Array
    coefficients: Array

    @property
    def normals(self) -> Array:
        """Directions of z, (F, 3)."""
        return self.axes[:, 2]

    def heights(self, graph: Ints, points: Array) -> Array:
        """f(u, v) - z of points (..., 3) as seen from graphs (...): how far they are below."""
        u, v, z = self._local(graph, points)
        return np.asarray((self.coefficients[graph] * _monomials(u, v)).sum(axis=-1) - z)

    def slopes(self, graph: Ints, points: Array) -> Array:
        """Normals (-f_u, -f_v, 1) of the graphs at the same points, (..., 3), not of length 1."""
        u, v, _ = self._local(graph, points)
        c = self.coefficients[graph]
        f_u, f_v = _first(c, u, v)
        local = np.stack([-f_u, -f_v, np.ones_like(u)], axis=-1)
        return np.asarray((local[..., None, :] @ self.axes[graph])[..., 0, :])

    def _local(self, graph: Ints, points: Array) -> tuple[Array, Array, Array]:
        relative = points - self.origin[graph]
        u, v, z = np.moveaxis((self.axes[graph] @ relative[..., None])[..., 0], -1, 0)
        return u, v, z


def fit_graphs(points: Array, normals: Array, triangles: Ints) -> Graphs:
    """Fit a graph through each point of a triangulation to its neighbours.

    Two rings of neighbours, and up to four where there are few of them, with weights that fall
    with the distance and with the angle between normals. Where there are less than 12 points
    there are no cubic terms, with less than 5 no quadratic ones.

    Parameters
    ----------
    points : (F, 3) float array
        May repeat: points of two sides of a crease are different ones at the same place.
    normals : (F, 3) float array
        Rough ones, of length 1: the directions over which the graphs are graphs.
    triangles : (T, 3) int array
        Numbers of points.

    Returns
    -------
    Graphs

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("octahedron", 3)
    >>> graphs = fit_graphs(tri.vertices, tri.vertices, tri.faces)
    >>> above = np.array([[0.0, 0.1, 1.1]])
    >>> print(f"{graphs.heights(np.array([2]), above)[0]:.4f} {np.sqrt(1 - 0.1**2) - 1.1:.4f}")
    -0.1053 -0.1050
    """
    near = _neighbours(triangles, len(points))
    axes = _axes(normals)
    count = np.diff(near.indptr)
    row = np.repeat(np.arange(len(points)), count)
    relative = points[near.indices] - points[row]
    u, v, z = np.einsum("mij,mj->im", axes[row], relative)

    square = (relative * relative).sum(axis=1)
    mean = np.bincount(row, square, len(points)) / np.maximum(count, 1)
    agree = np.maximum((normals[row] * normals[near.indices]).sum(axis=1), 0)
    weight = agree / (1 + square / (WIDTH * mean[row])) ** 2
    weight /= np.maximum(np.bincount(row, weight, len(points)), 1e-300)[row]

    # In units of the mean distance; each graph's normal equations, with a ridge.
    scale = np.sqrt(mean)
    basis = ROOTS * _monomials(u / scale[row], v / scale[row])
    columns = [*basis.T, z / scale[row]]
    total = np.empty((len(points), len(basis.T), len(columns)))
    for i, left in enumerate(weight * basis.T):
        for j in range(i, len(columns)):
            total[:, i, j] = np.bincount(row, left * columns[j], len(points))
            if j < len(basis.T):
                total[:, j, i] = total[:, i, j]
    used = np.bincount(row, agree > 0, len(points))
    ridge = np.where(used[:, None] >= NEEDED, RIDGE, 1e6)[:, DEGREES - 1]
    system = total[..., :-1] + ridge[:, :, None] * np.eye(len(DEGREES))
    found = np.linalg.solve(system, total[..., -1:])[..., 0]
    return Graphs(points, axes, found * ROOTS * scale[:, None] ** (1 - DEGREES))


def _monomials(u: Array, v: Array) -> Array:
    return np.stack([u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3], axis=-1)


def _first(c: Array, u: Array, v: Array) -> tuple[Array, Array]:
    c1, c2, c20, c11, c02, c30, c21, c12, c03 = np.moveaxis(c, -1, 0)
    return (
        c1 + 2 * c20 * u + c11 * v + 3 * c30 * u * u + 2 * c21 * u * v + c12 * v * v,
        c2 + c11 * u + 2 * c02 * v + c21 * u * u + 2 * c12 * u * v + 3 * c03 * v * v,
    )


def _axes(normals: Array) -> Array:
    """Two tangents and the normal, (F, 3, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first), normals], axis=1)


def _neighbours(triangles: Ints, n: int) -> csr_array:
    """Which points the fit of each point uses, (n, n): rows of a sparse matrix."""
    i, j = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    rows, columns = np.concatenate([i, j]), np.concatenate([j, i])
    ring = coo_array((np.ones(len(rows), dtype=np.int64), (rows, columns)), (n, n)).tocsr()
    through = csr_array(ring.multiply(np.diff(ring.indptr) < HUB))
    through.eliminate_zeros()
    reached = _others(ring + through @ ring)
    for _ in range(RINGS, MOST_RINGS):
        few = np.diff(reached.indptr) < ENOUGH
        if not few.any():
            break
        further = csr_array(through.multiply(few[:, None]))
        reached = _others(reached + further @ reached)
    return reached


def _others(links: csr_array) -> csr_array:
    """Ones where there is a link to another point."""
    row, column = links.nonzero()
    keep = row != column
    ones = np.ones(keep.sum(), dtype=np.int64)
    return csr_array((ones, (row[keep], column[keep])), links.shape)
