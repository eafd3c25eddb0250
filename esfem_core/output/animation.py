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

from esfem_core.elements import SurfaceSpace, flat_triangles
from esfem_core.tables import Html

__all__ = ["surface_animation"]


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
