"""Chapters run in the browser, on a machine that reaches no other one.

Run by ``make check-lite``, which builds the book and JupyterLite first.
"""

import functools
import http.server
import json
import os
import re
import shutil
import threading
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
HTML = ROOT / "_build" / "html"
RUN = ["04_linearly_implicit_bdf", "05_g_stability", "14_exact_benchmarks", "16_your_own_problem"]
LIMIT = float(os.environ.get("LITE_TIMEOUT", "600"))  # seconds for a chapter

# What the reader of chapter 4 changes, and what he wants to know then.
BEFORE, AFTER = '("octahedron", 3), DEGREE, project', '("octahedron", 3), 3, project'
NUMBERS = (
    "own = ec.problems.expanding_sphere()\n"
    "state = final(ec.evolve(space, own, 3, STEP, 1.0))\n"
    "e = ec.errors.compare(space, own, state)\n"
    'print(*(f"{number:.12e}" for number in (e.x_l2, e.v_l2, e.u_l2)))'
)

# Jupyter's turning wheels, drawn in software, take as much time as the computation.
STILL = """document.addEventListener("DOMContentLoaded", () => {
    const style = document.createElement("style");
    style.textContent = "*, *::before, *::after { animation: none !important; }";
    document.head.append(style);
});"""
CELLS = """() => {
    const notebook = window.jupyterapp?.shell?.currentWidget;
    if (!notebook?.content?.model) return null;
    return [...notebook.content.model.cells].filter((c) => c.type === "code").map((c) => ({
        source: c.sharedModel.getSource(),
        count: c.executionCount,
        state: c.executionState,
        outputs: c.outputs.toJSON(),
    }));
}"""
CHANGE_AND_RUN = """async ([before, after, numbers]) => {
    const { content } = jupyterapp.shell.currentWidget;
    const cells = [...content.model.cells];
    const place = cells.findIndex((c) => c.sharedModel.getSource().includes(before));
    const source = cells[place].sharedModel.getSource();
    cells[place].sharedModel.setSource(source.replace(before, after));
    content.activeCellIndex = place;
    await jupyterapp.commands.execute("notebook:run-cell");
    await jupyterapp.commands.execute("notebook:insert-cell-below");
    content.activeCell.model.sharedModel.setSource(numbers);
    await jupyterapp.commands.execute("notebook:run-cell");
}"""


