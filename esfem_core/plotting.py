"""Pictures for notebooks: convergence plots and moving surfaces.

matplotlib and plotly are needed (``pip install esfem-core[book]``); they are imported when a
function is called, so that the solver does not depend on them.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from esfem_core.lagrange import node_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from esfem_core.surface import SurfaceSpace

__all__ = [
    "Html",
    "convergence_plot",
    "flat_triangles",
    "html_table",
    "style",
    "surface_animation",
]

# Okabe and Ito's palette, which colour-blind readers can tell apart; markers differ as well.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MAX_TICKS = 6
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")


class Html:
    """A piece of HTML that a notebook shows.

    Parameters
    ----------
    text : str
        The HTML.
    alternative : str
        What to show where HTML cannot be shown.
    """

    def __init__(self, text: str, alternative: str) -> None:
        self.text = text
        self.alternative = alternative

    def __repr__(self) -> str:
        return self.alternative

    def _repr_html_(self) -> str:
        return self.text


def html_table(header: Iterable[object], rows: Iterable[Iterable[object]], kind: str = "") -> Html:
    """Make a table that scrolls where the page is too narrow for it.

    Parameters
    ----------
    header : iterable
        Heads of the columns.
    rows : iterable of iterables
        Cells, written with ``str``; they may hold HTML.
    kind : str
        Further CSS classes.

    Returns
    -------
    Html

    Examples
    --------
    >>> html_table(["p", "order"], [[1, "0.99"]])
    p order
    1 0.99
    """
    heads, lines = [str(cell) for cell in header], [[str(cell) for cell in row] for row in rows]
    head = "".join(f'<th scope="col">{cell}</th>' for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in line) + "</tr>" for line in lines)
    css = f"esfem-table {kind}".strip()
    return Html(
        f'<div class="{css}"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>",
        "\n".join(" ".join(line) for line in [heads, *lines]),
    )


def style() -> None:
    """Set up matplotlib for the book: SVG, readable sizes, colours everyone can tell apart.

    Examples
    --------
    >>> style()
    >>> import matplotlib
    >>> matplotlib.rcParams["svg.hashsalt"]
    'esfem'
    """
    import matplotlib as mpl
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
            "axes.prop_cycle": cycler(color=_COLOURS),
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
    steps: ArrayLike,
    errors: Mapping[str, ArrayLike],
    order: float,
    xlabel: str,
) -> None:
    r"""Draw errors against step or mesh size, both logarithmic, with a reference slope.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    steps : (n,) floats
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
    ValueError
        If lengths differ, there are fewer than two steps, or a number is not positive and finite.

    Examples
    --------
    >>> import matplotlib.figure
    >>> ax = matplotlib.figure.Figure().subplots()
    >>> convergence_plot(ax, [0.1, 0.05], {"position": [1e-3, 1.25e-4]}, 3, "step")
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['position (order 3.00)', 'slope 3']
    """
    h = _positive("steps", steps)
    curves = {label: _positive(label, e) for label, e in errors.items()}
    if h.ndim != 1 or len(np.unique(h)) < 2 or any(e.shape != h.shape for e in curves.values()):
        raise ValueError(
            f"at least two different steps and as many errors are needed, got {h.shape} steps and "
            f"errors of shapes {[e.shape for e in curves.values()]}"
        )
    for i, (label, e) in enumerate(curves.items()):
        rate = np.polyfit(np.log(h), np.log(e), 1)[0]
        ax.loglog(
            h,
            e,
            color=_COLOURS[i % len(_COLOURS)],
            marker=_MARKERS[i % len(_MARKERS)],
            label=f"{label} (order {rate:.2f})",
        )
    ends = np.array([h.min(), h.max()])
    base = 0.5 * min(float(np.min(e / h**order)) for e in curves.values())
    ax.loglog(ends, base * ends**order, "--", color="0.4", label=f"slope {order:g}")
    shown = h[:: -(-len(h) // MAX_TICKS)]
    ax.set_xticks(shown, [_size_label(size) for size in shown])
    ax.xaxis.minorticks_off()
    ax.set_xlabel(xlabel)
    ax.set_ylabel("error")
    ax.legend()


def _size_label(size: float) -> str:
    """Write 1/n where that is exact, else two digits."""
    n = round(1 / size)
    return f"1/{n}" if n > 1 and abs(n * size - 1) < 1e-9 else f"{size:.2g}"


def flat_triangles(cells: NDArray[np.int64], degree: int) -> NDArray[np.int64]:
    """Split each element of degree k into k² flat triangles between its nodes.

    Parameters
    ----------
    cells : (T, (k+1)(k+2)/2) int array
        Node numbers in VTK's Lagrange order.
    degree : int
        The degree k.

    Returns
    -------
    (k² T, 3) int array
        Triangles with the orientation of their element, the k² of an element in succession.

    Examples
    --------
    >>> flat_triangles(np.array([[0, 1, 2, 3, 4, 5]]), 2).tolist()
    [[0, 3, 5], [3, 4, 5], [3, 1, 4], [5, 4, 2]]
    """
    number = {(int(b), int(c)): i for i, (_, b, c) in enumerate(node_indices(degree))}
    local = []
    for c in range(degree):
        for b in range(degree - c):
            local.append([number[b, c], number[b + 1, c], number[b, c + 1]])
            if b + c < degree - 1:
                local.append([number[b + 1, c], number[b + 1, c + 1], number[b, c + 1]])
    return cells[:, np.array(local)].reshape(-1, 3)


def surface_animation(
    space: SurfaceSpace,
    states: Iterable[Any],
    values: Callable[[Any], ArrayLike] | None = None,
    *,
    title: str = "",
    label: str = "u",
    div_id: str = "esfem-animation",
    duration: int = 80,
) -> Html:
    """Show a run as a moving surface, coloured by a nodal function, with a time slider.

    Each element is drawn as k² flat triangles between its nodes. The camera and the colour range
    stay fixed in time. The picture plays once when it is loaded, unless the reader's system asks
    for reduced motion.

    Parameters
    ----------
    space : SurfaceSpace
    states : iterable
        Objects with ``t`` and ``x``, as `evolve` yields them; one frame each, so thin them out
        (40 frames of 1,000 nodes make about 1 MB).
    values : callable, optional
        Takes a state and returns the (N,) nodal values that colour the surface; ``state.u`` if not
        given.
    title, label : str
        Below the picture, and at its colour bar.
    div_id : str
        Identifier of the picture: different for each on a page.
    duration : int
        Milliseconds per frame.

    Returns
    -------
    Html
        With plotly's script inside, unless the environment variable ``ESFEM_PLOTLY_JS`` says where
        the page finds it.

    Raises
    ------
    ValueError
        If there is no state, or values have the wrong shape.
    """
    import plotly.graph_objects as go

    shots = list(states)
    if not shots:
        raise ValueError("there is no state to draw")
    colours = [np.asarray(s.u if values is None else values(s), dtype=np.float32) for s in shots]
    for c in colours:
        if c.shape != (len(space.nodes),):
            raise ValueError(f"one value per node is needed, ({len(space.nodes)},), got {c.shape}")
    positions = [np.asarray(s.x, dtype=np.float32) for s in shots]
    centre = (np.min(positions, axis=(0, 1)) + np.max(positions, axis=(0, 1))) / 2
    reach = 1.02 * float(np.max(np.abs(np.asarray(positions) - centre)))
    low, high = float(np.min(colours)), float(np.max(colours))
    i, j, k = flat_triangles(space.cells, space.degree).astype(np.int32).T

    def surface(x: NDArray[np.float32], c: NDArray[np.float32]) -> dict[str, Any]:
        return {"type": "mesh3d", "x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "intensity": c}

    first = surface(positions[0], colours[0]) | {
        **{"i": i, "j": j, "k": k},
        **{"cmin": low, "cmax": high, "colorscale": "Viridis", "flatshading": False},
        "lighting": {
            **{"ambient": 0.5, "diffuse": 0.7, "specular": 0.1},
            **{"facenormalsepsilon": 0, "vertexnormalsepsilon": 0},  # small triangles count, too
        },
        "lightposition": {"x": 0, "y": 0, "z": 1e5},
        "hovertemplate": f"{label} = %{{intensity:.4g}}<extra></extra>",
        "colorbar": {
            "title": {"text": label, "side": "top"},
            "orientation": "h",
            "thickness": 10,
            "len": 0.6,
            "y": 1.0,
            "yanchor": "bottom",
            "tickformat": ".2~g",
        },
    }
    times = [f"{s.t:.4g}" for s in shots]
    play = {
        "mode": "immediate",
        "fromcurrent": True,
        "frame": {"duration": duration, "redraw": True},
        "transition": {"duration": 0},
    }
    jump = play | {"frame": {"duration": 0, "redraw": True}}
    axis = {"visible": False, "autorange": False}
    layout = {
        "height": 500,
        "margin": {"l": 0, "r": 0, "t": 60, "b": 5},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "uirevision": "keep",  # the reader's camera survives the next frame
        "scene": {
            **{
                f"{n}axis": axis | {"range": [m - reach, m + reach]}
                for n, m in zip("xyz", centre.tolist(), strict=True)
            },
            "aspectmode": "cube",
            "camera": {"eye": {"x": 1.1, "y": 1.1, "z": 0.7}},
            "dragmode": "turntable",
        },
        "updatemenus": [
            {
                "type": "buttons",
                "direction": "left",
                "showactive": False,
                "x": 0.0,
                "y": 0.0,
                "xanchor": "left",
                "yanchor": "top",
                "pad": {"t": 22, "l": 8},
                "buttons": [
                    {"label": "play", "method": "animate", "args": [None, play]},
                    {"label": "pause", "method": "animate", "args": [[None], jump]},
                ],
            }
        ],
        "sliders": [
            {
                "x": 0.4,
                "len": 0.58,
                "y": 0.0,
                "pad": {"t": 6},
                "currentvalue": {"prefix": "t = ", "font": {"size": 14, "color": "#444"}},
                "ticklen": 0,
                "minorticklen": 0,
                "font": {"size": 1, "color": "rgba(0,0,0,0)"},  # no label at every step
                "transition": {"duration": 0},
                "steps": [{"label": t, "method": "animate", "args": [[t], jump]} for t in times],
            }
        ],
    }
    figure = go.Figure(
        data=[first],
        layout=layout,
        frames=[
            {"name": t, "data": [surface(x, c)]}
            for t, x, c in zip(times, positions, colours, strict=True)
        ],
    )
    body = figure.to_html(
        full_html=False,
        include_plotlyjs=os.environ.get("ESFEM_PLOTLY_JS") or True,
        div_id=div_id,
        auto_play=False,
        config={"responsive": True, "displaylogo": False},
        post_script=(
            "if (!window.matchMedia('(prefers-reduced-motion: reduce)').matches) "
            f"Plotly.animate('{{plot_id}}', null, {json.dumps(play)}).catch(() => {{}});"
        ),
    )
    caption = f"<figcaption>{html.escape(title)}</figcaption>" if title else ""
    text = f'<figure class="esfem-animation">{body}{caption}</figure>'
    return Html(text, f"{title or 'animation'}: {len(shots)} frames, t = {times[0]} to {times[-1]}")


def _positive(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=float)
    if not (np.all(np.isfinite(array)) and np.all(array > 0)):
        raise ValueError(f"{name}: only positive finite numbers have logarithms, got {array}")
    return array
