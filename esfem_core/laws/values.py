"""What users' functions of a surface return, checked before anything is computed from it."""

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from esfem_core.checks import Array, check_arguments, real_array
from esfem_core.elements import NotFiniteError, Surface

__all__ = [
    "Function",
    "Once",
    "check_of_points",
    "check_of_surface",
    "finite_nodal",
    "force_at",
    "values_at",
]

Function = Callable[[Surface], Array]

OF_SURFACE = (
    "at is the Surface, with at.u and at.grad_u, or at['name'] and at.grad('name'), at.points and "
    "at.normal at its quadrature points, and the time at.t"
)


def check_of_surface(name: str, value: object) -> None:
    """Refuse a function that cannot be called with a surface; what is none is for others.

    Examples
    --------
    >>> check_of_surface("f", lambda u, du, x, t: u)
    Traceback (most recent call last):
        ...
    TypeError: f must be a function of (at), got one of (u, du, x, t); at is the Surface, with at.u
    and at.grad_u, or at['name'] and at.grad('name'), at.points and at.normal at its quadrature
    points, and the time at.t
    """
    check_arguments(name, value, "at", OF_SURFACE)


def check_of_points(name: str, value: object) -> None:
    """Refuse a function that cannot be called with points; what is none is for others.

    Examples
    --------
    >>> check_of_points("u0", lambda x, t: x[:, 0])
    Traceback (most recent call last):
        ...
    TypeError: u0 must be a function of (x), got one of (x, t); x has the nodes (N, 3) at the start
    """
    check_arguments(name, value, "x", "x has the nodes (N, 3) at the start")


def values_at(name: str, returned: Any, at: Surface, trailing: Sequence[tuple[int, ...]]) -> Array:
    """Values at the quadrature points of a surface.

    Parameters
    ----------
    name : str
        What the message calls the function.
    returned : array_like
    at : Surface
    trailing : sequence of tuples of int
        The shapes that may follow (T, Q); a number is taken as a constant of the first.

    Returns
    -------
    (T, Q, ...) float array

    Raises
    ------
    ValueError, TypeError
        If the shape is another, or the values are not real.
    NotFiniteError
        If a value is not finite; it says where.
    """
    points = at.density.shape
    values = real_array(f"what {name} returns", returned, ("...",))
    if values.ndim == 0:
        values = np.full((*points, *trailing[0]), values)
    shapes = [(*points, *shape) for shape in trailing]
    if values.shape not in shapes:
        allowed = " or ".join(map(str, shapes))
        raise ValueError(
            f"{name} must return an array of shape {allowed}, got {values.shape}"
            f"{_advice(values.shape, at, shapes)}"
        )
    finite = np.isfinite(values)
    if not finite.all():
        element, point = np.argwhere(~finite)[0, :2].tolist()
        where = np.array2string(at.points[element, point], precision=4)
        raise NotFiniteError(
            f"{name} returned {values[element, point]} in element {element} at {where}: it must be "
            "finite",
            element,
        )
    return values


def _advice(found: tuple[int, ...], at: Surface, shapes: Sequence[tuple[int, ...]]) -> str:
    """What makes values of another shape fit, as an end of a message; empty if nothing is known."""
    if found in [(len(at.x), *shape[2:]) for shape in shapes]:
        return "; of values F at the nodes, those at the points are at.space.evaluate(F)"
    for shape in shapes:
        if found == shape[2:]:
            lengths = ", ".join(map(str, found))
            return f"; a constant C is np.broadcast_to(C, (*at.density.shape, {lengths}))"
    return ""


def finite_nodal(name: str, returned: Any, shape: tuple[int, ...]) -> Array:
    """Nodal values that a function has returned in a step.

    Raises
    ------
    ValueError, TypeError
        If the shape is another, or the values are not real.
    FloatingPointError
        If a value is not finite, which ends a run as numbers do that go bad by themselves.
    """
    values = real_array(name, returned, shape)
    finite = np.isfinite(values)
    if not finite.all():
        place = tuple(np.argwhere(~finite)[0].tolist())
        found = f"{name}{list(place)} is {values[place]}"
        raise FloatingPointError(f"{name} must be finite, but {found}")
    return values


def force_at(g: Function, at: Surface) -> Array:
    """The force g nu, (T, Q, 3), of a speed g(at), (T, Q); or g(at) itself, if it is a force."""
    values = values_at("g", g(at), at, [(), (3,)])
    return values[..., None] * at.normal if values.ndim == 2 else values


Key = TypeVar("Key")
Value = TypeVar("Value")


class Once(Generic[Key, Value]):
    """A function that is computed once for each object, such as a surface, while that exists."""

    def __init__(self, function: Callable[[Key], Value]) -> None:
        self._function = function
        self._known: WeakKeyDictionary[Key, Value] = WeakKeyDictionary()

    def __call__(self, key: Key) -> Value:
        """What the function returns, or has returned."""
        if key not in self._known:
            self._known[key] = self._function(key)
        return self._known[key]

    def __reduce__(self) -> tuple[object, ...]:
        return Once, (self._function,)
