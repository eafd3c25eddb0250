"""Pictures and films of surfaces: what is drawn where, and what is refused."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import art3d
from PIL import Image

import esfem_core as ec
from esfem_core.output import animation, style
from esfem_core.output.curved import refined
from esfem_core.output.pictures import check_formulas, colour_range


def state(degree=2, refinements=1, t=0.5, **fields):
    space = ec.SurfaceSpace(ec.sphere("octahedron", refinements), degree, ec.to_unit_sphere)
    x = space.nodes
    return ec.State(t, (1 + t) * x, None, x[:, 2], space=space, fields=fields)


@pytest.fixture
def ax():
    return Figure().add_subplot(projection="3d")


def image(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("pieces", [1, 3, 7])
def test_refined_elements_lie_on_the_curved_surface_and_cover_it(degree, pieces):
    space = state(degree).space
    basis, triangles = refined(space, pieces)
    points = (basis @ space.nodes[space.cells]).reshape(-1, 3)
    assert triangles.shape == (len(space.cells) * pieces**2, 3)
    a, b, c = points[triangles].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    assert ((normal * (a + b + c)).sum(axis=1) > 0).all()  # oriented as the elements are
    exact = ec.SurfaceSpace.from_nodes(space.nodes, space.cells, 20).integrate(space.nodes, 1)
    area = np.linalg.norm(normal, axis=1).sum() / 2
    assert area == pytest.approx(exact, rel=1e-12 if degree == 1 else 0.35 / pieces**2)


def test_curved_elements_are_drawn_curved(ax, monkeypatch):
    """Eight quartic elements make a sphere, and not an octahedron."""
    given, seen = state(4, 0, t=0.0), []

    class Polygons(art3d.Poly3DCollection):
        def __init__(self, corners, **options):
            seen.append(corners)
            super().__init__(corners, **options)

    monkeypatch.setattr(art3d, "Poly3DCollection", Polygons)
    ec.plot(given, ax=ax)
    [corners] = seen
    assert corners.shape == (12**2 * 8, 3, 3)
    assert np.linalg.norm(corners, axis=2).min() > 0.97
    assert ax.get_xlim()[1] == pytest.approx(1, abs=0.1)


def test_colours_are_those_of_the_function_in_the_light(ax):
    ec.plot(state(), ax=ax, limits=(-2, 2), title="A sphere", label="height")
    assert ax.get_title() == "A sphere"
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == "height"
    assert bar.get_ylim() == (-2, 2)
    faces = ax.collections[0].get_facecolor()
    assert len(np.unique(faces, axis=0)) > 100
    other = Figure().add_subplot(projection="3d")
    ec.plot(state(), "u", ax=other)
    assert other.figure.axes[1].get_ylabel() == "u"
    assert other.get_title() == "t = 0.5"
    assert (image(ax.figure) != image(other.figure)).any()


@pytest.mark.parametrize("value", [1.0, -3e8, 1e-300, 0.0])
def test_a_constant_has_one_colour_whatever_its_rounding(value, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    signs = np.where(np.arange(66) % 2, 1, -1)
    exact, rounded = (state(w=value * (1 + spread * signs)) for spread in (0, 1e-15))
    pictures = []
    for given in (exact, rounded):
        axes = Figure().add_subplot(projection="3d")
        pictures.append(image(ec.plot(given, "w", ax=axes).figure))
    assert abs(np.subtract(*pictures, dtype=float)).max() < 5  # of 255: one shade
    low, high = colour_range([1 + 1e-10 * signs])
    assert high - low == pytest.approx(2e-10, rel=1e-5)
    assert colour_range([exact["w"]], (0.0, 1e-20)) == (0.0, 1e-20)


def test_a_letter_at_the_colour_bar_is_upright_and_beside_the_numbers():
    ax = Figure().add_subplot(projection="3d")
    ec.plot(state(), "u", ax=ax)
    bar = ax.figure.axes[1]
    ax.figure.draw_without_rendering()
    label = bar.yaxis.label
    assert label.get_rotation() == 0
    numbers = [text.get_window_extent() for text in bar.get_yticklabels()]
    assert label.get_window_extent().x0 > max(box.x1 for box in numbers) + 2


def test_axes_of_its_own_have_the_names_of_the_coordinates():
    own, given = ec.plot(state()), Figure().add_subplot(projection="3d", xlabel="east")
    assert [own.get_xlabel(), own.get_ylabel(), own.get_zlabel()] == ["$x_1$", "$x_2$", "$x_3$"]
    assert ec.plot(state(), ax=given).get_xlabel() == "east"
    own.figure.clear()


def test_values_are_a_name_a_function_of_the_state_or_numbers():
    given = state(w=np.arange(66.0))
    pictures = []
    for values in ("w", lambda s: s["w"], given["w"]):
        axes = Figure().add_subplot(projection="3d")
        ec.plot(given, values, ax=axes, label="")
        pictures.append(image(axes.figure))
    assert (pictures[0] == pictures[1]).all()
    assert (pictures[0] == pictures[2]).all()


def test_a_surface_without_a_function_has_one_colour_and_no_bar(ax):
    given = state()
    ec.plot(ec.State(0.0, given.x, space=given.space), ax=ax)
    assert len(ax.figure.axes) == 1


def test_plot_makes_a_figure_of_its_own():
    from matplotlib import pyplot

    ax = ec.plot(state())
    assert pyplot.get_fignums() != []
    pyplot.close(ax.figure)


def test_plot_refuses_what_it_cannot_draw(ax):
    given = state(pair=np.ones((66, 2)))
    for arguments, error, message in [
        ((1,), TypeError, "state must be a State, got 1"),
        ((ec.State(0.0, given.x),), ValueError, "must know its space"),
        ((given, "w"), ValueError, r"a function of the state \('pair', 'u'\), got 'w'"),
        ((given, "pair"), ValueError, r"'pair' has 2 components.*state\['pair'\]\[:, 0\]"),
        ((given, np.ones(3)), ValueError, r"values must have shape \(66,\), got \(3,\)"),
        ((given, lambda s: s.x), ValueError, r"values must have shape \(66,\), got \(66, 3\)"),
    ]:
        with pytest.raises(error, match=message):
            ec.plot(*arguments, ax=ax)
    two = ec.State(0.0, given.x, space=given.space, fields={"a": given.u, "b": given.u})
    for show in (lambda: ec.plot(two, ax=ax), lambda: ec.animate([two])):
        with pytest.raises(
            ValueError, match="values must name the function to draw, one of 'a', 'b'"
        ):
            show()
    with pytest.raises(ValueError, match=r"limits\[1\] must be a finite number > 1, got 0"):
        ec.plot(given, ax=ax, limits=(1, 0))
    with pytest.raises(TypeError, match="ax must have three dimensions"):
        ec.plot(given, ax=Figure().add_subplot())


@pytest.mark.parametrize("name", ["title", "label"])
def test_formulas_that_cannot_be_set_are_refused_before_anything_is_drawn(ax, tmp_path, name):
    message = rf"{name} must have formulas between \$ that matplotlib can set, got '\$\\\\frac 1\$'"
    with pytest.raises(ValueError, match=message):
        ec.plot(state(), ax=ax, **{name: r"$\frac 1$"})
    assert not ax.collections
    with pytest.raises(ValueError, match=message):
        ec.animate([state()], tmp_path / "film.gif", **{name: r"$\frac 1$"})
    assert not list(tmp_path.iterdir())
    ec.plot(state(), ax=ax, **{name: r"5 $ a night, $\frac{1}{2}$"})


@pytest.mark.parametrize("name", ["title", "label"])
def test_half_a_character_is_refused_before_a_state_is_computed(ax, tmp_path, name):
    def states():
        raise AssertionError("computed")
        yield

    message = rf"{name} must be text of whole characters, got '\\ud800'"
    with pytest.raises(ValueError, match=message):
        ec.plot(state(), ax=ax, **{name: "\ud800"})
    for path in (None, tmp_path / "film.html", tmp_path / "film.gif"):
        with pytest.raises(ValueError, match=message):
            ec.animate(states(), path, **{name: "\ud800"})


def test_animate_returns_the_page_with_a_slider(monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    shown = ec.animate((state(t=t) for t in (0.0, 0.5)), title="Growth")
    assert repr(shown) == "Growth: 2 frames, t = 0 to 0.5"
    assert '"text":"u"' in shown.text


def test_animate_follows_a_space_that_changes(monkeypatch, tmp_path):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    same = state(t=0.0)
    one = ec.animate([same, ec.State(1.0, same.x, None, same.u, space=same.space)]).text
    two = ec.animate([same, state(3, t=1.0)]).text
    triangles = [re.search(r'"triangles":\[(.*?)\]\]', text)[1] for text in (one, two)]
    assert triangles[0].count("[") == 1  # once
    assert triangles[1].count("[") == 2  # and with each frame
    ec.animate([same, state(3, t=1.0)], tmp_path / "film.gif")


def test_animate_writes_pages_and_films(tmp_path, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    frames = [state(refinements=0, t=t) for t in (0.0, 0.5, 1.0)]
    page = ec.animate(frames, tmp_path / "film.html", title="a < b")
    text = page.read_text("utf8")
    assert text.startswith("<!doctype html>")
    assert "<title>a &lt; b</title>" in text
    film = ec.animate(frames, tmp_path / "film.gif", "u", title="a < b", duration=200)
    with Image.open(film) as picture:
        assert picture.n_frames == 3
        assert picture.info["duration"] == 200
    plain = [ec.State(s.t, s.x, space=s.space) for s in frames]
    assert ec.animate(plain, tmp_path / "plain.gif").exists()
    assert '"showscale":false' in ec.animate(plain).text


@pytest.mark.parametrize("limits", [None, (-5.0, 7.0)])
def test_all_frames_of_a_film_have_one_scale_of_colours_and_one_cube(monkeypatch, tmp_path, limits):
    """A sphere of radius 1 + t that is coloured by its height."""
    drawn = []
    monkeypatch.setattr(animation, "draw", lambda ax, space, *more: drawn.append(more))
    frames = [state(1, 0, t) for t in (0.0, 0.5, 1.0)]
    ec.animate(frames, tmp_path / "film.gif", lambda s: s.x[:, 2], limits=limits)
    for frame, (x, colours, shades, (middle, half)) in zip(frames, drawn[-3:], strict=True):
        np.testing.assert_array_equal(x, frame.x)
        np.testing.assert_array_equal(colours, frame.x[:, 2])
        assert shades == (limits or (-2.0, 2.0))
        np.testing.assert_array_equal([*middle, half], [0, 0, 0, 2])


def test_animate_refuses_what_it_cannot_draw(tmp_path, monkeypatch):
    given = state()
    for arguments, error, message in [
        (([],), ValueError, "states must hold at least one"),
        (([given, 1],), TypeError, r"states\[1\] must be a State, got 1"),
        (([given], None, lambda s: s.x), ValueError, r"must have shape \(66,\), got \(66, 3\)"),
        (([given], None, lambda s: np.full(66, np.nan)), ValueError, r"but values\[0\] is nan"),
        (([given], tmp_path / "film.avi"), ValueError, r'"\.html" or "\.gif" or "\.mp4", got'),
        (([given], tmp_path / "none" / "film.gif"), FileNotFoundError, "does not exist"),
    ]:
        with pytest.raises(error, match=message):
            ec.animate(*arguments)
    with pytest.raises(ValueError, match="duration must be an integer from 1 to 60000, got 0"):
        ec.animate([given], duration=0)
    with pytest.raises(ValueError, match="duration must be an integer from 1 to 60000"):
        ec.animate([given], tmp_path / "film.gif", duration=10**7)  # GIF has no room for it
    with pytest.raises(ValueError, match=r"limits must be a pair \(lowest, highest\), got 1"):
        ec.animate([given], limits=np.array(1))
    with pytest.raises(
        ValueError, match=r"limits must have rows of one length, got \[\[0\], \[1, 2\]\]"
    ):
        ec.animate([given], limits=[[0], [1, 2]])
    with pytest.raises(ValueError, match="states must hold at least one State, got none"):
        ec.animate([], label="u")
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", lambda: False)
    with pytest.raises(ImportError, match="needs the program ffmpeg"):
        ec.animate([given], tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


def test_frames_of_a_gif_last_as_long_as_asked_for(tmp_path):
    frames = [state(refinements=0, t=t) for t in (0.0, 0.5)]
    with Image.open(ec.animate(frames, tmp_path / "film.gif", duration=30)) as picture:
        assert picture.info["duration"] == 30


def test_animate_draws_one_function_or_none():
    given = state()
    plain = ec.State(1.0, given.x, space=given.space)
    other = ec.State(1.0, given.x, space=given.space, fields={"w": given.u})
    for states, message in [
        ([given, plain], r"states\[1\] has none, those before 'u'"),
        ([plain, plain, given], r"states\[2\] has 'u', those before none"),
        ([given, other], r"states\[1\] has 'w', those before 'u'"),
    ]:
        with pytest.raises(ValueError, match=rf"the same function to draw, but {message}"):
            ec.animate(states)
    ec.animate([given, other], values=lambda s: s.x[:, 0])


def test_animate_refuses_before_a_run_has_gone_on(tmp_path, monkeypatch):
    seen = []

    def run():
        for _ in range(3):
            seen.append(state())
            yield seen[-1]

    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", lambda: False)
    broken = r"$\frac{1}{2$"
    for most, error, options in [
        (0, ValueError, {"limits": (1, 0)}),
        (0, ValueError, {"path": tmp_path / "film.gif", "title": broken}),
        (0, ValueError, {"path": tmp_path / "film.gif", "label": broken}),
        (0, ImportError, {"path": tmp_path / "film.mp4"}),
        (1, ValueError, {"values": "none"}),
        (1, ValueError, {"values": lambda s: np.ones(3)}),
    ]:
        seen.clear()
        with pytest.raises(error):
            ec.animate(run(), **options)
        assert len(seen) == most


def test_a_film_that_is_interrupted_leaves_the_older_one(tmp_path, monkeypatch):
    def interrupted(writer):
        Path(writer.outfile).write_bytes(b"half a film")
        raise KeyboardInterrupt

    (tmp_path / "film.gif").write_bytes(b"an older one")
    monkeypatch.setattr("matplotlib.animation.PillowWriter.finish", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ec.animate([state()], tmp_path / "film.gif")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"an older one"]


def test_without_matplotlib_or_plotly_the_message_says_what_to_install(tmp_path, monkeypatch):
    def run():
        pytest.fail("nothing is computed before")
        yield

    given, film = state(), tmp_path / "film.gif"
    shows = {
        "plot": lambda: ec.plot(given),
        "page": lambda: ec.animate(run()),
        "film": lambda: ec.animate(run(), film),
        "style": style,
        "title": lambda: check_formulas("title", "$u$"),
    }
    monkeypatch.delenv("ESFEM_PLOTLY_JS", raising=False)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "plotly", None)
        with pytest.raises(ImportError, match=r'need Plotly: pip install "esfem-core\[pic.*]'):
            shows["page"]()
        ec.animate([given], film)
        without.setenv("ESFEM_PLOTLY_JS", "plotly.js")
        assert "<figure" in ec.animate([given]).text
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for show in shows.values():
        with pytest.raises(ImportError, match=r'need Matplotlib: pip install "esfem-core\[p.*]'):
            show()
