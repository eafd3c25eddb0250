"""What a reader without network sees: themes, the ledger, figures, moving pictures, print."""

import pytest
from conftest import ROOT, on_chromium, soup

import esfem_core as ec

SCHEMES = ["light", pytest.param("dark", marks=on_chromium)]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_follows_the_theme_of_the_system(reader, scheme):
    tab = reader(scheme=scheme).open("book/about.html")
    assert tab.evaluate("document.documentElement.dataset.theme") == scheme
    text, ground = (
        tab.evaluate(f"getComputedStyle(document.querySelector('{css}')).{key}")
        for css, key in (("main p", "color"), ("body", "backgroundColor"))
    )
    light = [sum(map(int, c[c.index("(") + 1 : -1].split(",")[:3])) for c in (text, ground)]
    assert (light[0] < light[1]) == (scheme == "light")


def test_the_ledger_can_be_filtered(reader):
    tab = reader().open("book/ledger.html")
    rows = tab.locator(".esfem-ledger tbody tr[id]")
    every = rows.count()
    assert tab.locator(".esfem-filters output").inner_text() == f"{every} of {every} claims"
    tab.get_by_label("paper").select_option("LMV")
    tab.get_by_label("chapter").select_option(label="5. G-stability and multipliers")
    tab.get_by_label("verdict").select_option("✓ confirmed")
    tab.get_by_label("evidence").select_option("exact")
    shown = rows.locator("visible=true")
    names = shown.locator("td:first-child code").all_inner_texts()
    assert 0 < len(names) < every
    assert all(name.startswith("LMV-") for name in names)
    assert set(shown.locator(".esfem-verdict").all_inner_texts()) == {"✓ confirmed"}
    tab.get_by_role("button", name="show all").click()
    tab.get_by_text(f"{every} of {every} claims").wait_for()


def test_the_ledger_is_cards_on_a_phone(reader):
    tab = reader(width=390, height=844).open("book/ledger.html")
    card = tab.locator(".esfem-ledger tbody tr[id]").first
    boxes = [cell.bounding_box() for cell in card.locator("td").all()]
    assert [b["x"] for b in boxes] == [boxes[0]["x"]] * 4
    assert min(b["width"] for b in boxes) > 300


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_figure_is_that_of_the_theme_and_opens_alone(scheme, reader):
    tab = reader(scheme=scheme).open("book/05_g_stability.html")
    figures = tab.locator("a.esfem-full")
    assert figures.count() > 0
    for figure in figures.all():
        address = figure.get_attribute("href")
        shown = figure.evaluate("a => getComputedStyle(a).display !== 'none'")
        assert shown == (address.endswith("-dark.svg") == (scheme == "dark"))
        assert figure.locator("img").get_attribute("src") == address
        assert figure.locator("img").get_attribute("alt")
    tab.locator(f"a.esfem-{scheme}").first.click()
    behind = tab.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert behind == {"light": "rgba(0, 0, 0, 0)", "dark": "rgb(18, 18, 18)"}[scheme]


TOP = "id => document.getElementById(id).getBoundingClientRect().y"


def test_a_link_lands_where_it_points_to_when_formulas_are_set(reader):
    name = "check-LMV-L3_2-eta"
    one = reader(width=390, height=844)
    tab = one.open(f"book/05_g_stability.html#{name}")
    one.rest()
    assert 0 <= tab.evaluate(TOP, name) <= 150
    tab.mouse.wheel(0, -400)
    tab.wait_for_function(f"() => ({TOP})('{name}') > 300")


@on_chromium
def test_paper_shows_solutions_and_whole_lines_of_code(reader):
    tab = reader().open("book/05_g_stability.html")
    tab.emulate_media(media="print")
    solution = tab.locator(".admonition.dropdown p:not(.admonition-title)").first
    assert solution.is_visible()
    assert solution.evaluate("p => p.getBoundingClientRect().height") > 10
    wraps = tab.locator("pre").evaluate_all("all => all.map(p => getComputedStyle(p).whiteSpace)")
    assert set(wraps) == {"pre-wrap"}


def test_every_page_says_how_to_cite_the_licence_what_is_new_and_where_the_source_is(page):
    foot = soup(page).select(".esfem-footer a")
    words = " ".join(link.text for link in foot)
    for word in ("cite", "CC BY 4.0", "MIT", "new", "Source"):
        assert word in words


def test_every_picture_has_a_caption_and_words_for_those_who_do_not_see_it(page):
    pictures = soup(page).select("main .cell_output img:not(.esfem-poster)")
    bare = [p["src"] for p in pictures if not p.find_parent("figure") or p["alt"][:2] in ("", "..")]
    assert bare == []


def test_figures_have_their_size_before_they_are_loaded(page):
    figures = soup(page).select("a.esfem-full img")
    assert [p["src"] for p in figures if not (p.get("width") and p.get("height"))] == []


