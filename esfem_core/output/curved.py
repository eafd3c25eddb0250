"""Curved elements for pictures: points between the nodes, and normals at them."""

import numpy as np

from esfem_core.checks import Array, Ints
from esfem_core.elements import SurfaceSpace, flat_triangles, node_indices, tabulate

__all__ = ["nodal_normals", "refined"]


def refined(space: SurfaceSpace, pieces: int) -> tuple[Array, Ints]:
    """Points that divide each side of each element into equal pieces, and the triangles between.

    Parameters
    ----------
    space : SurfaceSpace
    pieces : int

    Returns
    -------
    basis : (q, n) float array
        Values of an element's n basis functions at its q points: ``basis @ w[space.cells]`` are
        those of a function w, one row of q for each element.
    triangles : (T pieces², 3) int array
        Numbers of points, those of all elements in succession.

    Examples
    --------
    >>> import esfem_core as ec
    >>> basis, triangles = refined(ec.SurfaceSpace(ec.sphere("octahedron", 0), 2), 3)
    >>> basis.shape, triangles.shape
    ((10, 6), (72, 3))
    """
    barycentric = node_indices(pieces) / pieces
    basis = tabulate(space.degree, barycentric[:, 1:]).values
    points = np.arange(len(space.cells) * len(basis)).reshape(-1, len(basis))
    return basis, flat_triangles(points, pieces)


def nodal_normals(space: SurfaceSpace, x: Array) -> Array:
    """Unit outward normals at the nodes: those of the elements around, averaged by area density.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array

    Returns
    -------
    (N, 3) float array

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 3, ec.to_unit_sphere)
    >>> bool(np.abs(nodal_normals(space, space.nodes) - space.nodes).max() < 0.01)
    True
    """
    points = node_indices(space.degree)[:, 1:] / space.degree
    derivatives = tabulate(space.degree, points).derivatives
    along, across = (d @ x[space.cells] for d in derivatives)  # (T, n, 3)
    around = np.cross(along, across).reshape(-1, 3)
    cells = space.cells.ravel()
    normal = np.column_stack([np.bincount(cells, component) for component in around.T])
    unit: Array = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return unit
