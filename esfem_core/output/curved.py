"""Curved elements for pictures: points between the nodes."""

import numpy as np

from esfem_core.checks import Array, Ints
from esfem_core.elements import SurfaceSpace, flat_triangles, node_indices, tabulate

__all__ = ["refined"]


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
