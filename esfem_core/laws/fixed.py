"""Values that are given at nodes, those of the boundary if no others are named: Dirichlet data."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from esfem_core.checks import (
    Array,
    Ints,
    ReadOnly,
    check_arguments,
    check_even,
    finite_array,
    frozen,
    integer_array,
    number,
    real_array,
    shown,
)
from esfem_core.elements import SurfaceSpace

__all__ = ["Fixed"]

KINDS = "a number, a function g(x, t), or a pair (nodes, values)"


@dataclass(frozen=True, eq=False)
class Fixed(ReadOnly):
    """What ``Species(fixed=...)`` says.

    Attributes
    ----------
    values : float, (B, ...) float array or callable
        The values; ``values(x, t)`` at the present positions x, (B, 3), of the nodes.
    where : (B,) int or (N,) bool array, or None
        The nodes, or which of all; None for those of the boundary.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    >>> poles = Fixed.of((np.abs(space.nodes[:, 2]) == 1, lambda x, t: t * x[:, 2]))
    >>> nodes = poles.nodes("u", space)
    >>> nodes.tolist(), poles.at("u", space.nodes[nodes], 2.0, ()).tolist()
    ([2, 5], [2.0, -2.0])
    """

    values: Any
    where: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _values(self.values))
        if self.where is not None:
            object.__setattr__(self, "where", _where(self.where))

    @classmethod
    def of(cls, given: Any) -> "Fixed":
        """What was given as `fixed`, checked as far as it can be without a space.

        Raises
        ------
        TypeError, ValueError
            If it is nothing of the kind, or not finite.
        """
        if isinstance(given, Fixed):
            return given
        if isinstance(given, list):
            raise TypeError(f"fixed must be {KINDS}, got {shown(given)}; a pair is a tuple")
        if not isinstance(given, tuple):
            if not callable(given):
                check_even("fixed", given)
                if np.ndim(given) > 0:
                    raise TypeError(f"fixed must be {KINDS}, got {shown(given)}")
            return cls(given)
        if len(given) != 2:
            raise ValueError(f"fixed must be {KINDS}, got {len(given)} things")
        where, values = given
        return cls(values, _where(where))

    def may_be(self, other: "Fixed | None") -> bool:
        """Whether the two are the same, as far as can be seen: functions are not compared."""
        if other is None:
            return False
        functions = callable(self.values) and callable(other.values)
        same = functions or np.array_equal(self.values, other.values)
        return bool(same and np.array_equal(self.where, other.where))

    def nodes(self, name: str, space: SurfaceSpace) -> Ints:
        """Numbers of the nodes, (B,).

        Parameters
        ----------
        name : str
            Of the species.
        space : SurfaceSpace

        Raises
        ------
        ValueError
            If there are none, or no such ones in this space.
        """
        called, n = f"the nodes of fixed of {name!r}", len(space.nodes)
        if self.where is None:
            if len(space.boundary_nodes) == 0:
                raise ValueError(
                    f"fixed of {name!r} gives values at the boundary, but the surface of space has "
                    "none: name the nodes, fixed=(nodes, values)"
                )
            return space.boundary_nodes
        if self.where.dtype == bool:
            if self.where.shape != (n,):
                raise ValueError(
                    f"{called} must be numbers, or a bool for each of {n} nodes, got shape "
                    f"{self.where.shape}"
                )
            nodes = np.flatnonzero(self.where)
        else:
            nodes = self.where
        if len(nodes) == 0:
            raise ValueError(f"{called} must be one at least, got none; fixed=None fixes nothing")
        if not 0 <= nodes.min() <= nodes.max() < n:
            raise ValueError(f"{called} must lie in 0 to {n - 1}, got {nodes.min()}, {nodes.max()}")
        if len(np.unique(nodes)) < len(nodes):
            repeated = np.sort(nodes)[:-1][np.diff(np.sort(nodes)) == 0][0]
            raise ValueError(f"{called} must not be repeated, but {repeated} is")
        return np.asarray(nodes)

    def at(self, name: str, x: Array, t: float, trailing: tuple[int, ...]) -> Array:
        """Values at the nodes.

        Parameters
        ----------
        name : str
            Of the species.
        x : (B, 3) float array
            Positions of the nodes.
        t : float
        trailing : tuple of int
            Shape of a value.

        Returns
        -------
        (B, ...) float array

        Raises
        ------
        ValueError, TypeError
            If the shape is another.
        FloatingPointError
            If a value is not finite.
        """
        called, shape = f"fixed of {name!r}", (len(x), *trailing)
        given = self.values(x.copy(), t) if callable(self.values) else self.values
        values = real_array(called, given, ("...",))
        if values.ndim == 0:
            values = np.full(shape, values)
        values = real_array(called, values, shape)
        if not np.isfinite(values).all():
            node = int(np.argmin(np.isfinite(values).reshape(len(x), -1).all(axis=1)))
            where = np.array2string(x[node], precision=4)
            raise FloatingPointError(
                f"{called} must be finite, but is not at {where} at t = {t:.6g}"
            )
        return values


def _where(given: Any) -> Any:
    if given is None:
        raise TypeError("the nodes of fixed must be numbers of nodes or a bool for each, got None")
    check_even("the nodes of fixed", given)
    if np.asarray(given).dtype != bool:
        given = integer_array("the nodes of fixed", given, ("B",))
    return frozen(np.asarray(given))


def _check_number(given: Any) -> None:
    """Refuse what is no number, and say what else there is."""
    try:
        number("fixed", given)
    except TypeError:
        raise TypeError(f"fixed must be {KINDS}, got {shown(given)}") from None


def _values(given: Any) -> Any:
    if isinstance(given, type):
        raise TypeError(f"fixed must be {KINDS}, got {shown(given)}")
    if callable(given):
        check_arguments("fixed", given, "x, t", "x has its nodes (B, 3), t is the time")
        return given
    check_even("the values of fixed", given)
    if np.ndim(given) == 0:
        _check_number(given)
        return number("fixed", given)
    return frozen(finite_array("the values of fixed", given, ("B", "...")))
