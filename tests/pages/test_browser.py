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


def test_the_landing_page_has_a_moving_picture(reader):
    tab = reader().open("book/intro.html")
    tab.wait_for_function(
        "() => document.querySelector('.js-plotly-plot')?.layout?.sliders[0].active > 0"
    )


@pytest.mark.parametrize(
    "plotted", [p for p in PAGES if "Plotly.newPlot" in (HTML / p).read_text()]
)
def test_sliders_move_their_picture(plotted, reader):
    one = reader()
    tab = one.open(plotted)
    plots = tab.locator(".js-plotly-plot:has(.slider-rail-rect)")
    assert plots.count() > 0
    for i in range(plots.count()):
        plot = plots.nth(i)
        plot.scroll_into_view_if_needed()
        plot.locator(".updatemenu-button", has_text="pause").click()
        shown = []
        for share in (0.2, 0.7):
            rail = plot.locator(".slider-rail-rect").bounding_box()
            tab.mouse.click(rail["x"] + share * rail["width"], rail["y"] + rail["height"] / 2)
            tab.wait_for_timeout(500)
            active, steps, label = plot.evaluate(
                "p => [p.layout.sliders[0].active, p.layout.sliders[0].steps.length,"
                " p.querySelector('.slider-group > .slider-label').textContent]"
            )
            assert abs(active - share * (steps - 1)) <= 0.1 * steps
            drawn = plot.evaluate(  # a resting surface shows by its colours that something moved
                "p => { const d = p._fullData[0];"
                " return [d.x, d.intensity || []].map(a => Array.from(a.slice(0, 50))); }"
            )
            shown.append((label, drawn))
        assert shown[0][0] != shown[1][0]
        assert shown[0][1] != shown[1][1]
        assert plot.locator("canvas").count() > 0
    assert one.trouble == []
