"""Surfaces given as the zero set of a function, [N] (2.1), and their closest points, (2.2).

The function d need not be a distance: it may be any smooth function whose gradient does not
vanish at its zeros. It is negative inside and positive outside.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from esfem_core.checks import Array, finite_array, function, real_array
from esfem_core.surfaces.differences import derivative

__all__ = [
    "Field",
    "central_gradient",
    "checked_gradient",
    "checked_values",
    "descend",
    "project_to_level_set",
    "reach",
    "size_of",
    "with_its_gradient",
]

Field = Callable[[Array], Array]

MAX_STEPS = 50
ON_SURFACE = 1e-13  # accepted distance from the surface, relative to the coordinates
CLOSEST = 1e-11  # accepted tangential distance from the closest point, likewise
SWAYING = 1e-10  # likewise, over the distance from the surface: error of differences
FAR = 10  # sizes of the surface from the origin
APART = 1e5  # times as far from the origin as most points
SAMPLES = 8  # points that show the size of the surface, and the gradient of which is compared
ALIKE = 1e-3  # by so much of its size it may differ there; differences are good to 1e-9
LARGEST = 1e150  # value and slope; their squares must be numbers, and
SMALLEST = 1e-150  # those of slopes not be zero
DIFFERENCE = 6e-6  # step of central differences, likewise: the cube root of rounding
ON_IT = 1e-6  # of the values where points come from: where d is smaller, it is zero nearby
STEP_OF_SINGLE = 1e-9  # relative to the coordinates: far below the rounding of single precision
NEARBY = 1e-3  # step of the differences that show how d bends, relative to its reach
SHORTEST_REACH = 1e-8  # relative to the coordinates: a shorter one drowns in their rounding
DIRECTIONS = np.vstack([np.eye(3), (1 - np.eye(3)) / np.sqrt(2)])  # all second derivatives in six


def project_to_level_set(d: Field, gradient: Field | None = None) -> Field:
    """Make the map that takes points near the surface {d = 0} to their closest points on it.

    The closest point y of x has x - y normal to the surface ([N] (2.2)). From y on the surface,
    x is projected to the tangent plane at y, and from there along the gradient of d to the
    surface. This contracts by the curvature times the distance of x.

    Parameters
    ----------
    d : callable
        (n, 3) -> (n,), zero on the surface, positive outside.
    gradient : callable, optional
        (n, 3) -> (n, 3), its gradient; by central differences if None.

    Returns
    -------
    callable
        (n, 3) -> (n, 3), for :class:`esfem_core.SurfaceSpace` and
        :class:`esfem_core.Exact`. Its points are on the surface to 1e-13 times the
        largest coordinate and closest ones to 1e-11 times it, or to 1e-10 of their way. It
        raises a ValueError where Newton's method does not arrive, the gradient vanishes or is not
        that of d on the surface.

    Raises
    ------
    TypeError
        If `d`, or a `gradient` that is given, is no function.

    Examples
    --------
    >>> project = project_to_level_set(lambda x: (x**2 / [4, 1, 1]).sum(axis=1) - 1)
    >>> project(np.array([[2.1, 0.0, 0.0], [0.0, 0.0, 0.9]])).round(12)
    array([[2., 0., 0.],
           [0., 0., 1.]])
    """
    checked_gradient(d, gradient)

    def project(points: Array) -> Array:
        return _by_distance(project_alike, finite_array("points", points, ("n", 3)))

    def with_size(size: float, x: Array) -> Array:
        slope = checked_gradient(d, gradient, size)
        return with_its_gradient(d, gradient, size, lambda x: _closest(d, slope, x), x)

    def project_alike(x: Array) -> Array:
        _check_precision(d, checked_gradient(d, gradient), x)
        size = size_of(d, x)
        try:
            return with_size(size, x)
        except ValueError:
            # Where terms of d cancel, its rounding is larger than that of the coordinates, and
            # points sway with the differences of a short step.
            if gradient is None and FAR * size < _scale(x):
                for longer in (float(np.ptp(x, axis=0).max()), _scale(x)):
                    if longer > size:
                        with suppress(ValueError):
                            return with_size(longer, x)
            raise

    return project


def _closest(d: Field, slope: Field, x: Array) -> Array:
    """The closest points of x, by the iteration of `project_to_level_set`."""
    scale = _scale(x)
    y = descend(d, slope, x)
    todo = np.arange(len(x))
    for _ in range(MAX_STEPS):
        g = checked_values(slope, y[todo], (3,), "gradient")
        n = g / np.linalg.norm(g, axis=1, keepdims=True)
        off = x[todo] - y[todo]
        tangential = off - (off * n).sum(axis=1, keepdims=True) * n
        far = np.linalg.norm(tangential, axis=1) > CLOSEST * scale
        todo, tangential = todo[far], tangential[far]
        if len(todo) == 0:
            return y
        y[todo] = descend(d, slope, y[todo] + tangential)
    if (np.linalg.norm(tangential, axis=1) <= SWAYING * np.linalg.norm(off[far], axis=1)).all():
        return y
    raise ValueError(
        f"points must be near the surface, but no closest point was found for "
        f"{x[todo[0]].tolist()} ({len(todo)} such points): it is too far from the surface for "
        "its curvature, or the gradient is computed in single precision"
    )


def checked_gradient(d: Field, gradient: Field | None, size: float | None = None) -> Field:
    """The gradient of d: the given one, or differences; size as for `central_gradient`."""
    function("d", d, "of points (n, 3)")
    if gradient is None:
        return central_gradient(d, size)
    function("gradient", gradient, "of points (n, 3), or None")
    return gradient


def reach(d: Field, points: Array) -> Array:
    """Length over which d bends: its slope over its second derivatives, up to a small factor.

    Parameters
    ----------
    d : callable
        (n, 3) -> (n,). It is asked up to a thousandth of the largest coordinate from the points,
        or less where it raises an error there or is no number.
    points : (n, 3) float array

    Returns
    -------
    (n,) float array
        From 1e-8 of the largest coordinate, which is also that of a kink, to all of it, which is
        also that of a plane.

    Examples
    --------
    >>> ring = np.array([[1.01, 0, 0], [0, 0.99, 0]])
    >>> reach(lambda x: np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1, x[:, 2]) - 0.01, ring).round(4)
    array([0.01, 0.01])
    """
    length, todo = np.full(len(points), _scale(points)), np.arange(len(points))
    least = SHORTEST_REACH * _scale(points)
    for _ in range(MAX_STEPS):
        along, bent = _bending(d, points[todo], NEARBY * length[todo])
        # Seen over a length that is too long, d bends by another amount: look again.
        again = (bent > 2 * NEARBY * along) & (length[todo] > least)
        if not again.any():
            break
        todo, share = todo[again], NEARBY * along[again] / bent[again]
        length[todo] = np.maximum(share * length[todo], least)
    return length


def _bending(d: Field, x: Array, step: Array) -> tuple[Array, Array]:
    """Largest first and second differences of d at points, of steps (n,).

    Where d is not known so far from the points, they are those that make `reach` look again at a
    tenth of the length.
    """
    moves = step[:, None] * DIRECTIONS[:, None]
    here = checked_values(d, x, (), "d")
    try:
        with np.errstate(all="ignore"):
            before, after = (
                checked_values(d, (x + s * moves).reshape(-1, 3), (), "d").reshape(6, -1)
                for s in (-1, 1)
            )
    except Exception:  # d is the user's, and what it does out there is not known
        return np.ones(len(x)), np.full(len(x), 10 * NEARBY)
    along = np.abs(after - before).max(axis=0) / 2
    return along, np.abs(after - 2 * here + before).max(axis=0)


def size_of(d: Field, points: Array) -> float:
    """Size of the surface for `central_gradient`: that of d, for points may be close together."""
    return float(np.median(reach(d, _some(points)))) if len(points) else 0.0


def _some(x: Array) -> Array:
    return x[:: -(-len(x) // SAMPLES)]


def with_its_gradient(
    d: Field, gradient: Field | None, size: float, to_surface: Field, x: Array
) -> Array:
    """Points moved to the surface; a given gradient is refused if it is another function's.

    Parameters
    ----------
    d, gradient : callable
        (n, 3) -> (n,) and (n, 3) -> (n, 3) or None.
    size : float
        Of the surface, as for `central_gradient`.
    to_surface : callable
        (n, 3) -> (n, 3), by this gradient.
    x : (n, 3) float array
    """
    comparable = size > DIFFERENCE * _scale(x)
    try:
        y = to_surface(x)
    except ValueError:
        if gradient is not None and comparable:
            _check_is_gradient(d, gradient, x, size, length=True)
        raise
    if gradient is not None and comparable:  # only its direction has been used, on the surface
        _check_is_gradient(d, gradient, y, size, length=False)
    return y


def _check_is_gradient(d: Field, gradient: Field, x: Array, size: float, *, length: bool) -> None:
    """Refuse a gradient of another function: with it, points end beside the closest ones.

    A few points will do, and at some of them d may have a kink. Without `length`, only directions
    are compared.
    """
    some = _some(x)
    given = checked_values(gradient, some, (3,), "gradient")
    expected = central_gradient(d, size)(some)
    sizes = [np.linalg.norm(g, axis=1, keepdims=True) for g in (given, expected)]
    factor = 1.0 if length else sizes[1] / sizes[0]
    off = np.linalg.norm(factor * given - expected, axis=1) > ALIKE * sizes[1][:, 0]
    if 2 * off.sum() > len(some):
        i = int(np.argmax(off))
        raise ValueError(
            f"gradient must be that of d, but at {some[i].tolist()} it is {_rounded(given[i])}, "
            f"and differences of d give {_rounded(expected[i])}"
        )


def _rounded(numbers: Array) -> list[float]:
    return [float(f"{number:.6g}") for number in numbers]


def descend(d: Field, gradient: Field, points: Array) -> Array:
    """Move points to {d = 0} along the gradient of d, by Newton's method.

    Parameters
    ----------
    d, gradient : callable
        (n, 3) -> (n,) and (n, 3) -> (n, 3).
    points : (n, 3) float array

    Returns
    -------
    (n, 3) float array

    Raises
    ------
    TypeError, ValueError
        If points or values are not finite or of the wrong shape, the gradient vanishes, or a
        point does not arrive.

    Examples
    --------
    >>> p = descend(lambda x: (x**2).sum(axis=1) - 1, lambda x: 2 * x, np.array([[0.0, 0, 3]]))
    >>> p.tolist()
    [[0.0, 0.0, 1.0]]
    """
    x = finite_array("points", points, ("n", 3))
    return _by_distance(lambda some: _descend(d, gradient, some), x)


def _descend(d: Field, gradient: Field, start: Array) -> Array:
    """What `descend` does, for points of about one size."""
    x, scale = start.copy(), _scale(start)
    todo = np.arange(len(x))
    for _ in range(MAX_STEPS):
        value = checked_values(d, x[todo], (), "d")
        g = checked_values(gradient, x[todo], (3,), "gradient")
        square = (g * g).sum(axis=1)
        if not (square > SMALLEST**2).all():
            i = int(np.argmin(square))
            place = x[todo[i]].tolist()
            if g[i].any():
                raise ValueError(
                    f"the gradient of d must be larger than {SMALLEST:g}, but is {g[i].tolist()} "
                    f"at {place}: multiply d by a large number"
                )
            raise ValueError(
                f"the gradient of d must not vanish at the points, but is zero at {place}, "
                f"{_why_no_slope(value[i], checked_values(d, start, (), 'd'))}"
            )
        step = -(value / square)[:, None] * g
        x[todo] += step
        todo = todo[np.linalg.norm(step, axis=1) > ON_SURFACE * scale]
        if len(todo) == 0:
            return x
    last = checked_values(d, x[todo], (), "d")
    if _in_steps(d, x[todo], last):
        raise ValueError(_in_single_precision("numbers of single precision"))
    raise ValueError(
        f"Newton's method does not reach the surface from {start[todo[0]].tolist()} "
        f"({len(todo)} such points): it is too far away, or d is not smooth, or its gradient "
        "vanishes on the surface, or what is meshed is thinner there than triangles are long, or "
        f"terms of d cancel and leave rounding errors (its last values are up to "
        f"{np.abs(last).max():.2g})"
    )


def _why_no_slope(value: float, before: Array) -> str:
    """What it means that d has no slope at a point: on the surface, or away from it."""
    if abs(value) < ON_IT * np.abs(before).max():
        return "on the surface: it has a tip there or meets itself, and no h is small enough"
    return (
        f"where d = {value:.3g}: no way leads from there to the surface, as from the middle of a "
        "body or where d is constant; points must be nearer, for from_level_set h must be smaller"
    )


def _check_precision(d: Field, gradient: Field, x: Array) -> None:
    """Refuse a d that computes in single precision: Newton's method may stop at its jitter.

    A few points will do, where the gradient is large enough for a d of double precision to change.
    """
    if len(x) == 0:
        return
    some = _some(x)
    values = checked_values(d, some, (), "d")
    slope = np.linalg.norm(checked_values(gradient, some, (3,), "gradient"), axis=1)
    seen = STEP_OF_SINGLE * _scale(some) * slope > 100 * np.spacing(np.abs(values))
    if seen.any() and _in_steps(d, some[seen], values[seen]):
        raise ValueError(_in_single_precision("numbers of single precision"))


def _in_steps(d: Field, x: Array, values: Array) -> bool:
    """Whether d stays the same next to most points, as functions in single precision do."""
    moved = x + STEP_OF_SINGLE * _scale(x) * DIRECTIONS[:, None]
    same = checked_values(d, moved.reshape(-1, 3), (), "d").reshape(6, -1) == values
    return bool(2 * same.sum() > same.size)


def _by_distance(function: Field, x: Array) -> Array:
    """Values (n, 3) of a function of points, those much farther away than most by themselves.

    Steps of differences and accepted errors are relative to the largest coordinate, so that one
    point far away would spoil the others.
    """
    size = np.abs(x).max(axis=1, initial=0)
    middle = np.partition(size, (len(x) - 1) // 2)[(len(x) - 1) // 2] if len(x) else 0.0
    far = size > APART * middle
    if middle == 0 or not far.any():
        return function(x)
    y = np.empty_like(x)
    for part in (~far, far):
        y[part] = _by_distance(function, x[part])
    return y


def _in_single_precision(found: str, name: str = "d") -> str:
    return (
        f"values of {name} must be of double precision, got {found}: they jitter by 1e-7, and no "
        f"point can be put on the surface to 1e-13 with them; {name} gets points of type float64 "
        "and must compute in it"
    )


def central_gradient(d: Field, size: float | None = None) -> Field:
    """Gradient of a function by central differences, with a relative error of about 1e-10.

    Parameters
    ----------
    d : callable
        (n, 3) -> (n,).
    size : float, optional
        Of the surface: far from the origin the values of d carry the rounding errors of the
        coordinates, and the step of the differences must be larger against the surface.

    Examples
    --------
    >>> central_gradient(lambda x: x[:, 0] * x[:, 2])(np.array([[1.0, 0, 2]])).round(8)
    array([[2., 0., 1.]])
    """

    def gradient(points: Array) -> Array:
        x = finite_array("points", points, ("n", 3))

        def shifted(s: float) -> Array:
            """Values at the points moved by s along each axis, (3, n)."""
            moved = x + s * np.eye(3)[:, None]
            return checked_values(d, moved.reshape(-1, 3), (), "d").reshape(3, len(x))

        step = DIFFERENCE * _scale(x)
        if size and _scale(x) > FAR * size:  # the same cube root, of the rounding that there is
            step = DIFFERENCE * size * float(np.cbrt(_scale(x) / size))
        return derivative(shifted, order=2, step=step).T

    return gradient


def _scale(x: Array) -> float:
    return float(np.abs(x).max(initial=0)) or 1.0


def checked_values(given: Field, x: Array, shape: tuple[int, ...], name: str) -> Array:
    """Values of a user's function, refused unless they are of the right shape and have squares."""
    returned = given(x.copy())
    if getattr(returned, "dtype", None) in (np.float32, np.float16):
        raise ValueError(_in_single_precision(str(returned.dtype), name))
    # A copy: the function may return one array each time.
    values = np.array(real_array(f"values of {name}", returned, (len(x), *shape)))
    bad = ~(np.abs(values) <= LARGEST).all(axis=tuple(range(1, values.ndim)))
    if bad.any():
        i = int(np.argmax(bad))
        finite = np.isfinite(values[i]).all()
        raise ValueError(
            f"values of {name} must be {f'up to {LARGEST:g}' if finite else 'finite'}, but {name} "
            f"is {values[i].tolist()} at {x[i].tolist()}"
            f"{': multiply d by a small number' if finite else ''}"
        )
    return values
