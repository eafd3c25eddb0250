"""Folds that came little by little: within no step has an element turned over."""

import numpy as np

from esfem_core.checks import Array
from esfem_core.elements import ElementError, SurfaceSpace
from esfem_core.surfaces import normals_of

__all__ = ["fold_of"]

FOLDED = -0.5  # cosine of the normals of neighbours that enclose 60 degrees
MORE = 0.25  # by which it has fallen: an edge that is sharp at the start is no fold


def fold_of(space: SurfaceSpace, x: Array, normal: Array) -> tuple[int, str] | None:
    """An element where the surface lies on itself, and what is wrong there; or none.

    Either the flat triangles of two neighbours lie on each other, and did not so on
    ``space.nodes``; or inside a curved element a normal makes more than a right angle with that of
    its flat triangle, which it does in no element of a new space.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Positions of the nodes.
    normal : (3, T) float array
        Normals of the flat triangles there, of any length but zero.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    >>> x = space.nodes.copy()
    >>> x[0] *= -0.9  # one of the six corners, to the opposite one
    >>> fold_of(space, x, normals_of(x, space.cells).T)
    (0, 'lies on element 3, with 53 degrees between them')
    >>> fold_of(space, space.nodes, normals_of(space.nodes, space.cells).T) is None
    True
    """
    return _between_neighbours(space, normal) or _inside(space, x, normal)


def _between_neighbours(space: SurfaceSpace, normal: Array) -> tuple[int, str] | None:
    cosine = _cosines(space, normal)
    if not cosine.min(initial=1) < FOLDED:
        return None
    start = _cosines(space, normals_of(space.nodes, space.cells[:, :3]).T)
    cosine[cosine > start - MORE] = 1
    pair = int(np.argmin(cosine))
    if not cosine[pair] < FOLDED:
        return None
    element, neighbour = space.neighbours[:, pair].tolist()
    angle = 180 - np.degrees(np.arccos(max(cosine[pair], -1)))
    return element, f"lies on element {neighbour}, with {angle:.0f} degrees between them"


def _inside(space: SurfaceSpace, x: Array, normal: Array) -> tuple[int, str] | None:
    if space.degree == 1:
        return None
    try:
        curved = space.normals(x)
    except ElementError:  # stops a run where it is integrated over
        return None
    lowest = np.einsum("tqi,it->tq", curved, normal).min(axis=1)
    element = int(np.argmin(lowest))
    if lowest[element] >= 0:
        return None
    return element, "has a normal at more than a right angle to that of its flat triangle"


def _cosines(space: SurfaceSpace, normal: Array) -> Array:
    """Of the angles between the normals of neighbouring triangles, (E,)."""
    unit = normal / np.sqrt(np.einsum("it,it->t", normal, normal))
    one, other = space.neighbours
    cosine: Array = np.einsum("ie,ie->e", unit.take(one, axis=1), unit.take(other, axis=1))
    return cosine
