"""Moving surfaces: for notebooks and web pages with a time slider, or as films.

plotly is needed for the former, matplotlib for both (extra ``pictures``); they are imported when a
function is called.
"""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from esfem_core.checks import iterable, output_path, whole_number
from esfem_core.output.pictures import (
    COORDINATES,
    Values,
    add_bar,
    check_formulas,
    check_text,
    colour_range,
    cube,
    draw,
    nodal_values,
    times_of,
)
from esfem_core.output.plotting import load_matplotlib
from esfem_core.output.viewer import LONGEST, Shot, load_viewer, viewer
from esfem_core.stepping import State, check_state, known_space, write_whole
from esfem_core.tables import Html

__all__ = ["animate"]


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

    Camera and colours stay fixed in time; the space may change. The picture of a page plays once
    when it is first seen, unless the reader's system asks for reduced motion; on paper it is three
    stills.

    Parameters
    ----------
    states : iterable of State
        One frame each, so thin out a run: ``itertools.islice(run, 0, None, 10)``. In a page, 40
        frames of 1,000 nodes make about half a megabyte.
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
        Milliseconds per frame, up to a minute; in a GIF rounded to tens, and 20 at least.

    Returns
    -------
    Html or Path
        The picture, or the file. At any moment the old or the new file is there whole. A page has
        plotly's script inside, unless the environment variable ``ESFEM_PLOTLY_JS`` says where it
        finds it.

    Raises
    ------
    TypeError, ValueError
        If `path` ends otherwise, there is no state, one knows no space, has no such values or
        another function than those before.
    FileNotFoundError, PermissionError
        If the directory does not exist, or cannot be written to.
    ImportError
        Without matplotlib, without plotly if it is no film, or if ".mp4" is asked for and there is
        no ffmpeg, with which matplotlib makes it.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    >>> ec.animate(ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 0.5), title="Growth")
    Growth: 6 frames, t = 0 to 0.5
    """
    file = None if path is None else output_path("path", path, (".html", ".gif", ".mp4"))
    is_film = file is not None and file.suffix.lower() != ".html"
    load_matplotlib() if is_film else load_viewer()
    duration = whole_number("duration", duration, 1, LONGEST)
    check_text("title", title)
    check_text("label", "" if label is None else label)
    colour_range([], limits)
    if file is not None and is_film:
        check_formulas("title", title)
        check_formulas("label", label or "")
        _writer(file)
    name, shots = _shots(states, values)
    label = name if label is None else label
    if file is not None and is_film:
        return _film(file, shots, title, label, limits, duration)
    page = viewer(shots, title, label, duration, limits)
    if file is None:
        return page
    text = f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}'
    write_whole(file, f"{text}</title></head><body>{page.text}</body></html>\n".encode())
    return file


def _shots(states: Iterable[State], values: Values) -> tuple[str, list[Shot]]:
    """Name of the function to draw, and a frame for each state."""
    shots: list[Shot] = []
    first: tuple[str, bool] | None = None
    # Each state is looked at when it comes: those after it may take long.
    each = [states] if isinstance(states, State) else iterable("states", states, "States")
    for i, s in enumerate(each):
        space = known_space(s, f"states[{i}]")
        check_state(space, s, f"states[{i}]")
        name, colours = nodal_values(s, values)
        drawn = name, colours is None
        first = first or drawn
        if drawn != first:
            here, before = ("none" if plain else repr(called) for called, plain in (drawn, first))
            raise ValueError(
                f"states must have the same function to draw, but states[{i}] has {here}, those "
                f"before {before}; values may name one, or be a function of a state"
            )
        shots.append(Shot(space, s.t, s.x, colours))
    if first is None:
        raise ValueError("states must hold at least one State, got none")
    return first[0], shots


def _writer(file: Path) -> Any:
    """What writes a film, or an error if it is not there."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    writer = FFMpegWriter if file.suffix.lower() == ".mp4" else PillowWriter
    if not writer.isAvailable():
        raise ImportError(
            'a film that ends with ".mp4" needs the program ffmpeg; ".gif" and ".html" do without'
        )
    return writer


def _frame_duration(duration: int, suffix: str) -> float:
    """Milliseconds per frame as the writer of a film is to have them.

    In GIF they are whole hundredths of a second, and what is less than two of them, programs show
    as ten. matplotlib cuts off what the division by frames per second leaves behind the point.

    Examples
    --------
    >>> [int(1000 / (1000 / _frame_duration(duration, ".gif"))) for duration in (1, 15, 30, 77)]
    [20, 20, 30, 80]
    """
    return max(10 * round(duration / 10), 20) + 1e-3 if suffix == ".gif" else duration


def _film(
    file: Path,
    shots: Sequence[Shot],
    title: str,
    label: str,
    limits: tuple[float, float] | None,
    duration: int,
) -> Path:
    """Frame by frame with matplotlib."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 5))
    FigureCanvasAgg(figure)
    ax = figure.add_subplot(projection="3d")
    shades = colour_range([shot.colours for shot in shots], limits)
    room = cube([shot.x for shot in shots])
    times = times_of([shot.t for shot in shots])

    def frame(i: int) -> Any:
        ax.clear()
        ax.set(title=f"{title}   t = {times[i]}".strip(), **COORDINATES)
        return draw(ax, shots[i].space, shots[i].x, shots[i].colours, shades, room)

    if (scale := frame(0)) is not None:
        add_bar(ax, scale, label)
    film = FuncAnimation(figure, frame, frames=len(shots), init_func=lambda: None)
    with TemporaryDirectory() as folder:
        made = Path(folder, f"film{file.suffix.lower()}")
        film.save(made, writer=_writer(file)(fps=1000 / _frame_duration(duration, made.suffix)))
        write_whole(file, made.read_bytes())
    return file
