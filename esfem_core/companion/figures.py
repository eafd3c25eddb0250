"""What several figures of the book draw in the same way.

matplotlib is needed; it is imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from esfem_core.companion.campaign import convergence, origin
from esfem_core.companion.regimes import curve
from esfem_core.output import COLOURS, MARKERS, convergence_plot, load_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from esfem_core.study import Row

__all__ = ["error_curves", "footnote", "four_panels", "slope_fan"]


def error_curves(
    ax: Axes,
    rows: Iterable[Row],
    norm: str,
    selections: Mapping[str, Mapping[str, Any]],
    thin: Iterable[Row] = (),
) -> None:
    """Draw stored errors against the step with markers, and quick ones beside them as thin lines.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    rows : iterable of Row
        For :func:`esfem_core.companion.regimes.curve`.
    norm : str
    selections : mapping of str to mapping
        Labels, and the parameters of the curves.
    thin : iterable of Row
        Other rows, of one mesh for each degree, drawn in the colour of the same degree and order.

    Examples
    --------
    >>> import matplotlib.figure
    >>> from esfem_core.study import Row
    >>> rows = [Row({"order": 1, "steps_per_unit": n}, {"l2": 1 / n}, {}) for n in (4, 8)]
    >>> ax = matplotlib.figure.Figure().subplots()
    >>> error_curves(ax, rows, "l2", {"BDF1": {"order": 1}})
    >>> len(ax.get_lines())
    1
    """
    rows, thin = list(rows), list(thin)
    looks = zip(selections.items(), cycle(COLOURS), cycle(MARKERS), strict=False)
    for (label, selection), colour, marker in looks:
        steps, errors = curve(rows, norm, **selection)
        ax.loglog(steps, errors, marker + "-", color=colour, markersize=5, label=label)
        same = {name: selection[name] for name in ("degree", "order") if name in selection}
        steps, errors = curve(thin, norm, **same)
        if len(steps):
            ax.loglog(steps, errors, "-", color=colour, linewidth=1, alpha=0.8)


def slope_fan(axes: Sequence[Axes], bottom: float, slopes: Sequence[Iterable[int]]) -> None:
    """Put ticks at the steps, and short reference lines that fan out from one point.

    Parameters
    ----------
    axes : sequence of matplotlib.axes.Axes
        With errors against steps that are powers of two.
    bottom : float
        Height of the point, which lies to the left of the smallest step of all axes.
    slopes : sequence of iterables of int
        For each of the axes.

    Raises
    ------
    ValueError
        If nothing is drawn in the axes yet.

    Examples
    --------
    >>> import matplotlib.figure
    >>> ax = matplotlib.figure.Figure().subplots()
    >>> _ = ax.loglog([1 / 4, 1 / 8], [1e-2, 5e-3])
    >>> slope_fan([ax], 1e-3, [(1, 2)])
    >>> [label.get_text() for label in ax.get_xticklabels()]
    ['1/4', '1/8']
    >>> [text.get_text() for text in ax.texts]
    ['1', '2']
    """
    drawn = [line.get_xdata() for ax in axes for line in ax.get_lines()]
    if not drawn:
        raise ValueError("axes must have curves already: the lines fan out from the smallest step")
    smallest = min(float(np.min(steps)) for steps in drawn)
    ticks = 2.0 ** -np.arange(2, 1 - np.round(np.log2(smallest)))
    ends = smallest / 3 * np.array([1, 2])
    look: dict[str, Any] = {"color": "0.3", "fontsize": 8, "textcoords": "offset points"}
    for ax, orders in zip(axes, slopes, strict=True):
        for order in orders:
            ax.loglog(ends, bottom * (ends / ends[0]) ** order, "-", color="0.5", linewidth=1)
            ax.annotate(f"{order}", (ends[1], bottom * 2**order), xytext=(2, -2), **look)
        ax.set_xticks(ticks, [f"1/{round(1 / s)}" for s in ticks], fontsize=8)
        ax.minorticks_off()
        ax.set_xlim(ends[0] / 1.3, 0.33)


def footnote(fig: Figure, text: str) -> None:
    """Say below a figure where its numbers come from, so that they go with the picture.

    Examples
    --------
    >>> import matplotlib.figure
    >>> fig = matplotlib.figure.Figure()
    >>> footnote(fig, "full mode: 3 runs")
    >>> fig.get_supxlabel()
    'full mode: 3 runs'
    """
    fig.supxlabel(text, fontsize=9, color="0.35")


def four_panels(
    rows: Sequence[Row],
    size: str,
    slopes: tuple[float, float],
    xlabel: str,
    titles: tuple[str, str],
    mode: str,
) -> Figure:
    """Errors of x and u beside each other, in L2 above H1, at the nodes and lifted.

    Parameters
    ----------
    rows : sequence of Row
        With results such as "x_l2" and "x_l2_lifted", of two rows or more.
    size : str
        "step" or "h".
    slopes : (float, float)
        Of the reference lines for L2 and H1.
    xlabel : str
    titles : (str, str)
        Of the columns.
    mode : str
        "quick" or "full", for the line below.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> from esfem_core.companion.campaign import stored
    >>> rows = stored("nick_figures_2_4", mesh="octahedron", order=5)
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> figure = four_panels(rows, "h", (3, 2), "$h$", ("Figure 2", "Figure 4"), "full")
    >>> [ax.get_title() for ax in figure.axes][:2]
    ['Figure 2: $x$, $L^2$', 'Figure 4: $u$, $L^2$']
    """
    load_matplotlib()
    from matplotlib import pyplot as plt

    fig, axes = plt.subplots(2, 2, figsize=(10, 7.6), sharey="row", constrained_layout=True)
    data = convergence(rows, size)
    norms = (("l2", "$L^2$"), ("h1", "$H^1$"))
    for line, (norm, shown), slope in zip(axes, norms, slopes, strict=True):
        for ax, q, title in zip(line, "xu", titles, strict=True):
            name = f"{q}_{norm}"
            curves = {"at the nodes": data[name], "lifted": data[f"{name}_lifted"]}
            convergence_plot(ax, data.sizes, curves, slope, xlabel)
            ax.set(title=f"{title}: ${q}$, {shown}", ylabel="")
        line[0].set_ylabel("error")
    footnote(fig, origin(mode, rows))
    figure: Figure = fig
    return figure
