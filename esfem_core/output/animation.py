"""Moving surfaces for notebooks.

plotly is needed (``pip install esfem-core[book]``); it is imported when a function is called.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from esfem_core.checks import finite_array, whole_number
from esfem_core.elements import SurfaceSpace, flat_triangles
from esfem_core.tables import Html

__all__ = ["surface_animation"]

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
    import plotly.graph_objects as go

    play = _timing(whole_number("duration", duration, 1))
    shots, n = list(states), len(space.nodes)
    if not shots:
        raise ValueError("there is no state to draw")
    nodes = np.array([finite_array("x", s.x, (n, 3)) for s in shots], np.float32)
    chosen = [s.u if values is None else values(s) for s in shots]
    colours = np.array([finite_array("values", c, (n,)) for c in chosen], np.float32)
    times = [f"{s.t:.4g}" for s in shots]
    moving = [_moving_part(x, c) for x, c in zip(nodes, colours, strict=True)]
    figure = go.Figure(
        data=[moving[0] | _fixed_part(space, colours, label)],
        layout=LAYOUT | {"scene": _scene(nodes)} | _controls(times, play),
        frames=[{"name": t, "data": [part]} for t, part in zip(times, moving, strict=True)],
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
    return Html(text, f"{title or 'animation'}: {len(shots)} frames, t = {times[0]} to {times[-1]}")


def _moving_part(x: Floats, colours: Floats) -> Parts:
    """What a frame changes."""
    return {"type": "mesh3d", "x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "intensity": colours}


def _fixed_part(space: SurfaceSpace, colours: Floats, label: str) -> Parts:
    """Triangles, colours and light."""
    i, j, k = flat_triangles(space.cells, space.degree).astype(np.int32).T
    triangles = {"i": i, "j": j, "k": k}
    colour_range = {"cmin": float(colours.min()), "cmax": float(colours.max())}
    text = {
        "hovertemplate": f"{label} = %{{intensity:.4g}}<extra></extra>",
        "colorbar": {"title": {"text": label, "side": "top"}} | COLOUR_BAR,
    }
    return triangles | colour_range | SURFACE | text


def _scene(nodes: Floats) -> Parts:
    """A cube with room for the surface at all times."""
    centre = (nodes.min(axis=(0, 1)) + nodes.max(axis=(0, 1))) / 2
    reach = 1.02 * float(np.abs(nodes - centre).max())
    axes = {
        f"{name}axis": AXIS | {"range": [middle - reach, middle + reach]}
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
