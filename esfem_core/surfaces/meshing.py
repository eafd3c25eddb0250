"""Triangulations of surfaces that are given by a function, [N] Section 7.1.

The thesis takes its linear triangulations from DistMesh, a program for MATLAB: points that push
each other apart like compressed springs, on a surface given by its distance function. This is
the same idea for closed surfaces in NumPy: marching cubes for a first triangulation, then springs,
edge flips, and Newton's method to keep the vertices on the surface; the springs and flips stand in
:mod:`esfem_core.surfaces.relaxation`.
"""

from functools import partial
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from esfem_core.checks import Array, Ints, finite_array, number, package
from esfem_core.surfaces.check import check_triangulation
from esfem_core.surfaces.level_set import (
    Field,
    checked_gradient,
    checked_values,
    descend,
    with_its_gradient,
)
from esfem_core.surfaces.orientation import components
from esfem_core.surfaces.quality import Quality, angles_of
from esfem_core.surfaces.relaxation import (
    MAX_ROUNDS,
    MEAN_RATIO,
    MIN_ANGLE,
    SHORTEST,
    Guide,
    TooCoarseError,
    evened,
)

__all__ = ["MeshingError", "from_level_set"]

GRID = 1.14  # spacing of the first grid over h: marching cubes then gives about as many vertices
MAX_POINTS = 2 * 10**7  # of the grid with half that spacing, which checks the topology
LARGEST_BOX = 1e35  # the eighth power of a length must be a float, and that of its inverse
VANISHING = 0.01  # of the gradient at the corners of a triangle: what is less goes to zero
SMOOTH = 0.97  # cosine between normals of a smooth surface at points that are close


class MeshingError(RuntimeError):
    """The mesh did not become good enough; the message says what was reached, and where."""


def from_level_set(
    d: Field, bounds: ArrayLike, h: float, gradient: Field | None = None
) -> trimesh.Trimesh:
    """Triangulate the closed surface {d = 0} with edges of about the same length h.

    A round consists of collapses of short edges, splits of long ones, and 12 steps in which edges
    push their ends apart with a force proportional to 1.2 l - (length), l being the quadratic
    mean of all lengths as in DistMesh; after each step vertices return to the surface, before the
    first, fifth and ninth Delaunay's criterion flips edges. The last round is the one after which
    all angles are above 30 degrees, all edges longer than 0.6 h, the mean ratio of radii is above
    0.96, and which has neither collapsed nor split an edge and gained less than 0.003 in this mean.

    Nothing is random: the same input gives the same mesh. What lies between the points of grids of
    spacing 1.14 h and half of it is not seen: parts and gaps thinner than about h/2 may be missed
    without a word. The volume beside that of the mesh for h/2 tells.

    Parameters
    ----------
    d : callable
        (n, 3) -> (n,), smooth, zero on the surface with nonzero gradient there, positive outside.
        It need not be a distance.
    bounds : (2, 3) floats
        Lower and upper corner of a box with the surface inside.
    h : float
        Length of edges, about. The mean came out between 0.62 h and 1.36 h on 432 meshes of random
        smooth surfaces, on four of five between 0.8 h and 1.05 h; it is farthest from h where the
        curvature allows no much larger h. No edge is shorter than 0.6 h.
    gradient : callable, optional
        (n, 3) -> (n, 3), of d; by central differences if None.

    Returns
    -------
    trimesh.Trimesh
        Closed and oriented outwards, vertices on the surface to 1e-13 times the largest
        coordinate. For elements of higher degree give :class:`esfem_core.SurfaceSpace` also
        ``project=project_to_level_set(d)``.

    Raises
    ------
    ImportError
        Without scikit-image (``pip install "esfem-core[mesh]"``).
    TypeError, ValueError
        If `bounds` is not a box or `h` not positive; if the box holds no surface or cuts it; if d
        is negative outside or nowhere, as an unsigned distance is, or the surface has a crease; if
        h is too large for the box, the topology or the curvature, or so small that the grid had
        more than 2e7 points; if numbers are so large or small that their powers are none; if
        `gradient` does not have the direction of that of d on the surface.
    MeshingError
        If after 40 rounds the mesh is not as good as stated.

    Examples
    --------
    >>> import esfem_core as ec
    >>> def torus(x):
    ...     return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1, x[:, 2]) - 0.4
    >>> tri = ec.from_level_set(torus, [[-1.5, -1.5, -0.5], [1.5, 1.5, 0.5]], h=0.2)
    >>> tri.euler_number, bool(np.abs(torus(tri.vertices)).max() < 1e-12)
    (0, True)
    >>> space = ec.SurfaceSpace(tri, degree=2, project=ec.project_to_level_set(torus))
    """
    low, high = _box(bounds)
    h, size = number("h", h, above=0), float((high - low).max())
    if h > 2 * size:
        raise ValueError(f"h must be at most {2 * size!r}, twice the box's longest side, got {h:g}")
    given, gradient = gradient, checked_gradient(d, gradient, size)
    x, faces = _first_mesh(d, low, high, h, gradient)
    distance = partial(checked_values, d, shape=(), name="d")
    slope = partial(checked_values, gradient, shape=(3,), name="gradient")
    guide = Guide(distance, slope, partial(descend, d, gradient))
    x = with_its_gradient(d, given, size, guide.project, x)
    try:
        found = evened(x, faces, guide, h)
    except TooCoarseError as error:
        if (place := _crease(error.corners, d, gradient, h)) is None:
            raise
        raise ValueError(
            "d must be smooth, with nonzero gradient on the surface, but near "
            f"{place.round(3).tolist()} its gradient {_at_crease(place, error.corners, gradient)}, "
            "and no h is small enough; round it off, or make the triangles with a program for such "
            "bodies"
        ) from error
    tri = trimesh.Trimesh(found.vertices, found.faces, process=False)
    if not found.good:
        raise MeshingError(_shortcoming(tri, found.quality, h))
    check_triangulation(tri)
    return tri


