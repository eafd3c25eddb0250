"""What a reader without network sees: formulas, pictures, sliders that move, a page that fits."""

import pytest
from conftest import HTML, PAGES


def test_opens_without_an_error_and_with_all_that_belongs_to_it(page, reader):
    one = reader()
    tab = one.open(page)
    tab.wait_for_load_state("networkidle")
    assert one.trouble == []
    formulas = tab.locator(".math").count()
    assert tab.locator("main mjx-container").count() >= formulas
    assert tab.locator("mjx-merror, [data-mjx-error]").count() == 0
    missing = tab.evaluate(
        "() => [...document.images].filter(i => !(i.complete && i.naturalWidth)).map(i => i.src)"
    )
    assert missing == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_follows_the_theme_of_the_system(reader, scheme):
    tab = reader(scheme=scheme).open("book/ledger.html")
    assert tab.evaluate("document.documentElement.dataset.theme") == scheme
    text, ground = (
        tab.evaluate(f"getComputedStyle(document.querySelector('{css}')).{key}")
        for css, key in (("main p", "color"), ("body", "backgroundColor"))
    )
    light = [sum(map(int, c[c.index("(") + 1 : -1].split(",")[:3])) for c in (text, ground)]
    assert (light[0] < light[1]) == (scheme == "light")


def test_does_not_scroll_sideways_on_a_phone(page, reader):
    tab = reader(width=390, height=844).open(page)
    tab.wait_for_load_state("networkidle")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390


MOVING = [p for p in PAGES if 'class="esfem-animation"' in (HTML / p).read_text()]
DRAWN = ".esfem-animation.esfem-drawn"


def test_the_landing_page_has_a_moving_picture_that_begins_when_it_is_seen(reader):
    tab = reader(height=300).open("book/intro.html")
    tab.wait_for_timeout(500)
    slider = tab.locator(".esfem-animation input")
    assert slider.input_value() == "0"
    tab.locator(".esfem-frame").scroll_into_view_if_needed()
    tab.set_viewport_size({"width": 1280, "height": 900})
    tab.wait_for_function("() => document.querySelector('.esfem-animation input').value > 0")


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


def test_a_moving_picture_is_printed_as_stills(reader):
    tab = reader().open("book/intro.html")
    tab.emulate_media(media="print")
    assert tab.locator("img.esfem-poster").is_visible()
    assert tab.locator("img.esfem-poster").evaluate("i => i.naturalWidth") == 900
    assert not tab.locator(".esfem-controls").is_visible()


@pytest.mark.parametrize("plotted", MOVING)
def test_sliders_move_their_picture(plotted, reader):
    one = reader()
    tab = one.open(plotted)
    pictures = tab.locator(".esfem-animation")
    assert pictures.count() > 0
    for i in range(pictures.count()):
        picture = pictures.nth(i)
        picture.locator(".esfem-frame").scroll_into_view_if_needed()
        picture.locator("canvas").first.wait_for()
        button, slider = picture.get_by_role("button"), picture.get_by_role("slider", name="time")
        if button.inner_text() == "pause":
            button.press("Enter")
        assert button.inner_text() == "play"
        shown = []
        for key in ("Home", "End", "ArrowLeft"):
            slider.press(key)
            tab.wait_for_timeout(500)
            drawn = picture.locator(".esfem-stage").evaluate(
                # a resting surface shows by its colours that something moved
                "p => { const d = p._fullData[0];"
                " return [d.x, d.intensity].map(a => Array.from(a.slice(0, 50))); }"
            )
            shown.append((slider.get_attribute("aria-valuetext"), drawn))
            assert picture.locator("output").inner_text() == shown[-1][0]
        assert len({label for label, _ in shown}) == 3
        assert shown[0][1] != shown[1][1]
    assert one.trouble == []
