"""Triangles that lie on each other, as where a polygon that is not convex was cut into a fan.

Readers of files cut a polygon into triangles around its first corner. Of one that is not convex
some of them may face the other way and cover others: the volume is right, the area is not. The
letter L, cut around its corner 1::

    5---4       triangle       area
    |   |       (1, 2, 3)       0.5
    | . 3---2   (1, 3, 4)      -0.5   faces the other way, and lies on its two neighbours
    |       |   (1, 4, 5)       1
    0-------1   (1, 5, 0)       2     3 in all, but 4 without the signs

An edge such as that from 1 to 3 is *folded*: the normals of its triangles are opposite. All
triangles around one of its ends that lie in the same plane are replaced by those of the smallest
area with the same rim.
"""

import numpy as np

from esfem_core.checks import Array, Ints
from esfem_core.surfaces.lids import lid_of, rims
from esfem_core.surfaces.orientation import Sides, directed, normals_of, sides_of

__all__ = ["folded", "unfolded"]

OPPOSITE = 1 - 1e-9  # smallest minus cosine of the angle between opposite normals
THIN = 1e-3  # twice the area over the longest side squared, below which a normal is rounding
SWEEPS = 10  # over the folded edges


def folded(vertices: Array, faces: Ints, sides: Sides) -> Ints:
    """The two sides of each edge whose triangles lie on each other, (F, 2).

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (T, 3) int array
        Oriented alike.
    sides : Sides
        Of `faces`.

    Examples
    --------
    >>> x, faces = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 2, 0]]), [[0, 1, 2], [1, 0, 3]]
    >>> faces = np.array(faces)
    >>> folded(x, faces, sides_of(faces)).tolist()
    [[0, 3]]
    """
    pairs = sides.pairs()
    normal = normals_of(vertices, faces)
    length = np.linalg.norm(normal, axis=1)
    corners = vertices[faces]
    longest = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2).max(axis=1)
    sure = length > THIN * longest
    one, other = pairs.T // 3
    cosine = (normal[one] * normal[other]).sum(axis=1)
    opposite = cosine < -OPPOSITE * length[one] * length[other]
    return np.asarray(pairs[opposite & sure[one] & sure[other]], dtype=np.int64)


def unfolded(vertices: Array, faces: Ints) -> tuple[Ints, int]:
    """Triangles of which fewer lie on each other, and how many polygons were cut anew.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (T, 3) int array
        Oriented alike.

    Examples
    --------
    >>> letter = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]])
    >>> fan = np.array([[1, 2, 3], [1, 3, 4], [1, 4, 5], [1, 5, 0]])
    >>> cut, count = unfolded(letter, fan)
    >>> count, float(np.linalg.norm(normals_of(letter, cut), axis=1).sum() / 2)
    (1, 3.0)
    """
    faces, count = faces.copy(), 0
    for _ in range(SWEEPS):
        sides = sides_of(faces)
        pairs = folded(vertices, faces, sides)
        if len(pairs) == 0:
            break
        normal = normals_of(vertices, faces)
        order = np.argsort(faces, axis=None, kind="stable")
        ends = np.cumsum(np.bincount(faces.ravel(), minlength=len(vertices)))
        touched: set[int] = set()
        for side in pairs[:, 0].tolist():
            best: tuple[float, Ints, Ints] | None = None
            for vertex in (sides.start[side], sides.end[side]):
                around = order[ends[vertex - 1] if vertex else 0 : ends[vertex]] // 3
                group = around[_in_the_plane(normal[around], normal[side // 3])]
                if touched.isdisjoint(group.tolist()):
                    new = _cut_anew(vertices, faces, group)
                    gain = _area(vertices, faces[group]) - _area(vertices, new)
                    if gain > 0 and (best is None or gain > best[0]):
                        best = gain, group, new
            if best is not None and best[0] > (1 - OPPOSITE) * _area(vertices, best[2]):
                _, group, new = best
                faces[group] = new
                touched.update(group.tolist())
                count += 1
        if not touched:
            break
    return faces, count


def _cut_anew(vertices: Array, faces: Ints, group: Ints) -> Ints:
    """Other triangles for those of a group, or the same where it is no polygon."""
    old = faces[group]
    sides = sides_of(old)
    loops = list(rims(sides, reverse=True))
    if len(loops) != 1 or len(loops[0]) != len(np.unique(old)):
        return old
    near = np.flatnonzero(np.isin(faces, loops[0]).any(axis=1))
    taken = directed(sides_of(faces[np.setdiff1d(near, group)]))
    return np.array(lid_of(vertices, loops[0], taken) or old, dtype=np.int64).reshape(-1, 3)


def _in_the_plane(normals: Array, normal: Array) -> Ints:
    """Which normals are parallel to another one, either way."""
    cosine = np.abs(normals @ normal)
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(normal)
    return np.flatnonzero(cosine > OPPOSITE * lengths)


def _area(vertices: Array, faces: Ints) -> float:
    return float(np.linalg.norm(normals_of(vertices, faces), axis=1).sum() / 2)
