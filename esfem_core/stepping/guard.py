"""A wrong state is never yielded as good: what is looked at in every step."""

import warnings
from collections.abc import Mapping

import numpy as np

from esfem_core.checks import Array, level_outside
from esfem_core.elements import DegenerateElementError, SurfaceSpace
from esfem_core.stepping.folding import fold_of
from esfem_core.surfaces import FLATTEST, components

__all__ = ["EvolutionWarning", "Guard"]

NARROW = 0.02  # below this, an angle of about 0.7 degrees, a run will not survive for long
NARROW_TURN = 0.5  # cosine: a narrow triangle turns by 60 degrees within a step at most
SHAPE = 2 * np.sqrt(3)  # makes the shape of an equilateral triangle 1
GROWTH = 1e6  # of the largest value since the start: from here on worth a warning
HUGE = 1e100  # no quantity: from here on worth a warning, wherever a run has started
FLUX = "a gradient in a flux may need steps below a multiple of h^2, see esfem_core.Species"


class EvolutionWarning(UserWarning):
    """A run will hardly survive, folds, loses digits, is not saved, or has no tangential slip."""


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
        Factor by which the largest value of a function may grow, unless that is zero.
    """

    def __init__(
        self, space: SurfaceSpace, x: Array, fields: Mapping[str, Array], growth: float
    ) -> None:
        self._corners = np.ascontiguousarray(space.cells[:, :3].T)
        self._component = components(space.cells[:, :3])
        self._several = bool(self._component.any())
        at_boundary = np.isin(self._corners, space.boundary_nodes).any(axis=0)
        self._closed = ~np.isin(np.arange(self._component.max() + 1), self._component[at_boundary])
        self._growth = growth
        self._largest = {name: float(np.abs(w).max()) for name, w in fields.items()}
        self._warned: set[str] = set()
        self._x = self._before = x
        self._normal, volume, sides = self._triangles(x)
        shape = _shapes(self._normal, sides)
        self._size = shape * sides
        self._inside_out = (volume < 0) & self._closed  # cavities
        self._narrow = min(NARROW, 0.5 * float(shape.min()))
        self._reach = self._safe_distance(shape, sides, volume)

    def look_at_surface(self, x: Array) -> None:
        """Refuse a surface with a degenerate or turned triangle, or one that is inside out.

        Components with a boundary have no inside: of these a triangle that turns in its plane is
        warned of, as all do when a surface passes through a point. Triangles are looked at again
        when nodes have moved so far that one of them could have become narrow or turned.

        Parameters
        ----------
        x : (N, 3) float array
            Positions after a step; they must stay as they are.

        Raises
        ------
        DegenerateElementError
        """
        if not np.abs(x - self._x).max() <= self._reach:
            normal, volume, sides = self._triangles(x)
            shape = _shapes(normal, sides)
            size = shape * sides
            # A normal that is within 60 degrees of the one looked at last, is within a right angle
            # of the one before this step.
            upright = _dot(normal, self._normal) > 0.5 / SHAPE**2 * size * self._size
            if not (upright.all() and shape.min() > self._narrow):
                self._look_closer(x, normal, shape)
            self._look_inside(x, volume)
            self._warn_of_sides(x)
            self._x, self._normal, self._size = x, normal, size
            self._reach = self._safe_distance(shape, sides, volume)
        self._before = x

    def _safe_distance(self, shape: Array, sides: Array, volume: Array) -> float:
        """How far each coordinate of each node may change until triangles are looked at again.

        Let nodes move by d <= h / 10, where h is the smallest height and L the longest side of a
        triangle. Sides change by 2 d at most, and twice the area vector by 4 d L + 4 d^2, less than
        half of it: the normal turns by less than 30 degrees, and more than a third is left of the
        shape. The volume of a component changes by less than 1.5 d times its area.
        """
        flattest = float(shape.min())
        if not flattest > 3 * self._narrow:
            return 0.0
        # h = |n| / L, and the sum of squared sides is 1.5 L^2 or more.
        height = flattest * np.sqrt(1.5 * sides.min()) / SHAPE
        area = self._by_component(self._size) / (2 * SHAPE)
        thickness = (abs(volume) / area)[self._closed].min(initial=np.inf)
        return float(min(height / 10, thickness / 2) / np.sqrt(3))

    def _look_closer(self, x: Array, normal: Array, shape: Array) -> None:
        """Refuse a degenerate or turned triangle, or a narrow one that turns; warn of another."""
        before = self._normal if self._before is self._x else self._triangles(self._before)[0]
        if not (shape > self._narrow).all():
            self._look_at_narrow(x, normal, shape, before)
        turn = _dot(normal, before)
        if not turn.min() > 0:
            element = int(np.argmin(turn))
            raise DegenerateElementError(
                f"element {element} near {self._place(x, element)} has turned over: its normal "
                "changed by more than a right angle within a step; a smaller step, or a smaller "
                "rate of a slip, laws.Elastic(rate=...), may help",
                element,
            )

    def _look_at_narrow(self, x: Array, normal: Array, shape: Array, before: Array) -> None:
        """Refuse a degenerate triangle or a narrow one that turns, warn of another narrow one."""
        lowest = int(np.argmin(shape))
        place = f"element {lowest} near {self._place(x, lowest)}"
        if not shape[lowest] > FLATTEST:
            finite = np.isfinite(normal[:, lowest]).all()
            what = "is degenerate" if finite else "is not finite"
            raise DegenerateElementError(f"{place} {what}", lowest)
        # A neck closes within a step, and its triangles come out on the other side of its axis;
        # since they are not opposite each other, some turn by a little less than a right angle.
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

    def _look_inside(self, x: Array, volume: Array) -> None:
        """Refuse a component that has become inside out."""
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

    def _warn_of_sides(self, x: Array) -> None:
        """Warn, once, of a triangle of a component with a boundary that turns within its plane."""
        if self._closed.all():
            return
        turned = ~self._closed[self._component]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            a, b = self._corners[i], self._corners[j]
            turned &= np.vecdot(x[b] - x[a], self._before[b] - self._before[a]) < 0
        if turned.any():
            element = int(np.argmax(turned))
            self._warn_once(
                "sides",
                f"element {element} near {self._place(x, element)} has turned within its plane: "
                "its sides changed direction by more than a right angle within a step, as when a "
                "surface with a boundary shrinks to a point and comes out inside out; then results "
                "mean nothing from now on",
            )

    def warn_of_folds(self, x: Array, space: SurfaceSpace) -> None:
        """Warn, once, of a surface that has come to lie on itself.

        It is looked at where its triangles have just been.

        Parameters
        ----------
        x : (N, 3) float array
            The positions that :meth:`look_at_surface` was given last.
        space : SurfaceSpace
        """
        if x is not self._x or "folds" in self._warned:
            return
        fold = fold_of(space, x, self._normal)
        if fold is not None:
            element, what = fold
            self._warn_once(
                "folds",
                f"element {element} near {self._place(x, element)} {what}: the surface is folded "
                "more finely than its elements can follow, and results there mean little from now "
                "on; a slip, other triangles (ec.remeshed), or a finer mesh may help",
            )

    def look_at_functions(self, x: Array, fields: Mapping[str, Array]) -> None:
        """Refuse functions that are not finite or have grown beyond all bounds.

        Nothing is a multiple of zero: a function that starts from it has no bound. Beyond 1e100, of
        which a run that goes on in pieces may know nothing, it warns.

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
            if largest > max(HUGE, 2 * self._largest[name]):
                self._warn_once(
                    f"size of {name}",
                    f"{name} has grown to {largest:.3g}, which measures nothing: the step is too "
                    f"large for what is explicit, or the solution blows up; {FLUX}; a run that "
                    "goes on from states begins anew to compare values with those at its start",
                )
            start = self._largest[name]
            if start == 0 or largest <= min(GROWTH, self._growth) * start:
                continue
            node = int(np.argmax(np.abs(w).reshape(len(w), -1).max(axis=1)))
            text = (
                f"{name} has grown to {largest:.3g}, {largest / start:.1g} times its largest value "
                f"at the start, at node {node} near {_rounded(x[node])}: the step is too large "
                "for what is explicit, or the solution blows up"
            )
            if largest > self._growth * start:
                raise FloatingPointError(
                    f"{text}, or the surface shrinks to a point, which makes grow what is "
                    f"conserved: it is {np.ptp(x, axis=0).max():.2g} across (allowed: growth = "
                    f"{self._growth:g} times; growth=inf lets it go on, such as from values that "
                    f"are zero but for rounding); {FLUX}"
                )
            self._warn_once(name, f"{text}; {FLUX}")

    def _triangles(self, x: Array) -> tuple[Array, Array, Array]:
        """Normals of twice the area, (3, T), volumes of components, sums of squared sides, (T,)."""
        a, b, c = np.ascontiguousarray(x.T).take(self._corners, axis=1).swapaxes(0, 1)
        p, q = b - a, c - a
        normal = np.empty_like(p)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(p[j], q[k], out=normal[i])
            normal[i] -= p[k] * q[j]
        a = a - x[0][:, None]  # volumes by differences, so that they are exact far from the origin
        volume = self._by_component(_dot(a, normal)) / 6
        sides = _dot(p, p)
        sides += _dot(q, q)
        sides -= _dot(p, q)
        sides *= 2  # |p - q|^2 is p^2 + q^2 - 2 p.q
        return normal, volume, sides

    def _by_component(self, values: Array) -> Array:
        """Sums over the triangles of each component."""
        sums: Array = values.sum(keepdims=True)
        if self._several:
            sums = np.bincount(self._component, values).astype(float, copy=False)
        return sums

    def _place(self, x: Array, element: int) -> str:
        return _rounded(x[self._corners[:, element]].mean(axis=0))

    def _warn_once(self, kind: str, text: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, EvolutionWarning, stacklevel=level_outside())


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
