"""Pictures: triangles keep orientation and area, the animation carries what it was given."""

import base64
import io
import json
import re

import numpy as np
import pytest
from bs4 import BeautifulSoup
from PIL import Image

import esfem_core as ec
from esfem_core.elements import flat_triangles, node_indices
from esfem_core.output import COLOURS, MARKERS, convergence_plot


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 6])
def test_flat_triangles_tile_the_element_with_its_orientation(degree):
    indices = node_indices(degree)
    triangles = flat_triangles(np.arange(len(indices))[None], degree)
    assert triangles.shape == (degree**2, 3)
    a, b, c = np.moveaxis(indices[triangles, 1:], 1, 0)
    twice_the_area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (twice_the_area == 1).all()  # of degree**2: all of the same size, none turned
    assert len({frozenset(t) for t in triangles.tolist()}) == degree**2
    assert set(triangles.ravel().tolist()) == set(range(len(indices)))


@pytest.fixture
def run():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree=2, project=ec.to_unit_sphere)
    x = space.nodes
    return [ec.State(t, (1 + t) * x, None, x[:, 0], space=space) for t in (0.0, 0.5, 1.0)]


def test_animation_names_its_picture_its_script_and_its_times(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "../_static/plotly.js")
    shown = ec.animate(run, title="a < b")
    text = shown._repr_html_()
    page = BeautifulSoup(text, "html.parser")
    assert page.script.string.rpartition("})(")[2].startswith(f'"{page.figure["id"]}", {{')
    assert '"plotly":"../_static/plotly.js"' in text
    assert "a &lt; b" in text
    assert '"times":["0","0.5","1"]' in text
    assert (
        "From t = 0 to 1: the surface measures 2 × 2 × 2 at first and 4 × 4 × 4 in the end; "
        "u lies between -1 and 1 all the time."
    ) in text
    assert text == ec.animate(run, title="a < b").text
    assert repr(shown) == "a < b: 3 frames, t = 0 to 1"


@pytest.mark.parametrize("start", [12345.6, 100.01, 1e6, 0.0])
def test_times_of_neighbours_can_be_told_apart(run, monkeypatch, tmp_path, start):
    """They were 1.235e+04 and 1.235e+04, in the clock, in words, above stills and frames."""
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    titles = []
    monkeypatch.setattr(
        "matplotlib.axes.Axes.set_title", lambda _, title, **__: titles.append(title)
    )
    later = [
        ec.State(start + s.t / 50, s.x, None, s.u, space=s.space)
        for s in (*run, ec.State(1.5, run[0].x, None, run[0].u, space=run[0].space))
    ]
    text = ec.animate(later).text
    times = film_of(text)["times"]
    assert list(map(float, times)) == pytest.approx([s.t for s in later], rel=1e-9)
    assert f"From t = {times[0]} to {times[-1]}: " in text
    assert f" and 4 × 4 × 4 at t = {times[2]}; " in text
    assert titles == [f"t = {times[k]}" for k in (0, 2, 3)]
    titles.clear()
    ec.animate(later, tmp_path / "film.gif")
    assert titles[-4:] == [f"t = {time}" for time in times]


