"""Figures for the dark theme: greys turned round, lines bright enough, colour maps as they are."""

from types import SimpleNamespace

import figures
import pytest
from matplotlib.figure import Figure

from esfem_core.output import COLOURS

# With the dark paper, #121212, by the formula of WCAG 2.2.
CONTRASTS = {"#ffffff": 18.73, "#00ff00": 13.65, "#ff0000": 4.69, "#777777": 4.18, "#0000ff": 2.18}


@pytest.fixture
def drawn(tmp_path):
    ax = Figure().subplots()
    ax.plot([0, 1], [0, 1], color="#0072b2")
    ax.bar([0.5], [0.5], color="#440154")
    ax.set_xlabel("time")
    ax.figure.savefig(tmp_path / "figure.svg")
    return (tmp_path / "figure.svg").read_text("utf8")


def test_black_becomes_light_and_the_paper_is_let_through(drawn):
    dark = figures.dark(drawn)
    assert "#000000" not in dark
    assert "#ffffff" not in dark
    assert 'style="fill: none"' in dark
    assert '<svg fill="#ced6dd"' in dark  # letters name no colour where they are black


def test_lines_are_bright_enough_and_areas_keep_their_colour(drawn):
    dark = figures.dark(drawn)
    assert "stroke: #0072b2" not in dark
    assert "fill: #440154" in dark


def test_contrast_is_that_of_wcag():
    found = {colour: figures.contrast(colour) for colour in CONTRASTS}
    assert found == pytest.approx(CONTRASTS, abs=0.006)


def test_colours_of_the_palette_are_bright_enough_and_stay_apart():
    lighter = [figures.lighter(colour.lower()) for colour in COLOURS]
    assert min(map(figures.contrast, lighter)) >= 4.5
    assert len(set(lighter)) == len(COLOURS)


def test_a_page_shows_one_of_two_pictures_and_links_to_it(drawn, tmp_path):
    file = 64 * "a"
    name = f"../_images/{file}"
    context = {"body": f'<p><img alt="A line." src="{name}.svg" /></p>'}
    builder = SimpleNamespace(images={"figure.svg": f"{file}.svg"})
    figures.link(
        SimpleNamespace(srcdir=tmp_path, builder=builder), "page", "page.html", context, None
    )
    assert f'esfem-light" href="{name}.svg"' in context["body"]
    assert f'esfem-dark" href="{name}-dark.svg"' in context["body"]
    assert context["body"].count('alt="A line."') == 2
    # 6.4 by 4.8 inches: what has its size keeps what is below in its place until it is loaded.
    assert context["body"].count('width="614" height="461"') == 2
