"""A wrong state is never yielded as good: what is looked at in every step."""

import warnings
from collections.abc import Mapping

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from esfem_core.checks import Array, Ints
from esfem_core.elements import DegenerateElementError, SurfaceSpace
from esfem_core.surfaces import FLATTEST

__all__ = ["EvolutionWarning", "Guard"]

NARROW = 0.02  # below this, an angle of about 0.7 degrees, a run will not survive for long
NARROW_TURN = 0.5  # cosine: a narrow triangle turns by 60 degrees within a step at most
SHAPE = 2 * np.sqrt(3)  # makes the shape of an equilateral triangle 1
GROWTH = 1e6  # of the largest value since the start: from here on worth a warning


class EvolutionWarning(UserWarning):
    """A run will hardly survive, cannot be saved, or has a slip that is not tangential."""


class Guard:
    """Looks at the triangles between the corners of the elements, and at the size of functions.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Positions at the start.
    fields : mapping of str to (N, ...) float array
        Functions at the start.
    growth : float
        Factor by which the largest value of a function may grow.
    """

    def __init__(
        self, space: SurfaceSpace, x: Array, fields: Mapping[str, Array], growth: float
    ) -> None:
        self._corners = np.ascontiguousarray(space.cells[:, :3].T)
        self._component = _components(self._corners, len(space.nodes))
        self._several = bool(self._component.any())
        at_boundary = np.isin(self._corners, space.boundary_nodes).any(axis=0)
        self._closed = ~np.isin(np.arange(self._component.max() + 1), self._component[at_boundary])
        self._growth = growth
        self._size = {name: float(np.abs(w).max()) for name, w in fields.items()}
        self._warned: set[str] = set()
        self._normal, volume, sides = self._triangles(x)
        self._inside_out = (volume < 0) & self._closed  # cavities
        self._narrow = min(NARROW, 0.5 * float(_shapes(self._normal, sides).min()))

    def check_surface(self, x: Array) -> None:
        """Refuse a surface with a degenerate or turned triangle, or one that is inside out.

        Components with a boundary have no inside.

        Raises
        ------
        DegenerateElementError
        """
        normal, volume, sides = self._triangles(x)
        # One comparison for all; only where it fails, triangle by triangle.
        bound = (self._narrow / SHAPE) * sides
        bound *= bound
        if not (_dot(normal, normal) > bound).all():
            self._look_closer(x, normal, _shapes(normal, sides))
        turn = _dot(normal, self._normal)
        if not turn.min() > 0:
            element = int(np.argmin(turn))
            raise DegenerateElementError(
                f"element {element} near {self._place(x, element)} has turned over: its normal "
                "changed by more than a right angle within a step",
                element,
            )
        inside_out = (volume < 0) & self._closed
        if (inside_out != self._inside_out).any():
            component = int(np.argmax(inside_out != self._inside_out))
            element = int(np.argmax(self._component == component))
            which = f"component {component} of the surface" if len(volume) > 1 else "the surface"
            raise DegenerateElementError(
                f"{which} is inside out (enclosed volume {volume[component]:.3g}), near "
                f"{self._place(x, element)}: it has shrunk to a point or passed through itself",
                element,
            )
        self._normal = normal

    def _look_closer(self, x: Array, normal: Array, shape: Array) -> None:
        """Refuse a degenerate triangle or a narrow one that turns, warn of another narrow one."""
        lowest = int(np.argmin(shape))
        place = f"element {lowest} near {self._place(x, lowest)}"
        if not shape[lowest] > FLATTEST:
            finite = np.isfinite(normal[:, lowest]).all()
            what = "is degenerate" if finite else "is not finite"
            raise DegenerateElementError(f"{place} {what}", lowest)
        # A neck closes within a step, and its triangles come out on the other side of its axis;
        # since they are not opposite each other, some turn by a little less than a right angle.
        before = self._normal
        sizes = np.sqrt(_dot(normal, normal) * _dot(before, before))
        turned = (_dot(normal, before) < NARROW_TURN * sizes) & (shape < self._narrow)
        if turned.any():
            element = int(np.argmax(turned))
            raise DegenerateElementError(
                f"element {element} near {self._place(x, element)}, with an angle below one "
                "degree, has turned over: its normal changed by more than 60 degrees within a step",
                element,
            )
        self._warn_once(
            "angles",
            f"{place} has an angle below one degree: the run will hardly survive; other "
            "triangles, a smaller step, or alpha > 0 may help",
        )

    def check_functions(self, x: Array, fields: Mapping[str, Array]) -> None:
        """Refuse functions that are not finite or have grown beyond all bounds.

        Raises
        ------
        FloatingPointError
        """
        for name, w in fields.items():
            largest = float(max(w.max(), -w.min()))
            if not np.isfinite(largest):
                node = int(np.argmin(np.isfinite(w).reshape(len(w), -1).all(axis=1)))
                raise FloatingPointError(
                    f"{name} is not finite at node {node} near {_rounded(x[node])}"
                )
            start = self._size.get(name) or largest
            self._size[name] = start
            if largest <= min(GROWTH, self._growth) * start:
                continue
            node = int(np.argmax(np.abs(w).reshape(len(w), -1).max(axis=1)))
            text = (
                f"{name} has grown to {largest:.3g}, {largest / start:.1g} times its largest value "
                f"at the start, at node {node} near {_rounded(x[node])}: the step is too large "
                "for what is explicit, or the solution blows up"
            )
            if largest > self._growth * start:
                raise FloatingPointError(f"{text} (allowed: growth = {self._growth:g} times)")
            self._warn_once(name, text)

    def _triangles(self, x: Array) -> tuple[Array, Array, Array]:
        """Normals of twice the area, (3, T), volumes of components, sums of squared sides, (T,)."""
        a, b, c = np.ascontiguousarray(x.T).take(self._corners, axis=1).swapaxes(0, 1)
        p, q = b - a, c - a
        normal = np.empty_like(p)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(p[j], q[k], out=normal[i])
            normal[i] -= p[k] * q[j]
        a = a - x[0][:, None]  # volumes by differences, so that they are exact far from the origin
        if self._several:
            volume = np.bincount(self._component, _dot(a, normal)) / 6
        else:
            volume = np.array([np.vdot(a, normal) / 6])
        squares = q * (q - p)
        squares += p * p
        return normal, volume, 2 * squares.sum(axis=0)

    def _place(self, x: Array, element: int) -> str:
        return _rounded(x[self._corners[:, element]].mean(axis=0))

    def _warn_once(self, kind: str, text: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, EvolutionWarning, stacklevel=5)  # the loop over the run


def _components(corners: Ints, n_nodes: int) -> Ints:
    """Which component of the surface each element belongs to, (T,)."""
    links = corners[[0, 1, 1, 2]].reshape(2, 2, -1)
    graph = coo_array(
        (np.ones(links[:, 0].size), (links[:, 0].ravel(), links[:, 1].ravel())), (n_nodes, n_nodes)
    )
    label = connected_components(graph, directed=False)[1]
    return np.unique(label[corners[0]], return_inverse=True)[1].astype(np.int64)


def _dot(a: Array, b: Array) -> Array:
    out: Array = np.einsum("it,it->t", a, b)
    return out


def _shapes(normal: Array, sides: Array) -> Array:
    """4 sqrt(3) area / (sum of squared sides), (T,)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shape: Array = SHAPE * np.sqrt(_dot(normal, normal)) / sides
    return shape


def _rounded(point: Array) -> str:
    return np.array2string(point, precision=4)
