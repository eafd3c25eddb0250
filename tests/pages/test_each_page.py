"""Each page, opened once, on a phone: all is there, it fits, it moves, and nothing bars a reader.

Readers with disabilities are spoken for by axe-core, https://github.com/dequelabs/axe-core.
``axe/axe.min.js`` is that of the npm package axe-core 4.10.3; its licence, MPL 2.0, is beside it.
"""

from pathlib import Path

AXE = Path(__file__).parent / "axe" / "axe.min.js"
CODE_TOO = ("book/02_elements_and_assembly.html", "_modules/esfem_core/errors.html")
# In a formula and in code colours are those of the text around, and the same everywhere. Contrast
# is measured three times for each chain of tags and classes, not at each of thousands of words.
# What is left out is taken away: axe compares each element with each one it is told to exclude.
EMPTY = "(css) => document.querySelectorAll(css).forEach((e) => e.replaceChildren())"
HIDE_ALIKE = """() => {
    const times = new Map();
    const look = (e, above) => {
        const chain = `${above} ${e.tagName}.${e.getAttribute("class") ?? ""}`;
        times.set(chain, (times.get(chain) ?? 0) + 1);
        const inside = [...e.children].map((child) => look(child, chain));
        const known = times.get(chain) > 3 && inside.every((k) => k);
        if (known) e.style.display = "none";
        return known;
    };
    look(document.body, "");
}"""
RUN = """async ([theme, options]) => {
    const found = await axe.run({ resultTypes: ["violations"], ...options });
    return found.violations
        .filter((v) => ["serious", "critical"].includes(v.impact))
        .map((v) => [theme, v.id, v.nodes.length, v.nodes[0].html, v.nodes[0].failureSummary]);
}"""
SET_THEME = "(theme) => { document.documentElement.dataset.theme = theme; }"
CONTRAST = {"runOnly": ["color-contrast"]}
REST = {"rules": {"color-contrast": {"enabled": False}}}


def test_opens_without_an_error_and_with_all_that_belongs_to_it(seen, opened):
    tab = opened.tab
    assert opened.trouble == []
    formulas = tab.locator(".math").count()
    assert tab.locator("main mjx-container").count() >= formulas
    assert tab.locator("mjx-merror, [data-mjx-error]").count() == 0
    missing = tab.evaluate(
        "() => [...document.images].filter(i => i.getClientRects().length"  # of this theme
        " && !(i.complete && i.naturalWidth)).map(i => i.src)"
    )
    assert missing == []


def test_does_not_scroll_sideways_on_a_phone_and_cuts_nothing_without_a_sign(seen, opened):
    tab = opened.tab
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    unsaid = tab.evaluate(
        "() => [...document.querySelectorAll('main mjx-container[display=true], .esfem-table')]"
        ".filter(box => box.clientWidth && box.scrollWidth > box.clientWidth + 2)"
        ".filter(box => !box.dataset.hidden || box.tabIndex !== 0).map(box => box.textContent)"
    )
    assert unsaid == []
    clipped = tab.evaluate(
        "() => [...document.querySelectorAll('main span.math')].filter(m => m.clientWidth"
        " && m.firstElementChild.getBoundingClientRect().width > m.clientWidth + 2"
        " && getComputedStyle(m).overflowX !== 'auto').map(m => m.textContent)"
    )
    assert clipped == []


def test_sliders_move_their_pictures(seen, opened):
    for picture in opened.tab.locator(".esfem-animation").all():
        picture.locator(".esfem-frame").scroll_into_view_if_needed()
        picture.locator("canvas").first.wait_for()
        slider, shown = picture.get_by_role("slider", name="time"), []
        for key in ("End", "ArrowLeft", "Home"):
            slider.press(key)
            opened.tab.wait_for_timeout(500)
            drawn = picture.locator(".esfem-stage").evaluate(
                # a resting surface shows by its colours that something moved
                "p => { const d = p._fullData[0];"
                " return [d.x, d.intensity].map(a => Array.from(a.slice(0, 50))); }"
            )
            shown.append((slider.get_attribute("aria-valuetext"), drawn))
            assert picture.locator("output").inner_text() == shown[-1][0]
        assert len({label for label, _ in shown}) == 3
        assert shown[0][1] != shown[2][1]
    assert opened.trouble == []


def barred(opened, theme, options):
    """List what axe finds serious in this theme, once the page has taken it on."""
    opened.tab.evaluate(SET_THEME, theme)
    opened.rest()
    return opened.tab.evaluate(RUN, [theme, options])


def test_nothing_serious_bars_a_reader_in_the_light_or_in_the_dark(seen, opened):
    tab, opened.apart = opened.tab, True  # not much is left of it in the end
    tab.set_viewport_size({"width": 1280, "height": 900})
    tab.evaluate(EMPTY, "mjx-container" + ("" if seen in CODE_TOO else ", .highlight pre"))
    tab.add_script_tag(path=str(AXE))
    found = barred(opened, "light", REST)
    tab.evaluate(HIDE_ALIKE)
    for theme in ("light", "dark"):
        found += barred(opened, theme, CONTRAST)
    assert found == []
