"""The moving picture of a notebook or a web page: data, controls, a still for print, a description.

The picture is drawn by plotly's script, which the page names or the picture carries; play, pause
and the time slider are the browser's own controls. Where no script runs, and on paper, three
stills stand for it.
"""

from __future__ import annotations

import base64
import html
import io
import json
import math
import os
from collections.abc import Sequence
from hashlib import sha256
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from esfem_core.checks import Array, package, whole_number
from esfem_core.elements import SurfaceSpace, flat_triangles
from esfem_core.output.pictures import PLAIN, Cube, colour_range, cube, draw, times_of
from esfem_core.output.plotting import load_matplotlib
from esfem_core.tables import Html

__all__ = ["Shot", "load_viewer", "viewer"]

Parts = dict[str, Any]  # of plotly's description of a picture
Range = tuple[float, float]

LONGEST = 60_000  # milliseconds of a frame
BEYOND = 50  # ranges of colours beside their own in which values are told
TICKS = 6  # steps between numbers at a colour bar, at most
ROOM = 32  # characters in all of these numbers, with two for each gap, that a phone has room for

# fmt: off
SURFACE: Parts = {
    "type": "mesh3d", "colorscale": "Viridis", "flatshading": False,
    "lighting": {
        "ambient": 0.5, "diffuse": 0.7, "specular": 0.1,
        "facenormalsepsilon": 0, "vertexnormalsepsilon": 0,  # small triangles count, too
    },
    "lightposition": {"x": 0, "y": 0, "z": 1e5},
}
COLOUR_BAR: Parts = {
    "orientation": "h", "thickness": 10, "len": 0.6,
    "y": 1.0, "yanchor": "bottom", "tickmode": "array",
}
LAYOUT: Parts = {
    "margin": {"l": 0, "r": 0, "t": 60, "b": 5}, "paper_bgcolor": "rgba(0,0,0,0)",
    "uirevision": "keep",  # the reader's camera survives the next frame
}
AXIS: Parts = {"visible": False, "autorange": False}
SCENE: Parts = {
    "aspectmode": "cube", "dragmode": "turntable",
    "camera": {"eye": {"x": 1.1, "y": 1.1, "z": 0.7}},
}
# fmt: on
STILL = 4_000  # triangles of a still, if the elements are not more


class Shot(NamedTuple):
    """One frame: a surface and the function that colours it.

    Parameters
    ----------
    space : SurfaceSpace
    t : float
    x : (N, 3) floats
    colours : (N,) floats, or None
        None for a surface without a function.
    """

    space: SurfaceSpace
    t: float
    x: Array
    colours: Array | None


def load_viewer() -> None:
    """Refuse, before anything is computed, if a package is missing that :func:`viewer` needs."""
    load_matplotlib()
    if not os.environ.get("ESFEM_PLOTLY_JS"):
        package("pages with a time slider need Plotly", "plotly", "pictures")


def viewer(
    shots: Sequence[Shot],
    title: str,
    label: str,
    duration: int,
    limits: tuple[float, float] | None = None,
) -> Html:
    """Show frames as a moving surface with a play button and a time slider.

    Each element is drawn as k² flat triangles between its nodes. Positions and values have 16 bits
    each, which is finer than a screen. Positions are those beside the centre of the room, since
    graphics cards have seven digits. The identifier of the picture is made of what it shows:
    pictures that differ have different ones, which are the same whenever the page is built.

    Parameters
    ----------
    shots : sequence of Shot
        At least one.
    title, label : str
        Below the picture, and at its colour bar.
    duration : int
        Milliseconds per frame, up to a minute.
    limits : (float, float), optional
        Values of the first and the last colour.

    Returns
    -------
    Html
        With plotly's script inside, unless the environment variable ``ESFEM_PLOTLY_JS`` says where
        the page finds it.

    Raises
    ------
    TypeError, ValueError
        If `duration` is not a positive integer, or `limits` not two numbers that increase.
    """
    duration = whole_number("duration", duration, 1, LONGEST)
    room = _, reach = cube([shot.x for shot in shots])
    shades = colour_range([shot.colours for shot in shots], limits)
    times = times_of([shot.t for shot in shots])
    place = os.environ.get("ESFEM_PLOTLY_JS") or None
    film = {
        "plotly": place,
        "times": times,
        "duration": duration,
        "trace": _trace(shades, label, plain=shots[0].colours is None),
        "layout": LAYOUT | {"scene": _scene(reach)},
        **_data(shots, room, shades),
    }
    script = resources.files("esfem_core.output").joinpath("viewer.js").read_text("utf8")
    style = resources.files("esfem_core.output").joinpath("viewer.css").read_text("utf8")
    data, says = _json(film), html.escape(_description(shots, times, label))
    identifier = f"esfem-{sha256((_json(title) + data).encode()).hexdigest()[:12]}"
    caption = f"{html.escape(title)} <small>{says}</small>" if title else says
    text = (
        f'<figure class="esfem-animation" id="{identifier}"><style>{style}</style>'
        f"{'' if place else _plotly()}"
        f'<div class="esfem-frame" role="img" aria-label="{says}">'
        f'{_poster(shots, times, room, shades)}<div class="esfem-stage"></div></div>'
        '<div class="esfem-controls" role="group" aria-label="moving picture" hidden>'
        '<button type="button">play</button>'
        '<input type="range" min="0" max="1" value="0" step="1" aria-label="time">'
        f"<output></output></div><figcaption>{caption}</figcaption>"
        f"<script>{script.strip()}({_json(identifier)}, {data});</script></figure>"
    )
    return Html(text, f"{title or 'animation'}: {len(times)} frames, t = {times[0]} to {times[-1]}")