def test_pictures_that_differ_have_different_identifiers(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    pictures = [ec.animate(run), ec.animate(run, title="a"), ec.animate(run, values=run[0].x[:, 1])]
    names = [re.search('<figure class="esfem-animation" id="(.*?)">', p.text)[1] for p in pictures]
    assert len(set(names)) == 3
    assert all(re.fullmatch("esfem-[0-9a-f]{12}", name) for name in names)


def test_a_description_tells_what_goes_and_comes_back(run, monkeypatch):
    space = run[0].space
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    sizes = [(0.0, 1.0), (0.25, 1.2), (0.5, 1.5), (0.75, 1.2), (1.0, 1.0)]
    x = space.nodes
    states = [ec.State(t, r * x, None, r * x[:, 0], space=space) for t, r in sizes]
    assert (
        "the surface measures 2 × 2 × 2 at first and in the end, and 3 × 3 × 3 at t = 0.5; "
        "u lies between -1 and 1 at first and in the end, and between -1.5 and 1.5 at t = 0.5."
    ) in ec.animate(states).text
    assert "the surface measures 2 × 2 × 2 all the time; u lies between -1 and 1 all the time." in (
        ec.animate(states[::4]).text
    )


def test_an_animation_has_the_limits_it_is_given(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    text = ec.animate(run, limits=(-5.25, 7.75)).text
    assert '"cmin":-5.25' in text
    assert '"cmax":7.75' in text


def film_of(text):
    """What the script of an animation is given."""
    return json.loads(f"[{text[text.rindex('})(') + 3 : text.rindex(');</script>')]}]")[1]


SPANS = [
    (-1, 1), (0, 0.35), (290, 310), (36.2, 37.8), (0.996, 1.004), (1 - 1e-7, 1 + 1e-7),
    (1 - 1e-11, 1 + 1e-11), (3e8 - 1, 3e8 + 1), (999e3, 1001e3), (-1e-5, 2e-5), (2, 2), (0, 0),
    (-4e305, 4e305), (0.7, 13e4),
]  # fmt: skip


@pytest.mark.parametrize(("low", "high"), SPANS)
def test_numbers_at_a_colour_bar_are_those_of_their_places_and_differ(run, monkeypatch, low, high):
    """Between 290 and 310 they were 2.9e+2, 3e+2, 3e+2, 3.1e+2 and 3.1e+2."""
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    u = low + (high - low) * (run[0].u + 1) / 2
    trace = film_of(ec.animate([ec.State(0.0, run[0].x, u=u, space=run[0].space)]).text)["trace"]
    values, texts = (trace["colorbar"][key] for key in ("tickvals", "ticktext"))
    assert 2 <= len(set(texts)) == len(values) <= 7
    first, last = trace["cmin"], trace["cmax"]
    shown = [float(text.replace("\N{MINUS SIGN}", "-")) for text in texts]
    assert np.abs(np.subtract(shown, values)).max() <= 1e-5 * (last - first)
    assert (
        first - 1e-8 * (last - first) <= min(values) < max(values) <= last + 1e-8 * (last - first)
    )
    assert sum(len(text) + 2 for text in texts) <= 40


def test_values_of_all_sizes_that_there_are_have_a_picture_without_numbers(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    trace = film_of(ec.animate(run, limits=(-8e307, 8e307)).text)["trace"]
    assert trace["colorbar"]["ticktext"] == []


def test_values_in_words_and_under_the_pointer_have_the_digits_that_tell_them_apart(
    run, monkeypatch
):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    for low, high, words, digits in [
        (-1, 1, "-1 and 1", 4),
        (0.5, 1, "0.5 and 1", 4),
        (0.996, 1.004, "0.996 and 1.004", 6),
        (3e8 - 1, 3e8 + 1, "299999999 and 300000001", 12),
        (1 / 3, 1 / 3 + 1e-15, "0.333 and 0.333", 4),
    ]:
        u = low + (high - low) * (run[0].u + 1) / 2
        text = ec.animate([ec.State(0.0, run[0].x, u=u, space=run[0].space)]).text
        assert f"u lies between {words} all the time" in text
        assert f"%{{intensity:.{digits}g}}" in text


@pytest.mark.parametrize("u", [2.0, 1 / 3, -1e-9, 0.0])
def test_one_value_but_for_rounding_has_the_colour_that_the_bar_gives_it(run, monkeypatch, u):
    """It had the first colour, with the value in the middle of the bar, or rounding was drawn."""
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    noise = u * (1 + 1e-15 * np.arange(len(run[0].x)) / len(run[0].x))
    state = ec.State(0.0, run[0].x, u=noise, space=run[0].space)
    trace = film_of(ec.animate([state]).text)["trace"]
    low, high = ec.plot(state).figure.axes[1].get_ylim()
    assert (low, high) == pytest.approx((trace["cmin"], trace["cmax"]), rel=1e-12, abs=0)
    assert (u - low) / (high - low) == pytest.approx(0.5)


def test_a_surface_far_from_the_origin_is_drawn_beside_its_centre(run, monkeypatch):
    """In the seven digits of graphics cards it was shreds."""
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    far = [ec.State(s.t, s.x + np.array([1e7, 0, 3e6]), None, s.u, space=s.space) for s in run]
    near, moved = (film_of(ec.animate(states).text) for states in (run, far))
    assert moved["layout"] == near["layout"]
    assert moved["ranges"] == near["ranges"]
    for columns, others in zip(near["frames"], moved["frames"], strict=True):
        for one, other in zip(columns, others, strict=True):
            whole = [np.frombuffer(base64.b64decode(c), "<u2").astype(int) for c in (one, other)]
            assert np.abs(whole[0] - whole[1]).max() <= 1


def test_animation_has_positions_and_values_to_16_bits(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    film = film_of(ec.animate(run).text)
    for state, columns in zip(run, film["frames"], strict=True):
        whole = [np.frombuffer(base64.b64decode(c), "<u2") for c in columns]
        for values, n, (low, high) in zip(
            [*state.x.T, state.u], whole, film["ranges"], strict=True
        ):
            assert abs(low + n * (high - low) / 65535 - values).max() <= (high - low) / 65535
    corners = [np.frombuffer(base64.b64decode(c), "<u4") for c in film["triangles"][0]]
    assert (flat_triangles(run[0].space.cells, 2) == np.array(corners).T).all()


@pytest.mark.parametrize(("factor", "last"), [(20, 20), (1e6, 101)])
def test_values_between_the_limits_stay_apart_whatever_comes_later(run, monkeypatch, factor, last):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    grown = ec.State(2.0, run[0].x, u=factor * run[0].u, space=run[0].space)
    film = film_of(ec.animate([*run, grown], limits=(-1, 1)).text)
    low, high = film["ranges"][3]
    first, *_, end = (
        low + np.frombuffer(base64.b64decode(columns[3]), "<u2") * (high - low) / 65535
        for columns in film["frames"]
    )
    np.testing.assert_allclose(first, run[0].u, rtol=0, atol=2e-3)
    assert end.max() == pytest.approx(last)


def test_animation_has_controls_of_the_browser_and_stills_for_paper(run, monkeypatch):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    page = BeautifulSoup(ec.animate(run).text, "html.parser")
    assert page.button.text == "play"
    assert page.find("input", type="range")["aria-label"] == "time"
    assert page.select_one("[role=img]")["aria-label"].startswith("From t = 0 to 1")
    kind, _, data = page.img["src"].partition(";base64,")
    assert kind == "data:image/png"
    with Image.open(io.BytesIO(base64.b64decode(data))) as stills:
        assert stills.size == (900, 340)


def test_animation_carries_its_script_where_no_page_has_one(run, monkeypatch):
    monkeypatch.delenv("ESFEM_PLOTLY_JS", raising=False)
    text = ec.animate(run, values=lambda s: s.x[:, 2]).text
    assert "src=" not in text.split("<script")[1].split(">")[0]
    assert len(text) > 1_000_000


def test_convergence_plot_refuses_what_has_no_logarithm_or_no_slope():
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    for steps, errors, message in [
        ([0.1, 0.05], {"u": [1e-3, np.nan]}, r"errors\['u'\] must be finite, .*\[1\] is nan"),
        ([0.1, 0.05], {"u": [1e-3, 0]}, r"errors\['u'\] must be positive .* got 0"),
        ([0.1, 0.05], {"u": [1e-3]}, r"errors\['u'\] must have shape \(2,\), got \(1,\)"),
        ([0.1, 0.05], {}, "errors must hold at least one curve"),
        ([0.1], {"u": [1e-3]}, r"at least two different ones, got \[0\.1\]"),
        ([0.1, 0.1], {"u": [1e-3, 1e-3]}, "at least two different ones"),
        (0.1, {"u": 1e-3}, r"sizes must have shape \(n,\), got \(\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            convergence_plot(ax, steps, errors, 3, "step")
    with pytest.raises(TypeError, match="errors must be a mapping from names"):
        convergence_plot(ax, [0.1, 0.05], [[2.0, 1.0]], 3, "step")
    with pytest.raises(TypeError, match="ax must be axes of matplotlib, got None"):
        convergence_plot(None, [0.1, 0.05], {"u": [2.0, 1.0]}, 3, "step")


def test_a_plot_shows_the_fitted_order_and_a_slope_below_all_curves():
    """Three halvings; a factor of 8 in the second error tilts the line by 3/10."""
    from matplotlib.figure import Figure

    ax, h = Figure().subplots(), np.array([0.8, 0.4, 0.2, 0.1])
    convergence_plot(ax, h, {"a": 3 * h**2 * [1, 8, 1, 1], "b": 2 * h**1.5}, 2, "h")
    *curves, slope = ax.get_lines()
    assert [line.get_label() for line in curves] == ["a (order 2.30)", "b (order 1.50)"]
    x, y = slope.get_data()
    np.testing.assert_allclose(x, [0.1, 0.8])
    np.testing.assert_allclose(y, 0.5 * 2 * 0.8**-0.5 * x**2)  # b lies lowest at h = 0.8


def test_a_size_is_a_fraction_only_if_it_is_one():
    from matplotlib.figure import Figure

    ax, h = Figure().subplots(), np.array([1 / 10, 0.0502, 1 / 40])
    convergence_plot(ax, h, {"a": h}, 1, "h")
    assert [text.get_text() for text in ax.get_xticklabels()] == ["1/10", "0.05", "1/40"]


def test_curves_take_the_colours_and_markers_of_the_palette_in_turn():
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    curves = {str(i): [2.0 * (i + 1), 1.0 * (i + 1)] for i in range(len(COLOURS) + 1)}
    convergence_plot(ax, [0.1, 0.05], curves, 1, "step")
    lines = ax.get_lines()[: len(curves)]
    assert [line.get_color() for line in lines] == [*COLOURS, COLOURS[0]]
    assert [line.get_marker() for line in lines] == [*MARKERS, MARKERS[0]]


def test_a_curve_that_the_legend_would_leave_out_is_refused():
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    with pytest.raises(ValueError, match=r"must not have names that begin with _, .* got \['_u'\]"):
        convergence_plot(ax, [0.1, 0.05], {"_u": [1.0, 0.5]}, 1, "step")
    assert not ax.lines
