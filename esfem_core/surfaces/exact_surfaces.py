"""Surfaces known exactly: signed distance, normal, closest point, curvature.

To compare a discrete surface with the surface it approximates ([N] Sections 2.1, 2.2, 2.12), one
needs for each point x nearby the decomposition x = p + d ν(p) and the curvature at p.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from esfem_core.checks import Array, Bools, finite_array, number
from esfem_core.surfaces.differences import derivative
from esfem_core.surfaces.faults import FARTHEST
from esfem_core.surfaces.level_set import (
    Field,
    checked_gradient,
    checked_values,
    project_to_level_set,
    reach,
    size_of,
)

__all__ = ["Ellipsoid", "ExactSurface", "LevelSet", "Near", "Sphere", "Torus"]

DIFFERENCE = 2e-3  # step of differences of fourth order, relative to the reach of d
CONVERGED = 1e-8  # error of the ellipsoid's equation before the last Newton step squares it
MAX_STEPS = 50  # of that method
DEEP = 0.1  # smallest x_i/p_i of points inside that need no more care
TINY = 1e-100  # positive, and its square is a number


class Near(NamedTuple):
    """The decomposition x = p + d ν of points near a surface ([N] (2.2)).

    Attributes
    ----------
    points : (..., 3) float array
        Closest points p.
    distance : (...) float array
        Signed distance d of x, positive outside.
    normal : (..., 3) float array
        Unit outward normal ν, at p and x alike.
    weingarten : (..., 3, 3) float array
        Weingarten map of the surface at p: the differential of ν, symmetric, zero on ν. Its other
        eigenvalues are the principal curvatures, positive on a sphere.
    """

    points: Array
    distance: Array
    normal: Array
    weingarten: Array

    @property
    def mean_curvature(self) -> Array:
        """Sum H of the principal curvatures at p, as in [N] (2.4), of shape (...)."""
        trace: Array = np.trace(self.weingarten, axis1=-2, axis2=-1)
        return trace


class ExactSurface(ABC):
    """A closed surface with all that is known about it in closed form or by iteration."""

    @abstractmethod
    def near(self, x: Array) -> Near:
        """Decompose points as p + d ν.

        Parameters
        ----------
        x : (..., 3) float array
            Points near the surface.

        Returns
        -------
        Near

        Raises
        ------
        TypeError, ValueError
            If they are not finite points, or at one that has no unique closest point.
        """

    def closest(self, x: Array) -> Array:
        """Closest points p, for `project` of :class:`esfem_core.SurfaceSpace`.

        Raises
        ------
        TypeError, ValueError
            As of :meth:`near`.
        """
        return self.near(x).points

    def normal(self, x: Array) -> Array:
        """Unit outward normals at the closest points, (..., 3).

        Raises
        ------
        TypeError, ValueError
            As of :meth:`near`.
        """
        return self.near(x).normal

    def mean_curvature(self, x: Array) -> Array:
        """Sum of the principal curvatures at the closest points, (...).

        Raises
        ------
        TypeError, ValueError
            As of :meth:`near`.
        """
        return self.near(x).mean_curvature


def _check_no_flags(name: str, values: Iterable[object]) -> None:
    """Refuse booleans, which NumPy takes for numbers where they stand among these."""
    for i, value in enumerate(values):
        if isinstance(value, bool | np.bool):
            raise TypeError(f"{name}[{i}] must be a number, got {value!r}")


@dataclass(frozen=True)
class Sphere(ExactSurface):
    """Sphere around the origin.

    Parameters
    ----------
    radius : float
        Positive.

    Raises
    ------
    TypeError, ValueError
        If it is not.

    Examples
    --------
    >>> Sphere(2.0).near(np.array([0.0, 0.0, 2.5])).distance.item()
    0.5
    """

    radius: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", number("radius", self.radius, above=0))

    def near(self, x: Array) -> Near:  # noqa: D102 - documented by the base class
        x = finite_array("x", x, ("...", 3))
        with np.errstate(over="ignore"):
            length = np.linalg.norm(x, axis=-1)
        _refuse(x, (length <= 0) | (length == np.inf), "sphere")
        normal = x / length[..., None]
        weingarten = (np.eye(3) - _outer(normal)) / self.radius
        return Near(self.radius * normal, length - self.radius, normal, weingarten)


@dataclass(frozen=True)
class Torus(ExactSurface):
    """Torus around the third axis.

    Parameters
    ----------
    R, r : float
        Radius of the core circle and of the tube, R > r > 0.

    Raises
    ------
    TypeError, ValueError
        If they are not.

    Examples
    --------
    >>> near = Torus(1.0, 0.5).near(np.array([[1.75, 0.0, 0.0], [0.25, 0.0, 0.0]]))
    >>> near.distance, near.mean_curvature.round(4)
    (array([0.25, 0.25]), array([2.6667, 0.    ]))
    """

    R: float = 1.0
    r: float = 0.4

    def __post_init__(self) -> None:
        R, r = number("R", self.R, above=0), number("r", self.r, above=0)
        if r >= R:
            raise ValueError(f"R must be larger than r, got R = {R:g} and r = {r:g}")
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "r", r)

    def near(self, x: Array) -> Near:  # noqa: D102
        x = finite_array("x", x, ("...", 3))
        rho = np.hypot(x[..., 0], x[..., 1])
        _refuse(x, rho <= 0, "torus")
        outward = x * [1.0, 1.0, 0.0] / rho[..., None]
        away = x - self.R * outward
        with np.errstate(over="ignore"):
            length = np.linalg.norm(away, axis=-1)
        _refuse(x, (length <= 0) | (length == np.inf), "torus")
        normal = away / length[..., None]
        round_axis = np.stack([-outward[..., 1], outward[..., 0], 0 * rho], axis=-1)
        cosine = np.sum(normal * outward, axis=-1)
        across = _outer(round_axis)
        along_axis = (cosine / (self.R + self.r * cosine))[..., None, None] * across
        weingarten = (np.eye(3) - _outer(normal) - across) / self.r + along_axis
        return Near(self.R * outward + self.r * normal, length - self.r, normal, weingarten)


@dataclass(frozen=True)
class Ellipsoid(ExactSurface):
    """Ellipsoid around the origin, axes along those of the coordinates.

    Parameters
    ----------
    axes : (float, float, float)
        Semi-axes c_i > 0 of {sum_i (y_i/c_i)^2 = 1}.

    Raises
    ------
    TypeError, ValueError
        If they are not three positive numbers, from 1e-75 to 1e75.

    Examples
    --------
    >>> Ellipsoid((2.0, 1.0, 1.0)).closest(np.array([[3.0, 0.0, 0.0], [0.0, 0.3, 0.4]])).round(12)
    array([[2. , 0. , 0. ], [0. , 0.6, 0.8]])
    """

    axes: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        axes = finite_array("axes", self.axes, (3,))
        _check_no_flags("axes", self.axes)
        if not (axes > 0).all():
            raise ValueError(f"axes must be positive, got {axes.tolist()}")
        if axes.max() > FARTHEST or axes.min() < 1 / FARTHEST:
            raise ValueError(
                f"axes must be from {1 / FARTHEST:g} to {FARTHEST:g}, got {axes.tolist()}; give "
                "lengths in another unit"
            )
        object.__setattr__(self, "axes", tuple(axes.tolist()))

    def near(self, x: Array) -> Near:  # noqa: D102
        x = finite_array("x", x, ("...", 3))
        points = self.closest(x)
        inverse = 1 / np.asarray(self.axes) ** 2
        gradient = points * inverse
        size = np.linalg.norm(gradient, axis=-1, keepdims=True)
        normal = gradient / size
        tangential = np.eye(3) - _outer(normal)
        weingarten = tangential @ (inverse[:, None] * tangential) / size[..., None]
        distance = np.sum((x - points) * normal, axis=-1)
        return Near(points, distance, normal, weingarten)

    def closest(self, x: Array) -> Array:
        """Closest points p, for `project` of :class:`esfem_core.SurfaceSpace`.

        x - p is normal to the surface: p_i = x_i/(1 + s/c_i^2) with the same s > -min c_i^2. The
        equation of the surface, q(s) = 1, is solved for s by Newton's method in the form
        q^{-1/2} = 1, which is linear for a sphere.
        """
        x = finite_array("x", x, ("...", 3))
        rows = np.ascontiguousarray(x.reshape(-1, 3).T)  # NumPy is slow on many short rows
        squares = np.asarray(self.axes)[:, None] ** 2
        stretch, solved = _stretches(rows, squares, 0.0)
        deep = ~(solved & (stretch > DEEP).all(axis=0))
        if deep.any():  # close to -min c_i^2, only the distance from there has all digits
            least = float(squares.min())
            stretch[:, deep], solved[deep] = _stretches(rows[:, deep], squares, least)
        _refuse(x, ~solved.reshape(x.shape[:-1]), "ellipsoid")
        points: Array = np.ascontiguousarray((rows / stretch).T).reshape(x.shape)
        return points


def _stretches(x: Array, squares: Array, origin: float) -> tuple[Array, Bools]:
    """The x_i/p_i of closest points of an ellipsoid, (3, n), and where they are found.

    With s = t - origin, one solves for t. No term of q is above 1, which bounds the root from
    below, and from there on Newton's method approaches it, since q^{-1/2} is concave.
    """
    rest, least = squares - origin, float(squares.min())
    bound = (np.sqrt(squares) * np.abs(x) - rest).max(axis=0)
    bound = np.maximum(bound, TINY * least) if origin else np.clip(bound, -(1 - DEEP) * least, 0)
    t = np.maximum(bound, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(MAX_STEPS):
            parts = x**2 / squares / (rest / squares + t / squares) ** 2
            q = parts.sum(axis=0)
            slope = np.sum(parts / (rest + t), axis=0)
            t = np.maximum(t + q * (np.sqrt(q) - 1) / slope, bound)
            if not np.any(np.abs(q - 1) > CONVERGED):
                break
    stretch = rest / squares + t / squares
    return stretch, np.asarray((np.abs(q - 1) <= CONVERGED) & (stretch > 0).all(axis=0))


@dataclass(frozen=True)
class LevelSet(ExactSurface):
    """The surface {d = 0} of a function that need not be a distance.

    With g = grad d and P the projection to the tangent plane, the Weingarten map is
    ``P (grad grad d) P/|g|``.

    Parameters
    ----------
    d : callable
        (n, 3) -> (n,), smooth, zero on the surface, positive outside.
    gradient : callable, optional
        (n, 3) -> (n, 3), its gradient; by central differences if None. Second derivatives are
        differences of the gradient if it is given, with an error of about 1e-11 relative to the
        largest of them, and otherwise of d, with about 1e-9. Where radii of curvature are small
        against the coordinates it grows, to 1e-6 at a millionth of them, and on short waves of the
        surface, whose points of inflection look plain: to about ``2e-9 (R/w)**4`` for waves of
        length w on a surface of radius R.

    Raises
    ------
    TypeError
        If `d`, or a `gradient` that is given, is no function.

    Examples
    --------
    >>> ellipsoid = LevelSet(lambda x: (x**2 / [4, 1, 1]).sum(axis=1) - 1)
    >>> print(ellipsoid.mean_curvature(np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])).round(7))
    [4.   1.25]
    """

    d: Field
    gradient: Field | None = None

    def __post_init__(self) -> None:
        checked_gradient(self.d, self.gradient)

    def near(self, x: Array) -> Near:  # noqa: D102
        x = finite_array("x", x, ("...", 3))
        shape = x.shape
        x = x.reshape(-1, 3)
        points = project_to_level_set(self.d, self.gradient)(x)
        slope = checked_gradient(self.d, self.gradient, size_of(self.d, points))
        gradient = checked_values(slope, points, (3,), "gradient")
        size = np.linalg.norm(gradient, axis=-1, keepdims=True)
        normal = gradient / size
        P = np.eye(3) - _outer(normal)
        weingarten = P @ self._hessian(points) @ P / size[..., None]
        distance = np.sum((x - points) * normal, axis=-1)
        return Near(
            points.reshape(shape),
            distance.reshape(shape[:-1]),
            normal.reshape(shape),
            weingarten.reshape(*shape, 3),
        )

    def _hessian(self, points: Array) -> Array:
        """Second derivatives of d, (n, 3, 3)."""
        length, scale = reach(self.d, points), float(np.abs(points).max(initial=0)) or 1.0
        # The sixth root, of the rounding that there is: see `central_gradient`.
        step = DIFFERENCE * length * (scale / length) ** (1 / 6)

        def slope(function: Field, x: Array, e: Array) -> Array:
            change = derivative(lambda s: function(x + s * step[:, None] * e), order=4, step=1.0)
            return np.asarray((change.T / step).T)

        def differences(x: Array) -> Array:
            return np.stack([slope(self.d, x, e) for e in np.eye(3)], axis=-1)

        gradient = differences if self.gradient is None else self.gradient
        rows = [slope(gradient, points, e) for e in np.eye(3)]
        hessian = np.stack(rows, axis=-1)
        symmetric: Array = (hessian + np.swapaxes(hessian, 1, 2)) / 2
        return symmetric


def _outer(n: Array) -> Array:
    outer: Array = n[..., :, None] * n[..., None, :]
    return outer


def _refuse(x: Array, bad: Bools, surface: str) -> None:
    if np.any(bad):
        point = x[bad][0].tolist()
        raise ValueError(
            f"x must be near the {surface}, but {point} is too far from the {surface} to have a "
            "unique closest point"
        )