def _box(bounds: ArrayLike) -> Array:
    box = finite_array("bounds", bounds, (2, 3))
    if not (box[0] < box[1]).all():
        raise ValueError(
            "bounds must be the lower and the upper corner of a box, [[x, y, z], [X, Y, Z]], "
            f"got {box.tolist()}"
        )
    if np.abs(box).max() > LARGEST_BOX or (box[1] - box[0]).min() < 1 / LARGEST_BOX:
        raise ValueError(
            f"bounds must be up to {LARGEST_BOX:g}, and {1 / LARGEST_BOX:g} or more apart, got "
            f"{box.tolist()}; give lengths in another unit"
        )
    return box


def _first_mesh(d: Field, low: Array, high: Array, h: float, gradient: Field) -> tuple[Array, Ints]:
    """Marching cubes; the topology must be the same on a grid of half the spacing."""
    with np.errstate(over="ignore"):  # more than can be counted are too many, too
        counts = np.maximum(np.ceil((high - low) / (GRID * h)), 3)
        points = np.prod(2 * counts + 1)
    if points > MAX_POINTS:
        raise ValueError(
            f"h must be larger for this box: with h = {h:g} the grid is of {points:.2g} points "
            f"(allowed: {MAX_POINTS:.0e}); take a tighter box or a larger h"
        )
    cells = counts.astype(int)
    axes = [np.linspace(a, b, 2 * n + 1) for a, b, n in zip(low, high, cells, strict=True)]
    spacing = (high - low) / (2 * cells)
    values = _sample(d, axes)
    _check_samples(values, axes, d, gradient)
    coarse = values[::2, ::2, ::2]
    if not (coarse <= 0).any():
        raise ValueError(
            f"h must be smaller for this surface, got {h:g}, which is too large: a grid of spacing "
            f"{2 * spacing.max():.3g} has no point inside, one of half the spacing has"
        )
    x, faces = _march(coarse, low, 2 * spacing)
    found, finer = _topology(faces), _topology(_march(values, low, spacing)[1])
    if found != finer:
        raise ValueError(
            f"h must be smaller for this surface, got {h:g}, which is too large: on a grid of "
            f"spacing {2 * spacing.max():.3g} it has {_in_words(found)}, on one of half the "
            f"spacing {_in_words(finer)}; where the surface touches or crosses itself, at points "
            "where the gradient of d vanishes, no h is small enough"
        )
    return x, faces


def _sample(d: Field, axes: list[Array]) -> Array:
    """Values of d on a grid, plane by plane."""
    y, z = (a.ravel() for a in np.meshgrid(axes[1], axes[2], indexing="ij"))
    shape = tuple(len(a) for a in axes)
    values = np.empty(shape)
    for plane, x in zip(values, axes[0], strict=True):
        points = np.stack([np.full(len(y), x), y, z], axis=1)
        plane[:] = checked_values(d, points, (), "d").reshape(shape[1:])
    return values


