"""Moving surfaces: for notebooks and web pages with a time slider, or as films.

plotly is needed for the former, matplotlib for the latter (``pip install esfem-core[book]``); they
are imported when a function is called.
"""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from esfem_core.checks import (
    Array,
    finite_array,
    function,
    items,
    iterable,
    object_of,
    output_path,
    shown,
    string,
    whole_number,
)
from esfem_core.elements import SurfaceSpace, flat_triangles
from esfem_core.output.pictures import (
    PLAIN,
    Values,
    colour_range,
    cube,
    draw,
    known_space,
    nodal_values,
)
from esfem_core.stepping import State, write_whole
from esfem_core.tables import Html

__all__ = ["animate", "surface_animation"]

Floats = NDArray[np.float32]  # seven digits are more than a picture shows
Parts = dict[str, Any]  # of plotly's description of a picture

# fmt: off
SURFACE: Parts = {
    "colorscale": "Viridis", "flatshading": False,
    "lighting": {
        "ambient": 0.5, "diffuse": 0.7, "specular": 0.1,
        "facenormalsepsilon": 0, "vertexnormalsepsilon": 0,  # small triangles count, too
    },
    "lightposition": {"x": 0, "y": 0, "z": 1e5},
}
COLOUR_BAR: Parts = {
    "orientation": "h", "thickness": 10, "len": 0.6,
    "y": 1.0, "yanchor": "bottom", "tickformat": ".2~g",
}
LAYOUT: Parts = {
    "height": 500, "margin": {"l": 0, "r": 0, "t": 60, "b": 5},
    "paper_bgcolor": "rgba(0,0,0,0)",
    "uirevision": "keep",  # the reader's camera survives the next frame
}
AXIS: Parts = {"visible": False, "autorange": False}
SCENE: Parts = {
    "aspectmode": "cube", "dragmode": "turntable",
    "camera": {"eye": {"x": 1.1, "y": 1.1, "z": 0.7}},
}
BUTTONS: Parts = {
    "type": "buttons", "direction": "left", "showactive": False,
    "x": 0.0, "y": 0.0, "xanchor": "left", "yanchor": "top", "pad": {"t": 22, "l": 8},
}
SLIDER: Parts = {
    "x": 0.4, "len": 0.58, "y": 0.0, "pad": {"t": 6},
    "currentvalue": {"prefix": "t = ", "font": {"size": 14, "color": "#444"}},
    "ticklen": 0, "minorticklen": 0,
    "font": {"size": 1, "color": "rgba(0,0,0,0)"},  # no label at every step
    "transition": {"duration": 0},
}
# fmt: on
IDENTIFIER = r"[\w-]+"
PLAY_ONCE = (
    "if (!window.matchMedia('(prefers-reduced-motion: reduce)').matches) "
    "Plotly.animate('{{plot_id}}', null, {timing}).catch(() => {{}});"
)


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
        Objects with ``t`` and ``x``, (N, 3), as `evolve` yields them; one frame each, so thin them
        out (40 frames of 1,000 nodes make about 1 MB).
    values : callable, optional
        Takes a state and returns the (N,) nodal values that colour the surface; ``state.u`` if not
        given.
    title, label : str
        Below the picture, and at its colour bar.
    div_id : str
        Identifier of the picture: different for each on a page.
    duration : int
        Milliseconds per frame, positive.

    Returns
    -------
    Html
        With plotly's script inside, unless the environment variable ``ESFEM_PLOTLY_JS`` says where
        the page finds it.

    Raises
    ------
    TypeError, ValueError
        If there is no state, nodes or values have the wrong shape or are not finite, or `duration`
        is not a positive integer.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    >>> x = space.nodes
    >>> states = [ec.State(t, (1 + t) * x, None, x[:, 2]) for t in (0.0, 0.5)]
    >>> surface_animation(space, states, title="A growing sphere")
    A growing sphere: 2 frames, t = 0 to 0.5
    """
    object_of("space", space, SurfaceSpace)
    string("title", title)
    string("label", label)
    if not re.fullmatch(IDENTIFIER, string("div_id", div_id)):
        raise ValueError(f"div_id must be letters, digits, - and _, got {div_id!r}")
    if values is not None:
        function("values", values, "of a state, or None")
    shots: list[Any] = list(iterable("states", states, "States"))
    if not shots:
        raise ValueError("states must hold at least one state, got none")
    n = len(space.nodes)
    for i, s in enumerate(shots):
        if not hasattr(s, "x") or not hasattr(s, "t"):
            raise TypeError(f"states[{i}] must have t and x, as a State has, got {shown(s)}")
    nodes = [finite_array("x", s.x, (n, 3)) for s in shots]
    chosen = [s.u if values is None else values(s) for s in shots]
    colours = [finite_array("values", c, (n,)) for c in chosen]
    times = [s.t for s in shots]
    return _page([space] * len(shots), times, nodes, colours, title, label, div_id, duration)


def animate(
    states: Iterable[State],
    path: str | os.PathLike[str] | None = None,
    values: Values = None,
    *,
    title: str = "",
    label: str | None = None,
    limits: tuple[float, float] | None = None,
    duration: int = 80,
) -> Html | Path:
    """Show states as a moving surface, in a notebook, on a web page or as a film.

    Camera and colours stay fixed in time; the space may change.

    Parameters
    ----------
    states : iterable of State
        One frame each, so thin out a run: ``itertools.islice(run, 0, None, 10)``.
    path : path, optional
        If not given, the picture with its time slider for a notebook is returned. Otherwise a file:
        the same picture if it ends with ".html", a film if it ends with ".gif" or ".mp4".
    values : str, callable or (N,) array, optional
        As for :func:`esfem_core.plot`.
    title, label : str
        Below or above the picture, and at its colour bar.
    limits : (float, float), optional
        Values of the first and the last colour.
    duration : int
        Milliseconds per frame, positive.

    Returns
    -------
    Html or Path
        The picture, or the file.

    Raises
    ------
    TypeError, ValueError
        If `path` ends otherwise, there is no state, one knows no space or has no such values.
    FileNotFoundError
        If the directory does not exist.
    ImportError
        If ".mp4" is asked for and there is no ffmpeg, with which matplotlib makes it.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    >>> ec.animate(ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 0.5), title="Growth")
    Growth: 6 frames, t = 0 to 0.5
    """
    file = None if path is None else output_path("path", path, (".html", ".gif", ".mp4"))
    whole_number("duration", duration, 1)
    string("title", title)
    if label is not None:
        string("label", label)
    shots = [states] if isinstance(states, State) else items("states", states, State)
    spaces = [known_space(s, f"states[{i}]") for i, s in enumerate(shots)]
    named = [nodal_values(s, values) for s in shots]
    label = named[0][0] if label is None else label
    if file is not None and file.suffix.lower() != ".html":
        return _film(file, spaces, shots, [c for _, c in named], title, label, limits, duration)
    colours = [
        np.zeros(len(s.x)) if c is None else c for s, (_, c) in zip(shots, named, strict=True)
    ]
    times, nodes = [s.t for s in shots], [s.x for s in shots]
    name = "esfem-animation" if file is None else re.sub(rf"(?!{IDENTIFIER}).", "-", file.stem)
    plain = named[0][1] is None
    page = _page(spaces, times, nodes, colours, title, label, name, duration, limits, plain=plain)
    if file is None:
        return page
    text = f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}'
    write_whole(file, f"{text}</title></head><body>{page.text}</body></html>\n".encode())
    return file


def _film(
    file: Path,
    spaces: Sequence[SurfaceSpace],
    shots: Sequence[State],
    colours: Sequence[Array | None],
    title: str,
    label: str,
    limits: tuple[float, float] | None,
    duration: int,
) -> Path:
    """Frame by frame with matplotlib."""
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    writer: Any = FFMpegWriter if file.suffix.lower() == ".mp4" else PillowWriter
    if not writer.isAvailable():
        raise ImportError(
            'a film that ends with ".mp4" needs the program ffmpeg; ".gif" and ".html" do without'
        )
    figure = Figure(figsize=(6, 5))
    FigureCanvasAgg(figure)
    ax = figure.add_subplot(projection="3d")
    shades, room = colour_range(colours, limits), cube([s.x for s in shots])

    def frame(i: int) -> Any:
        ax.clear()
        ax.set_title(f"{title}   t = {shots[i].t:.4g}".strip())
        return draw(ax, spaces[i], shots[i].x, colours[i], shades, room)

    if (scale := frame(0)) is not None:
        figure.colorbar(scale, ax=ax, shrink=0.6, pad=0.1, label=label)
    film = FuncAnimation(figure, frame, frames=len(shots), init_func=lambda: None)
    film.save(file, writer=writer(fps=1000 / duration))
    return file


def _page(
    spaces: Sequence[SurfaceSpace],
    times: Sequence[float],
    nodes: Sequence[Array],
    colours: Sequence[Array],
    title: str,
    label: str,
    div_id: str,
    duration: int,
    limits: tuple[float, float] | None = None,
    *,
    plain: bool = False,
) -> Html:
    """The picture with a time slider; each element is drawn as k² flat triangles."""
    import plotly.graph_objects as go

    play = _timing(whole_number("duration", duration, 1))
    names = [f"{t:.4g}" for t in times]
    moving = [
        _moving_part(x.astype(np.float32), c.astype(np.float32))
        for x, c in zip(nodes, colours, strict=True)
    ]
    if any(space is not spaces[0] for space in spaces):
        moving = [part | _triangles(space) for part, space in zip(moving, spaces, strict=True)]
    fixed = _fixed_part(colour_range(colours, limits), label, plain)
    figure = go.Figure(
        data=[moving[0] | _triangles(spaces[0]) | fixed],
        layout=LAYOUT | {"scene": _scene(nodes)} | _controls(names, play),
        frames=[{"name": t, "data": [part]} for t, part in zip(names, moving, strict=True)],
    )
    body = figure.to_html(
        full_html=False,
        include_plotlyjs=os.environ.get("ESFEM_PLOTLY_JS") or True,
        div_id=div_id,
        auto_play=False,
        config={"responsive": True, "displaylogo": False},
        post_script=PLAY_ONCE.format(timing=json.dumps(play)),
    )
    caption = f"<figcaption>{html.escape(title)}</figcaption>" if title else ""
    text = f'<figure class="esfem-animation">{body}{caption}</figure>'
    return Html(text, f"{title or 'animation'}: {len(names)} frames, t = {names[0]} to {names[-1]}")


def _moving_part(x: Floats, colours: Floats) -> Parts:
    """What a frame changes."""
    return {"type": "mesh3d", "x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "intensity": colours}


def _triangles(space: SurfaceSpace) -> Parts:
    i, j, k = flat_triangles(space.cells, space.degree).astype(np.int32).T
    return {"i": i, "j": j, "k": k}


def _fixed_part(shades: tuple[float, float], label: str, plain: bool) -> Parts:
    """Colours and light."""
    text = {
        "hovertemplate": f"{html.escape(label)} = %{{intensity:.4g}}<extra></extra>",
        "colorbar": {"title": {"text": html.escape(label), "side": "top"}} | COLOUR_BAR,
    }
    one_colour = {"colorscale": [[0, PLAIN], [1, PLAIN]], "showscale": False, "hoverinfo": "skip"}
    shown = {"cmin": shades[0], "cmax": shades[1]} | SURFACE
    return shown | (one_colour if plain else text)


def _scene(nodes: Sequence[Array]) -> Parts:
    """A cube with room for the surface at all times."""
    centre, reach = cube(nodes)
    axes = {
        f"{name}axis": AXIS | {"range": [middle - 1.02 * reach, middle + 1.02 * reach]}
        for name, middle in zip("xyz", centre.tolist(), strict=True)
    }
    return axes | SCENE


def _timing(duration: int) -> Parts:
    """How plotly goes through frames, with milliseconds for each."""
    return {
        "mode": "immediate",
        "fromcurrent": True,
        "frame": {"duration": duration, "redraw": True},
        "transition": {"duration": 0},
    }


def _controls(times: list[str], play: Parts) -> Parts:
    """Buttons and a slider; a frame's name is its time."""
    jump = _timing(0)
    buttons = [
        {"label": "play", "method": "animate", "args": [None, play]},
        {"label": "pause", "method": "animate", "args": [[None], jump]},
    ]
    steps = [{"label": t, "method": "animate", "args": [[t], jump]} for t in times]
    return {
        "updatemenus": [BUTTONS | {"buttons": buttons}],
        "sliders": [SLIDER | {"steps": steps}],
    }