DRAWN = ".esfem-animation.esfem-drawn"


def test_the_landing_page_has_a_picture_that_moves_when_it_is_seen_until_it_is_taken(reader):
    tab = reader(height=300).open("book/intro.html")
    tab.wait_for_timeout(500)
    slider = tab.locator(".esfem-animation input")
    assert slider.input_value() == "0"
    tab.locator(".esfem-frame").scroll_into_view_if_needed()
    tab.set_viewport_size({"width": 1280, "height": 900})
    tab.wait_for_function("() => document.querySelector('.esfem-animation input').value > 0")
    slider.press("Home")
    tab.wait_for_timeout(500)
    assert tab.locator(".esfem-animation button").inner_text() == "play"
    assert slider.input_value() == "0"


def test_a_moving_picture_leaves_the_wheel_to_the_page_and_offers_no_upload(reader):
    tab = reader().open("book/intro.html")
    frame = tab.locator(".esfem-frame")
    frame.scroll_into_view_if_needed()
    tab.wait_for_selector(DRAWN)
    before = tab.evaluate("scrollY")
    frame.hover()
    tab.mouse.wheel(0, 200)
    tab.wait_for_function(f"() => scrollY > {before} + 100")
    assert tab.locator(".modebar-btn").count() == 0


@on_chromium
def test_a_moving_picture_is_printed_as_stills(reader):
    tab = reader().open("book/intro.html")
    tab.emulate_media(media="print")
    assert tab.locator("img.esfem-poster").is_visible()
    assert tab.locator("img.esfem-poster").evaluate("i => i.naturalWidth") == 900
    assert not tab.locator(".esfem-controls").is_visible()


# As some notebooks do: the scripts of an output run at its end.
MOVED = """() => document.querySelectorAll("div").forEach((output) => {
  for (const { text } of output.querySelectorAll("script"))
    output.appendChild(Object.assign(document.createElement("script"), { text })).remove();
})"""


@pytest.mark.parametrize("place", ["page", "notebook"])
def test_pictures_of_one_name_do_not_meet(reader, tmp_path, monkeypatch, place):
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "plotly.js")
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    states = [ec.State(t, space.nodes, space=space) for t in range(5)]
    shown = "".join(f"<div>{ec.animate(states[:n]).text}</div>" for n in (3, 5))
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html>{shown}" if place == "page" else "<!doctype html>", "utf8")
    tab = reader(reduced_motion="reduce").open(page)
    if place == "notebook":  # scripts in markup that is set do not run
        tab.evaluate("text => { document.body.innerHTML = text; }", shown)
        tab.evaluate(MOVED)
    assert [slider.get_attribute("max") for slider in tab.locator("input").all()] == ["2", "4"]


def test_what_differs_in_the_eighth_digit_has_colours_and_numbers_of_its_own(
    reader, tmp_path, monkeypatch
):
    script = ROOT / "book/assets/plotly/plotly-gl3d.min.js"
    monkeypatch.setenv("ESFEM_PLOTLY_JS", script.as_uri())
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    x = space.nodes
    state = ec.State(0.0, 1e7 + x, u=1 + 1e-7 * x[:, 2], space=space)
    tab = reader().open(ec.animate([state], tmp_path / "page.html"))
    tab.wait_for_selector(DRAWN)
    ticks = tab.locator(".cbaxis text").all_text_contents()
    assert ticks == ["0.9999999", "1", "1.0000001"]
    drawn = tab.evaluate(
        "() => { const d = document.querySelector('.esfem-stage')._fullData[0];"
        " return [d.x, d.intensity].map((a) => [...a]); }"
    )
    assert drawn[0] == pytest.approx(x[:, 0], abs=1e-4)
    assert [1e7 * (u - 1) for u in drawn[1]] == pytest.approx(x[:, 2], abs=1e-4)


def test_what_the_pointer_tells_can_be_read_where_the_page_is_dark(reader, tmp_path, monkeypatch):
    """The words had the light colour of the page on their own white ground."""
    monkeypatch.setenv("ESFEM_PLOTLY_JS", (ROOT / "book/assets/plotly/plotly-gl3d.min.js").as_uri())
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    state = ec.State(0.0, space.nodes, u=space.nodes[:, 2], space=space)
    tab = reader().open(ec.animate([state], tmp_path / "page.html"))
    tab.evaluate("document.documentElement.style.color = 'rgb(221, 221, 221)'")
    tab.wait_for_selector(DRAWN)
    tab.wait_for_timeout(500)
    tab.locator(".esfem-frame").hover()
    tab.locator(".hovertext text").first.wait_for()
    fills = [
        tab.locator(css).first.evaluate("text => getComputedStyle(text).fill")
        for css in (".hovertext text", ".cbaxis text")
    ]
    assert fills[1] == "rgb(221, 221, 221)" != fills[0]
