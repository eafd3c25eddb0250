"""A discrete surface by its tangent planes at many points: quick distances of points nearby."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Ints, finite_array, frozen, number, object_of
from esfem_core.elements.lagrange import tabulate
from esfem_core.elements.recovery import nodal_average
from esfem_core.elements.surface import Surface

__all__ = ["TangentPlanes"]

FINEST = 64  # parts of a side, at most


class TangentPlanes:
    """Signed distances from Γ_h[x], and normals, of points near it.

    A point looks up the nearest of many points of the surface, and takes the plane through this
    that is normal to a continuous normal field, by default the nodal average of that of the
    elements. The distance of a point of the surface comes out as O(spacing^2);
    :func:`closest_points` is exact, and a hundred times slower.

    Parameters
    ----------
    at : Surface
    spacing : float or (T,) float array
        Between the points that are looked up, on each element; not less than about a 64th of its
        longest side.
    normal : (N, 3) float array, optional
        Normals at the nodes, of any length.

    Attributes
    ----------
    space, x, spacing
        As given, those of the surface; arrays are read-only.
    nodal : (N, 3) float array
        Unit normals at the nodes.

    Raises
    ------
    ValueError, TypeError
        If an argument has the wrong shape or type, a spacing is not finite and positive, or a
        normal is not finite or zero.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> planes = TangentPlanes(ec.Surface(space, space.nodes), 0.05)
    >>> planes.distance(np.array([[0.0, 0.0, 1.5]])).round(3)
    array([0.5])
    >>> planes.normal(np.array([[0.5, 1.0, 1.0]])).round(1)
    array([[0.3, 0.7, 0.7]])
    """

    def __init__(self, at: Surface, spacing: float | Array, normal: Array | None = None) -> None:
        space = object_of("at", at, Surface).space
        spacing = _positive(spacing, len(space.cells))
        # What tells them from others.
        self.space, self.x, self.spacing = space, at.x, spacing
        if normal is None:
            normal = nodal_average(at, at.normal)
        normal = finite_array("normal", normal, at.x.shape)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        if not length.all():
            raise ValueError(f"normal must not be zero, but is at node {np.argmin(length)}")
        self.nodal = normal / length
        corners = at.x[space.cells[:, :3]]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        wanted = np.clip(longest / spacing, 1, FINEST)
        parts = 2 ** np.ceil(np.log2(wanted)).astype(int)
        points, normals, self._where = [], [], []
        for n in np.unique(parts):
            cells = space.cells[parts == n]
            values = tabulate(space.degree, _centres(int(n))).values
            self._where.append((values, cells))
            points.append((values @ at.x[cells]).reshape(-1, 3))
            normals.append((values @ self.nodal[cells]).reshape(-1, 3))
        self._points = np.concatenate(points)
        many = np.concatenate(normals)
        self._normals = many / np.linalg.norm(many, axis=1, keepdims=True)
        self._tree = cKDTree(self._points)
        self._last = np.empty((0, 3)), np.empty(0, dtype=np.int64)

    def distance(self, x: Array) -> Array:
        """Signed distances of points (n, 3), positive outside, (n,)."""
        i = self._nearest(x)
        points, normals = (np.take(values, i, axis=0) for values in (self._points, self._normals))
        found: Array = np.einsum("ij,ij->i", x - points, normals)
        return found

    def normal(self, x: Array) -> Array:
        """Unit normals near points (n, 3), (n, 3)."""
        return np.asarray(np.take(self._normals, self._nearest(x), axis=0))

    def values(self, nodal: Array) -> Callable[[Array], Array]:
        """Take points (n, 3) to values near them, (n,), of a function given at the nodes, (N,)."""
        nodal = finite_array("nodal", nodal, (len(self.x),))
        many = np.concatenate(
            [(values @ nodal[cells].T).T.ravel() for values, cells in self._where]
        )
        return lambda x: np.asarray(many[self._nearest(x)])

    def near(self, x: Array) -> Array:
        """Points (n, 3) moved to the planes, (n, 3)."""
        moved: Array = x
        for _ in range(2):  # the second plane is that of a nearer point
            i = self._nearest(moved)
            points, n = (np.take(values, i, axis=0) for values in (self._points, self._normals))
            moved = moved - np.einsum("ij,ij->i", moved - points, n)[:, None] * n
        return moved

    def _nearest(self, x: Array) -> Ints:
        """Numbers of the points that are looked up, (n,); anew where x differs from the last."""
        x = finite_array("x", x, ("n", 3))
        last, found = self._last
        if len(last) != len(x):
            last, found = np.full(x.shape, np.nan), np.empty(len(x), dtype=np.int64)
        moved = np.flatnonzero((x != last).any(axis=1))
        if len(moved):
            found = found.copy()
            found[moved] = self._tree.query(x[moved])[1]
            self._last = x.copy(), found
        return found


def _positive(spacing: ArrayLike, n_cells: int) -> float | Array:
    """Spacings of all elements, or of each, (T,)."""
    if np.ndim(spacing) == 0:
        return number("spacing", spacing, above=0)
    each = finite_array("spacing", spacing, (n_cells,))
    if not (each > 0).all():
        t = int(np.argmin(each > 0))
        raise ValueError(f"spacing must be > 0, but spacing[{t}] is {each[t]}")
    return frozen(each)


def _centres(parts: int) -> Array:
    """Centres of the triangles into which the reference triangle is divided.

    >>> _centres(2).round(2).tolist()
    [[0.17, 0.17], [0.67, 0.17], [0.17, 0.67], [0.33, 0.33]]
    """
    i, j = np.divmod(np.arange(parts**2), parts)
    up, down = i + j < parts, i + j < parts - 1
    lower = np.stack([j[up], i[up]], axis=1) + 1 / 3
    upper = np.stack([j[down], i[down]], axis=1) + 2 / 3
    return np.asarray(np.concatenate([lower, upper]) / parts)
