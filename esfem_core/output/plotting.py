"""Convergence plots, and how the book's plots look.

matplotlib is needed (extra ``pictures``); it is imported when a function is called, so that the
solver does not depend on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, finite_array, mapping, number, package, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["COLOURS", "MARKERS", "convergence_plot", "load_matplotlib", "style"]

# Okabe and Ito's palette, which colour-blind readers can tell apart; markers differ as well.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours of curves, one after the other."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Markers of curves, one after the other."""

MAX_TICKS = 6  # on the axis of a convergence plot


def load_matplotlib() -> Any:
    """Matplotlib; where it is missing, how it is installed."""
    return package("pictures need Matplotlib", "matplotlib", "pictures")


def style() -> None:
    """Set up matplotlib for the book: SVG, readable sizes, colours everyone can tell apart.

    Raises
    ------
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> style()
    >>> import matplotlib
    >>> matplotlib.rcParams["svg.hashsalt"]
    'esfem'
    """
    mpl = load_matplotlib()
    from cycler import cycler

    mpl.rcParams.update(
        {
            "figure.figsize": (6.4, 4.0),
            "figure.dpi": 100,
            "font.size": 11,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.prop_cycle": cycler(color=COLOURS),
            "legend.frameon": False,
            "legend.fontsize": 10,
            "lines.linewidth": 1.6,
            "image.cmap": "viridis",
            "svg.hashsalt": "esfem",  # the same picture is the same file
        }
    )
    try:
        from matplotlib_inline.backend_inline import set_matplotlib_formats

        set_matplotlib_formats("svg", bbox_inches="tight", metadata={"Date": None})
    except (ImportError, AttributeError):  # not in a notebook
        pass


def convergence_plot(
    ax: Axes,
    sizes: ArrayLike,
    errors: Mapping[str, ArrayLike],
    order: float,
    xlabel: str,
) -> None:
    r"""Draw errors against step or mesh size, both logarithmic, with a reference slope.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    sizes : (n,) floats
        Step or mesh sizes; at least two, all different.
    errors : mapping of str to (n,) floats
        One curve each. The legend adds the order observed: the slope of the least-squares line
        through the logarithms.
    order : float
        Slope of the dashed reference line, drawn a little below the smallest curve.
    xlabel : str
        For example ``r"$\tau$"``.

    Raises
    ------
    TypeError, ValueError
        If lengths differ, there are fewer than two different sizes or no errors, or a number is
        not positive and finite.

    Examples
    --------
    >>> import matplotlib.figure
    >>> ax = matplotlib.figure.Figure().subplots()
    >>> convergence_plot(ax, [0.1, 0.05], {"position": [1e-3, 1.25e-4]}, 3, "step")
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['position (order 3.00)', 'slope 3']
    """
    h = _positive("sizes", sizes, ("n",))
    order = number("order", order)
    if len(np.unique(h)) < 2:
        raise ValueError(f"sizes must hold at least two different ones, got {h.tolist()}")
    if not mapping("errors", errors, "one number for each size"):
        raise ValueError("errors must hold at least one curve, got none")
    if not hasattr(ax, "loglog"):
        raise TypeError(f"ax must be axes of matplotlib, got {shown(ax)}")
    curves = {label: _positive(f"errors[{label!r}]", e, h.shape) for label, e in errors.items()}
    if hidden := [label for label in curves if label.startswith("_")]:
        raise ValueError(
            f"errors must not have names that begin with _, which no legend shows, got {hidden}"
        )
    for i, (label, e) in enumerate(curves.items()):
        rate = np.polyfit(np.log(h), np.log(e), 1)[0]
        ax.loglog(
            h,
            e,
            color=COLOURS[i % len(COLOURS)],
            marker=MARKERS[i % len(MARKERS)],
            label=f"{label} (order {rate:z.2f})",
        )
    ends = np.array([h.min(), h.max()])
    base = 0.5 * min(float(np.min(e / h**order)) for e in curves.values())
    ax.loglog(ends, base * ends**order, "--", color="0.4", label=f"slope {order:g}")
    ticks = h[:: -(-len(h) // MAX_TICKS)]
    ax.set_xticks(ticks, [_size_label(size) for size in ticks])
    ax.xaxis.minorticks_off()
    ax.set_xlabel(xlabel)
    ax.set_ylabel("error")
    ax.legend()


def _size_label(size: float) -> str:
    """Write 1/n where that is exact, else two digits."""
    n = round(1 / size)
    return f"1/{n}" if n > 1 and abs(n * size - 1) < 1e-9 else f"{size:.2g}"


def _positive(name: str, values: ArrayLike, shape: Sequence[int | str]) -> Array:
    array = finite_array(name, values, shape)
    if not (array > 0).all():
        raise ValueError(f"{name} must be positive to have logarithms, got {array.min():g}")
    return array