def _json(value: object) -> str:
    """JSON that may stand in a page."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _plotly() -> str:
    """The script that draws, for a page that does not have it."""
    from plotly.offline import get_plotlyjs

    return f"<script>window.PlotlyConfig = {{MathJaxConfig: 'local'}};{get_plotlyjs()}</script>"


def _data(shots: Sequence[Shot], room: Cube, shades: Range) -> Parts:
    """Positions, values and triangles as text; triangles of a later frame if the space changes."""
    centre, reach = room
    low, high = shades
    # Farther off, values count as these, so that those that have colours of their own stay apart.
    least, most = low - BEYOND * (high - low), high + BEYOND * (high - low)
    columns = [_columns(shot, centre) for shot in shots]
    ends = min(c[-1].min() for c in columns), max(c[-1].max() for c in columns)
    ranges = [*3 * [(-reach, reach)], tuple(np.clip(ends, least, most).tolist())]
    frames = [[_packed(*pair) for pair in zip(c, ranges, strict=True)] for c in columns]
    changes = any(shot.space is not shots[0].space for shot in shots)
    return {
        "ranges": ranges,
        "frames": frames,
        "triangles": [_triangles(shot.space) for shot in (shots if changes else shots[:1])],
    }


def _columns(shot: Shot, centre: Array) -> list[Array]:
    colours = np.zeros(len(shot.x)) if shot.colours is None else shot.colours
    return [*(shot.x - centre).T, colours]


def _packed(values: Array, within: Range) -> str:
    """Numbers as multiples of 1/65535 of a range, two bytes each, the lower one first."""
    low, high = within
    share = (values - low) / ((high - low) or 1.0)
    return base64.b64encode(np.rint(65535 * share.clip(0, 1)).astype("<u2").tobytes()).decode()


def _triangles(space: SurfaceSpace) -> list[str]:
    corners = flat_triangles(space.cells, space.degree).astype("<u4").T
    return [base64.b64encode(column.tobytes()).decode() for column in corners]


def _trace(shades: Range, label: str, *, plain: bool) -> Parts:
    """Colours and light."""
    values, texts = ticks_of(shades)
    ticks = {"tickvals": values, "ticktext": [text.replace("-", "\u2212") for text in texts]}
    says = f"{html.escape(label)} = %{{intensity:.{_digits(*shades) + 1}g}}<extra></extra>"
    text = {
        "hovertemplate": says,
        "colorbar": {"title": {"text": html.escape(label), "side": "top"}} | COLOUR_BAR | ticks,
    }
    one_colour = {"colorscale": [[0, PLAIN], [1, PLAIN]], "showscale": False, "hoverinfo": "skip"}
    shown = {"cmin": shades[0], "cmax": shades[1]} | SURFACE
    return shown | (one_colour if plain else text)


def ticks_of(shades: Range) -> tuple[list[float], list[str]]:
    """Round values between two, and in words with all their digits; fewer where words are long.

    Examples
    --------
    >>> ticks_of((290.0, 310.0))[1]
    ['290', '295', '300', '305', '310']
    >>> ticks_of((0.996, 1.004))[1]
    ['0.996', '0.998', '1', '1.002', '1.004']
    >>> ticks_of((3e8 - 1, 3e8 + 1))
    ([299999999.0, 300000000.0, 300000001.0], ['299999999', '300000000', '300000001'])
    """
    from matplotlib.ticker import MaxNLocator

    low, high = shades
    if high - low > 1e306:  # matplotlib cannot count there
        return [], []
    beyond = 1e-9 * (high - low)  # by rounding
    choices: list[tuple[list[float], list[str]]] = []
    for most in range(TICKS, 1, -1):
        steps = np.array(MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high))
        values = steps[(low - beyond <= steps) & (steps <= high + beyond)].tolist()
        if len(values) > 1 or not choices:
            choices.append((values, _told(values)))
    fitting = (c for c in choices if sum(len(text) + 2 for text in c[1]) <= ROOM)
    return next(fitting, choices[-1])


def _told(values: Sequence[float]) -> list[str]:
    """Evenly spaced values in words that are no others: the shortest ones.

    Examples
    --------
    >>> _told([-0.5, 0.0, 0.1 + 0.4]), _told([0.0, 5e5, 1e6]), _told([9995.0, 10000.0, 10005.0])
    (['-0.5', '0', '0.5'], ['0', '5e+05', '1e+06'], ['9995', '10000', '10005'])
    """
    near = 1e-6 * max(np.diff(values), default=0.0)
    each = ([f"{value:.{digits}g}" for value in values] for digits in range(17, 0, -1))
    right = (
        texts
        for texts in each
        if all(abs(float(text) - v) <= near for text, v in zip(texts, values, strict=True))
    )
    return min(right, key=lambda texts: sum(map(len, texts)))


def _digits(low: float, high: float) -> int:
    """How many tell values between two apart by a hundredth; those of one value are three.

    Examples
    --------
    >>> [_digits(*pair) for pair in ((-1.0, 1.0), (290.0, 310.0), (1.0, 1.0 + 3e-7), (0.0, 0.0))]
    [3, 4, 9, 3]
    """
    share = min((high - low) / (max(abs(low), abs(high)) or 1.0), 1.0)
    return max(3, 2 - math.floor(math.log10(share))) if share > 1e-12 else 3


def _scene(reach: float) -> Parts:
    """A cube with room for the surface at all times."""
    return {
        f"{name}axis": AXIS | {"range": [-1.02 * reach, 1.02 * reach]} for name in "xyz"
    } | SCENE


def _poster(shots: Sequence[Shot], times: Sequence[str], room: Cube, shades: Range) -> str:
    """First, middle and last frame side by side, as a PNG inside the page."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chosen = sorted({0, len(shots) // 2, len(shots) - 1})
    figure = Figure(figsize=(3 * len(chosen), 3.4), facecolor="none")
    FigureCanvasAgg(figure)
    for i, k in enumerate(chosen):
        place = (i / len(chosen), 0, 1 / len(chosen), 0.9)
        ax: Any = figure.add_axes(place, projection="3d", facecolor="none")
        draw(ax, shots[k].space, shots[k].x, shots[k].colours, shades, room, STILL)
        ax.set_axis_off()
        ax.set_title(f"t = {times[k]}", color="#767676")  # on white and on black
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=100, metadata={"Software": None})
    picture = base64.b64encode(file.getvalue()).decode()
    return f'<img class="esfem-poster" alt="" src="data:image/png;base64,{picture}">'


