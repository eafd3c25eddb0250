"""Pictures of a surface with a function on it.

matplotlib is needed (extra ``pictures``); it is imported when a function is called, so that the
solver does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, check_even, finite_array, number, shown, string
from esfem_core.elements import SurfaceSpace
from esfem_core.output.curved import refined
from esfem_core.output.plotting import load_matplotlib
from esfem_core.stepping import State, check_state, known_space

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D

__all__ = [
    "COORDINATES",
    "PLAIN",
    "Values",
    "add_bar",
    "check_formulas",
    "colour_range",
    "cube",
    "draw",
    "nodal_values",
    "plot",
    "times_of",
]

Values = str | Callable[[State], ArrayLike] | ArrayLike | None
Cube = tuple[Array, float]  # centre, and half the length of a side

TRIANGLES = 20_000  # about so many are drawn, if the elements are not more
PIECES = 12  # of a side of an element, at most
LIGHT = {"azdeg": 315, "altdeg": 45}  # where the lamp is
PLAIN = "#9ecae1"  # colour of a surface without a function
NOISE = 1e-12  # of the largest value: what differs less, differs by rounding
COORDINATES = {f"{axis}label": f"$x_{i}$" for i, axis in enumerate("xyz", start=1)}


def plot(
    state: State,
    values: Values = None,
    *,
    ax: Axes3D | None = None,
    title: str | None = None,
    label: str | None = None,
    limits: tuple[float, float] | None = None,
) -> Axes3D:
    """Draw the surface of a state, coloured by a function, with curved elements drawn curved.

    Parameters
    ----------
    state : State
        Of a run: one that knows its space.
    values : str, callable or (N,) array, optional
        The name of a function of the state with one component; a function of the state that returns
        nodal values; or those. If not given, "u", or the only function there is.
    ax : matplotlib axes of three dimensions, optional
        To draw into; if not given, those of a new figure.
    title : str, optional
        The time, if not given.
    label : str, optional
        At the colour bar; the name of the function, if not given.
    limits : (float, float), optional
        Values of the first and the last colour; the smallest and the largest one, if not given.

    Returns
    -------
    matplotlib axes
        ``ax.figure.savefig("surface.png")`` makes a file.

    Raises
    ------
    TypeError, ValueError
        If it is no state that knows its space, or there are no such values.
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> ax = ec.plot(ec.State(0.5, space.nodes, None, space.nodes[:, 2], space=space))
    >>> ax.get_title()
    't = 0.5'
    """
    load_matplotlib()
    space = known_space(state)
    check_state(space, state)
    name, colours = nodal_values(state, values)
    label = name if label is None else label
    title = f"t = {state.t:.4g}" if title is None else title
    check_formulas("title", title)
    check_formulas("label", label)
    shades = colour_range([colours], limits)
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.figure(figsize=(6, 5)).add_subplot(projection="3d", **COORDINATES)
    elif not hasattr(ax, "add_collection3d"):
        raise TypeError(
            'ax must have three dimensions, fig.add_subplot(projection="3d"), got '
            f"{type(ax).__name__}"
        )
    scale = draw(ax, space, state.x, colours, shades, cube([state.x]))
    ax.set_title(title)
    if scale is not None:
        add_bar(ax, scale, label)
    return ax


def add_bar(ax: Axes3D, scale: Any, label: str) -> None:
    """Set a colour bar beside axes."""
    bar = ax.figure.colorbar(scale, ax=ax, shrink=0.6, pad=0.1)
    if len(label) == 1:  # a u on its side is no u; it begins beside the numbers
        bar.set_label(label, rotation=0, ha="left", va="center", labelpad=6)
    else:
        bar.set_label(label)


def check_text(name: str, text: str) -> None:
    r"""Refuse what is no text: half a character is neither drawn nor written to a file.

    Examples
    --------
    >>> check_text("title", "\ud83d")
    Traceback (most recent call last):
        ...
    ValueError: title must be text of whole characters, got '\ud83d'
    """
    try:
        string(name, text).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{name} must be text of whole characters, got {shown(text)}") from None


def check_formulas(name: str, text: str) -> None:
    r"""Refuse text whose formulas matplotlib cannot set, before anything is drawn.

    Examples
    --------
    >>> check_formulas("title", "no formula: 3 $")
    >>> check_formulas("title", r"$\frac{1}{2$")
    Traceback (most recent call last):
        ...
    ValueError: title must have formulas between $ that matplotlib can set, got '$\\frac{1}{2$'
    """
    load_matplotlib()
    from matplotlib.figure import Figure

    check_text(name, text)
    figure = Figure()
    figure.text(0, 0, text)
    try:
        figure.get_tightbbox()
    except ValueError:
        raise ValueError(
            f"{name} must have formulas between $ that matplotlib can set, got {shown(text)}"
        ) from None


def draw(
    ax: Axes3D,
    space: SurfaceSpace,
    x: Array,
    colours: Array | None,
    shades: tuple[float, float],
    room: Cube,
    many: int = TRIANGLES,
) -> Any:
    """Draw a surface into axes, with about so many triangles; returns its colour scale, or None."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LightSource, Normalize, to_rgba
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    pieces = int(np.clip(np.sqrt(many / len(space.cells)), space.degree, PIECES))
    basis, triangles = refined(space, pieces)
    corners = (basis @ x[space.cells]).reshape(-1, 3)[triangles]
    scale = None
    faces: Any = np.tile(to_rgba(PLAIN), (len(triangles), 1))
    if colours is not None:
        scale = ScalarMappable(Normalize(*shades), colormaps["viridis"])
        at_points = (basis @ colours[space.cells][..., None]).ravel()
        faces = scale.to_rgba(at_points[triangles].mean(axis=1))
    # Edges of the faces' colours close the hairlines that antialiasing leaves between faces.
    surface = Poly3DCollection(
        corners, facecolors=faces, edgecolors=faces, linewidths=0.3, shade=True,
        lightsource=LightSource(**LIGHT),
    )  # fmt: skip
    surface.set_rasterized(True)  # thousands of polygons would make a vector file slow
    ax.add_collection3d(surface)
    centre, reach = room
    for axis, middle in zip("xyz", centre.tolist(), strict=True):
        ax.set(**{f"{axis}lim": (middle - reach, middle + reach)})
    ax.set_box_aspect((1, 1, 1))
    return scale