def _check_samples(values: Array, axes: list[Array], d: Field, gradient: Field) -> None:
    nearest = np.unravel_index(int(np.argmin(np.abs(values))), values.shape)
    start = np.array([[a[i] for a, i in zip(axes, nearest, strict=True)]])
    inside = values <= 0
    if inside.all() or not (values < 0).any():
        _check_crossing(values, nearest, _zero_near(d, gradient, start, axes), axes)
    inside[1:-1, 1:-1, 1:-1] = False
    count = int(inside.sum())
    if count == 0:
        return
    if count == values.size - np.prod(np.array(values.shape) - 2):
        raise ValueError(
            "d must be positive outside, but d is negative on the boundary of the box: outside it "
            "must be positive"
        )
    index = np.argwhere(inside)[0]
    point = [round(float(a[i]), 6) for a, i in zip(axes, index, strict=True)]
    raise ValueError(
        f"the surface is not closed in the box: d is {values[tuple(index)]:.3g} at the boundary "
        f"point {point}, where it must be positive; {_larger_box(d, axes)}"
    )


def _check_crossing(
    values: Array, nearest: tuple[Any, ...], zero: Array | None, axes: list[Array]
) -> None:
    """Refuse values of one sign; `zero` is where d changes it, if that was found."""
    if not values.any():
        raise ValueError("d must be zero on the surface only, but is zero on the whole grid")
    inside = values <= 0
    sign = "negative" if inside.all() else "positive"
    if zero is not None:
        if inside.any() and not inside.all():
            return  # the surface is as thin as a point of the grid that it passes through
        raise ValueError(
            f"h must be smaller for this surface: d is {sign} on the whole grid, but zero at "
            f"{zero.round(6).tolist()}, between its points"
        )
    if not inside.all() and _may_touch_zero(values, nearest):
        point = [round(float(a[i]), 6) for a, i in zip(axes, nearest, strict=True)]
        raise ValueError(
            f"d must be negative inside, but its least value on the grid is {values[nearest]:.3g}, "
            f"at {point}: an unsigned distance has no inside. If d has one, it lies between the "
            f"points of a grid of spacing {max(a[1] - a[0] for a in axes):.3g}, and a smaller h is "
            "needed to see it"
        )
    raise ValueError(
        f"bounds must hold a surface, but there is no surface in the box: d is {sign} on the "
        "whole grid (or h is too large to see it)"
    )


def _may_touch_zero(values: Array, nearest: tuple[Any, ...]) -> bool:
    """Whether the least value, inside of the grid, is no larger than what d changes beside it."""
    if any(i in (0, n - 1) for i, n in zip(nearest, values.shape, strict=True)):
        return False
    beside = values[tuple(slice(i - 1, i + 2) for i in nearest)]
    return bool(values[nearest] <= beside.max() - values[nearest])


def _zero_near(d: Field, gradient: Field, start: Array, axes: list[Array]) -> Array | None:
    """A point in the box where d changes its sign, found by Newton's method from one point."""
    try:
        [point] = descend(d, gradient, start)
    except ValueError:
        return None
    inside = all(a[0] <= c <= a[-1] for a, c in zip(axes, point, strict=True))
    slope = checked_values(gradient, point[None], (3,), "gradient")
    step = 1e-4 * (axes[0][1] - axes[0][0]) * slope / (np.linalg.norm(slope) or 1.0)
    before, after = checked_values(d, point + np.vstack([-step, step]), (), "d")
    return np.asarray(point) if inside and before < 0 < after else None  # not a double zero


def _larger_box(d: Field, axes: list[Array]) -> str:
    """What helps a surface that a box cuts: whether it ends in larger ones."""
    middle = np.array([(a[0] + a[-1]) / 2 for a in axes])
    half = np.array([(a[-1] - a[0]) / 2 for a in axes])
    u, v = (c.ravel() for c in np.meshgrid(*2 * [np.linspace(-1, 1, 33)], indexing="ij"))
    sides = [
        np.insert(np.stack([u, v], axis=1), axis, end, axis=1)
        for axis in range(3)
        for end in (-1, 1)
    ]
    try:
        cut = [
            bool((checked_values(d, middle + s * half * np.vstack(sides), (), "d") <= 0).any())
            for s in (2, 4, 8)
        ]
    except Exception:  # d is the user's, and what it does out there is not known
        return "take a larger box"
    if all(cut):
        return (
            "boxes of two, four and eight times the size cut it as well: a surface without an end, "
            "such as a plane, a cylinder or a periodic one, is not closed and cannot be meshed"
        )
    return "take a larger box"