def _description(shots: Sequence[Shot], times: Sequence[str], label: str) -> str:
    """What happens, in words: size and values at first and in the end, or where they go between."""
    sizes = np.array([np.ptp(shot.x, axis=0) for shot in shots])
    measures = [" × ".join(f"{side:.3g}" for side in size) for size in sizes]
    says = f"From t = {times[0]} to {times[-1]}: the surface measures "
    says += _course(measures, sizes, times)
    coloured = [shot.colours for shot in shots if shot.colours is not None]
    if len(coloured) == len(shots):
        ends = np.array([(values.min(), values.max()) for values in coloured])
        spans = [f"between {_span(*pair)}" for pair in ends.tolist()]
        says += f"; {label or 'its colour'} lies {_course(spans, ends, times)}"
    return f"{says}."


def _course(texts: Sequence[str], values: Array, times: Sequence[str]) -> str:
    """How what a text says of each frame, by a row of values, goes on over time."""
    first, last = texts[0], texts[-1]
    if first != last:
        return f"{first} at first and {last} in the end"
    others = [i for i, text in enumerate(texts) if text != first]
    if not others:
        return f"{first} all the time"
    most = max(others, key=lambda i: np.abs(values[i] - values[0]).max())
    return f"{first} at first and in the end, and {texts[most]} at t = {times[most]}"


def _span(low: float, high: float) -> str:
    least = 1e-3 * max(abs(low), abs(high))  # what is less is nothing beside it
    digits = _digits(low, high)
    return " and ".join(f"{v if abs(v) > least else 0:.{digits}g}" for v in (low, high))