@pytest.fixture(scope="session")
def address():
    """Serve the book on this machine."""
    assert (HTML / "lite").is_dir(), "there is no JupyterLite in the book: run `make check-lite`"

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = functools.partial(Quiet, directory=HTML)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="session")
def browser():
    """Give a Chromium that finds no host but this one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    assert found, "no Chromium found: install it, or name its executable in CHROMIUM"
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=found,
            args=[
                *("--no-sandbox", "--disable-dev-shm-usage"),
                *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            ],
        )
        yield chromium
        chromium.close()


class Reader:
    """Somebody who opens a chapter and presses its button."""

    def __init__(self, browser, address):
        self.context = browser.new_context(reduced_motion="reduce")
        self.context.set_default_navigation_timeout(1e3 * LIMIT)
        self.context.add_init_script(STILL)
        self.asked, self.bytes = [], 0
        self.context.on("request", lambda request: self.asked.append(request.url))
        self.context.on("response", self.count)
        self.tab = self.context.new_page()
        self.address = address

    def count(self, response):
        # what the service worker answers, it has asked the server for
        if "/lite/" in response.url and not response.from_service_worker:
            self.bytes += int(response.headers.get("content-length", 0))

    def open(self, chapter):
        self.tab.goto(f"{self.address}/book/{chapter}.html")
        button = self.tab.locator(".esfem-launch a").first
        said = re.search(r"\((\d+) MB\)", button.inner_text())
        button.click()
        self.tab.wait_for_url("**/lite/notebooks/**")
        return int(said[1])

    def wait(self):
        """Wait until all is run or something fails, and return the cells."""
        start = time.monotonic()
        while time.monotonic() - start < LIMIT:
            cells = [c for c in self.tab.evaluate(CELLS) or [] if c["source"]]
            for cell in cells:
                for output in cell["outputs"]:
                    assert output["output_type"] != "error", "\n".join(output["traceback"])
            if cells and all(c["count"] and c["state"] == "idle" for c in cells):
                return cells
            self.tab.wait_for_timeout(500)
        raise AssertionError(f"not done after {LIMIT:g} s: {[c['count'] for c in cells]}")

    def come_near(self, figure):
        """Scroll to a picture until it is drawn: what is above it may still grow."""
        for _ in range(60):
            figure.evaluate("f => f.scrollIntoView({ block: 'center' })")
            self.tab.wait_for_timeout(1000)
            if figure.locator("canvas").count():
                return
        raise AssertionError("the picture is not drawn")


@pytest.fixture
def reader(browser, address):
    one = Reader(browser, address)
    yield one
    one.context.close()


def printed(outputs):
    """Numbers in what a cell has printed."""
    text = "".join(o["text"] for o in outputs if o["output_type"] == "stream")
    return [float(word) for word in text.split()]


def natively(chapter):
    """Return the three numbers, with the change, computed without a browser."""
    notebook = nbformat.read(ROOT / "book" / f"{chapter}.ipynb", as_version=4)
    place = next(i for i, cell in enumerate(notebook.cells) if BEFORE in cell.source)
    notebook.cells[place].source = notebook.cells[place].source.replace(BEFORE, AFTER)
    notebook.cells[place + 1 :] = [nbformat.v4.new_code_cell(NUMBERS)]
    NotebookClient(notebook, timeout=LIMIT).execute()
    return printed(notebook.cells[-1].outputs)


def test_every_chapter_that_can_run_has_a_button_and_its_notebook(address):
    listed = json.loads((HTML / "lite/api/contents/all.json").read_text("utf8"))["content"]
    buttons = 0
    for notebook in sorted((ROOT / "book").glob("[0-9]*.ipynb")):
        page = (HTML / "book" / f"{notebook.stem}.html").read_text("utf8")
        buttons += (found := page.count(f"index.html?path={notebook.name}&amp;run=1"))
        assert found <= 1
        assert notebook.name in [item["name"] for item in listed]
    assert buttons >= 18


@pytest.mark.parametrize("chapter", RUN)
def test_a_chapter_runs_to_its_end(chapter, reader):
    said = reader.open(chapter)
    cells = reader.wait()
    assert [c["count"] for c in cells] == list(range(1, len(cells) + 1))
    assert [
        url for url in reader.asked if not url.startswith(("data:", "blob:", reader.address))
    ] == []
    assert reader.bytes / 1e6 == pytest.approx(said, rel=0.1)
    figures = reader.tab.locator(".esfem-animation")
    drawing = re.compile(r"^ec\.animate\(", re.M)
    assert figures.count() == sum(len(drawing.findall(c["source"])) for c in cells)
    for figure in figures.all():
        reader.come_near(figure)
        slider, clock = figure.locator("input[type=range]"), figure.locator("output")
        slider.fill("0")
        start = clock.inner_text()
        slider.fill(slider.get_attribute("max"))
        assert clock.inner_text() != start
    if chapter == RUN[0]:
        reader.tab.evaluate(CHANGE_AND_RUN, [BEFORE, AFTER, NUMBERS])
        (numbers,) = (printed(c["outputs"]) for c in reader.wait() if c["source"] == NUMBERS)
        assert len(numbers) == 3
        assert numbers == pytest.approx(natively(chapter), rel=1e-6)


def test_the_front_page_computes_where_it_stands(browser, address):
    reader = Reader(browser, address)
    reader.tab.goto(f"{address}/book/intro.html")
    place, still = reader.tab.locator("#esfem-in-place"), reader.tab.locator("#fig-alpha")
    assert still.is_visible()
    button, slider = (place.locator(part) for part in ("button", "input"))
    said = re.search(r"\((\d+) MB\)", button.inner_text())
    button.click()
    place.get_by_text("20 steps").wait_for(timeout=1e3 * LIMIT)
    assert not still.is_visible()
    assert reader.bytes / 1e6 == pytest.approx(int(said[1]), rel=0.1)
    for value, alpha in (("-2", "0.01"), ("0", "1")):
        slider.fill(value)
        place.get_by_text(f"α = {alpha}:").wait_for(timeout=1e3 * LIMIT)
    here = ("data:", "blob:", address)
    assert [url for url in reader.asked if not url.startswith(here)] == []
    reader.context.close()