def nodal_values(state: State, values: Values) -> tuple[str, Array | None]:
    """Name and nodal values, (N,), of the function to draw; None if the state has no function."""
    if values is None:
        if not state.fields:
            return "", None
        if "u" not in state.fields and len(state.fields) > 1:
            known = ", ".join(map(repr, state.fields))
            raise ValueError(
                f"values must name the function to draw, one of {known}: the state has several and "
                "none is called 'u'"
            )
        values = "u" if "u" in state.fields else next(iter(state.fields))
    name, chosen = "", values
    if isinstance(values, str):
        if values not in state.fields:
            known = ", ".join(map(repr, state.fields)) or "none"
            raise ValueError(f"values must name a function of the state ({known}), got {values!r}")
        name, chosen = values, state[values]
        if chosen.ndim > 1:
            raise ValueError(
                f"{values!r} has {chosen.shape[1]} components: draw one of them, such as "
                f"values=lambda state: state[{values!r}][:, 0]"
            )
    elif callable(values):
        chosen = values(state)
    return name, finite_array("values", chosen, (len(state.x),))  # type: ignore[arg-type]


def colour_range(
    colours: Sequence[Array | None], limits: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Values of the first and the last colour; those that agree to twelve digits have one colour.

    Examples
    --------
    >>> colour_range([np.array([1.0, 3.0]), np.array([2.0, 4.0])])
    (1.0, 4.0)
    >>> colour_range([np.full(3, 2.0) + [0, 1e-15, 0]]), colour_range([np.zeros(3)])
    ((1.0, 3.0), (-0.5, 0.5))
    """
    if limits is not None:
        check_even("limits", limits)
        if np.ndim(limits) != 1 or len(limits) != 2:
            raise ValueError(f"limits must be a pair (lowest, highest), got {shown(limits)}")
        lowest = number("limits[0]", limits[0])
        return lowest, number("limits[1]", limits[1], above=lowest)
    drawn = [c for c in colours if c is not None]
    low = min((float(c.min()) for c in drawn), default=0.0)
    high = max((float(c.max()) for c in drawn), default=1.0)
    if high - low > NOISE * max(abs(low), abs(high)):
        return low, high
    beside = abs(low) / 2 or 0.5  # a colour bar shows its one value in the middle
    return low - beside, low + beside


def cube(positions: Sequence[Array]) -> Cube:
    """A cube with room for all positions."""
    low = np.min([x.min(axis=0) for x in positions], axis=0)
    high = np.max([x.max(axis=0) for x in positions], axis=0)
    return (low + high) / 2, float((high - low).max()) / 2


def times_of(times: Sequence[float]) -> list[str]:
    """Times of frames in words: with four digits, or as many as tell neighbours apart.

    Those that agree to twelve digits are the same but for rounding.

    Examples
    --------
    >>> times_of([0.0, 1 / 3, 12345.6])
    ['0', '0.3333', '1.235e+04']
    >>> times_of([12345.6, 12346.4, 12346.4, 0.1 + 0.2, 0.3])
    ['12345.6', '12346.4', '12346.4', '0.3', '0.3']
    """
    most = [f"{t:.12g}" for t in times]
    for digits in range(4, 12):
        found = [f"{t:.{digits}g}" for t in times]
        frames = zip(most, found, strict=True)
        if all(a != b or s == t for (s, a), (t, b) in pairwise(frames)):
            return found
    return most
