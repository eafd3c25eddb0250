"""What axe-core, https://github.com/dequelabs/axe-core, finds wrong for readers with disabilities.

``axe/axe.min.js`` is that of the npm package axe-core 4.10.3; its licence, MPL 2.0, is beside it.
"""

from pathlib import Path

AXE = Path(__file__).parent / "axe" / "axe.min.js"
CODE_TOO = ("book/02_elements_and_assembly.html", "_modules/esfem_core/errors.html")
RUN = """async ([theme, leave]) => {
    document.documentElement.dataset.theme = theme;
    await new Promise((done) => setTimeout(done, 300));  // colours change slowly
    const only = theme === "dark" ? { runOnly: ["color-contrast"] } : {};
    const found = await axe.run({ exclude: leave }, { resultTypes: ["violations"], ...only });
    return found.violations
        .filter((v) => ["serious", "critical"].includes(v.impact))
        .map((v) => [theme, v.id, v.nodes.length, v.nodes[0].html, v.nodes[0].failureSummary]);
}"""


def test_nothing_serious_bars_a_reader_in_the_light_or_in_the_dark(seen, reader):
    tab = reader(reduced_motion="reduce").open(seen)
    tab.add_script_tag(path=str(AXE))
    # Formulas have the colour of the text around them, and code the same colours everywhere.
    leave = ["mjx-container"] + ([] if seen in CODE_TOO else [".highlight pre"])
    assert [f for theme in ("light", "dark") for f in tab.evaluate(RUN, [theme, leave])] == []