def _march(values: Array, low: Array, spacing: Array) -> tuple[Array, Ints]:
    measure = package("from_level_set needs scikit-image", "skimage.measure", "mesh")
    # About distances, and none very small: vertices keep away from the grid's points.
    steepness = np.sqrt(sum(g * g for g in np.gradient(values, *spacing)))
    least = max(1e-12 * np.abs(values).max(), np.finfo(float).tiny)
    size = np.abs(values) / np.maximum(steepness, least)
    distance = np.where(values > 0, 1.0, -1.0) * np.maximum(size, 0.1 * spacing.min())
    # It computes in single precision: in a unit for which lengths are such numbers. Far from the
    # surface, where d has no slope, they need not be right.
    _, unit = np.frexp(spacing.min())
    x, faces, _, _ = measure.marching_cubes(
        np.ldexp(distance, -unit).clip(-1e30, 1e30),
        0.0,
        spacing=tuple(np.ldexp(spacing, -unit)),
        gradient_direction="descent",
    )
    return np.ldexp(x.astype(float), unit) + low, faces.astype(np.int64)


def _topology(faces: Ints) -> tuple[int, int]:
    """Euler number and number of components of a closed triangulation."""
    return int(faces.max()) + 1 - len(faces) // 2, int(components(faces).max()) + 1


def _in_words(topology: tuple[int, int]) -> str:
    euler, pieces = topology
    return f"Euler number {euler} and {pieces} component{'s' if pieces > 1 else ''}"


def _crease(corners: Array, d: Field, gradient: Field, h: float) -> Array | None:
    """A point near a triangle where the normal of the surface jumps, or None.

    Between two points of the surface with different normals lies one whose normal differs from one
    of theirs by half the angle or more. On a smooth surface the angle goes to zero with the
    distance.
    """

    def normals(points: Array) -> Array:
        g = checked_values(gradient, points, (3,), "gradient")
        return np.asarray(g / np.linalg.norm(g, axis=1, keepdims=True))

    n = normals(corners)
    products = n @ n.T
    i, j = np.unravel_index(int(np.argmin(products)), products.shape)
    a, b, n_a, n_b = corners[i], corners[j], n[i], n[j]
    for _ in range(40):
        try:
            [middle] = descend(d, gradient, (a + b)[None] / 2)
            [n_middle] = normals(middle[None])
        except ValueError:
            return np.asarray((a + b) / 2)
        if n_a @ n_middle < n_middle @ n_b:
            b, n_b = middle, n_middle
        else:
            a, n_a = middle, n_middle
        if n_a @ n_b > SMOOTH:
            return None
        if np.linalg.norm(a - b) < 1e-4 * h:
            return np.asarray(a)
    return None


def _at_crease(place: Array, corners: Array, gradient: Field) -> str:
    """What a gradient does where its direction jumps, and what the surface has there."""
    g = checked_values(gradient, np.vstack([place, corners]), (3,), "gradient")
    there, *around = np.linalg.norm(g, axis=1)
    if there < VANISHING * max(around):
        return "vanishes: the surface has a tip there or meets itself"
    return "jumps: the surface has a crease there, an edge or a corner"


def _shortcoming(tri: trimesh.Trimesh, reached: Quality, h: float) -> str:
    worst = tri.triangles_center[int(np.argmin(angles_of(tri.triangles).min(axis=1)))]
    if reached.h_min < SHORTEST * h and reached.min_angle >= MIN_ANGLE:
        return (
            f"h must be smaller for this surface, got {h:g}: a closed mesh of it has edges of "
            f"{reached.h_min:.3g}, less than {SHORTEST:g} h, after {MAX_ROUNDS} rounds"
        )
    return (
        f"after {MAX_ROUNDS} rounds the smallest angle is {reached.min_angle:.1f} degrees (wanted: "
        f"{MIN_ANGLE:g}), near {worst.round(3).tolist()}, and the mean ratio of radii "
        f"{reached.mean_ratio:.3f} (wanted: {MEAN_RATIO:g}), with edges of {reached.h_min:.3g} to "
        f"{reached.h_max:.3g}; a smaller h than {h:g} may help"
    )
