"""The built book, and a browser without network to read it in.

Run by ``make check-book``, which builds the book first, and by ``make check-firefox``.
"""

import os
import shutil
from functools import cache
from pathlib import Path

import pytest
from bs4 import BeautifulSoup

BROWSER = os.environ.get("BROWSER", "chromium")  # or "firefox"
on_chromium = pytest.mark.skipif(
    BROWSER != "chromium", reason="Firefox cannot be told yet what its system or its medium is"
)
missing = pytest.fail if os.environ.get("CI") else pytest.skip  # there a browser must be
ROOT = Path(__file__).parents[2]
HTML = ROOT / "_build" / "html"
PAGES = sorted(
    path.relative_to(HTML).as_posix()
    for path in HTML.rglob("*.html")
    if "_static" not in path.parts and path != HTML / "index.html"
)
# The listings of the sources are made alike: in a browser one of them stands for all.
SEEN = [p for p in PAGES if not p.startswith("_modules/esfem_core/") or p.endswith("errors.html")]


@cache  # the larger pages take a second
def soup(page):
    """Parse a page of the book."""
    return BeautifulSoup((HTML / page).read_text("utf8"), "html.parser")


def pytest_generate_tests(metafunc):
    """Run a test that asks for a page on each page, and one that asks for a seen one on those."""
    for name, pages in (("page", PAGES), ("seen", SEEN)):
        if name in metafunc.fixturenames:
            metafunc.parametrize(name, pages, scope="session")


@pytest.fixture(scope="session", autouse=True)
def built():
    """Fail where there is nothing to check."""
    if not PAGES:
        pytest.fail("there is no built book in _build/html: run `make check-book`")


def chromium(playwright):
    """Start a headless Chromium that draws WebGL in software."""
    names = ("chromium", "chromium-browser", "google-chrome")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    if not found:
        missing("no Chromium found: install it, or name its executable in CHROMIUM")
    return playwright.chromium.launch(
        executable_path=found,
        args=[
            *("--no-sandbox", "--disable-dev-shm-usage"),
            *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
        ],
    )


def firefox(playwright):
    """Start the Firefox of the system, without a window."""
    names = ("firefox-esr", "firefox")
    found = os.environ.get("FIREFOX") or next(filter(None, map(shutil.which, names)), None)
    if not found:
        missing("no Firefox found: install it, or name its executable in FIREFOX")
    return playwright.firefox.launch(channel="moz-firefox", executable_path=found)


@pytest.fixture(scope="session")
def browser():
    """Give the browser to read in."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        one = {"chromium": chromium, "firefox": firefox}[BROWSER](playwright)
        yield one
        one.close()


# A page that gets another width or another theme slides and fades to it; what is wider than its
# place is marked a frame later.
AT_REST = """async () => {
    const frame = () => new Promise(requestAnimationFrame);
    await frame();
    await Promise.allSettled(document.getAnimations().map((change) => change.finished));
    await frame();
    await frame();
}"""


class Reader:
    """A page in an offline browser, with what went wrong on it."""

    def __init__(self, browser, *, width=1280, height=900, scheme="light", **options):
        self.context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme=scheme,
            offline=True,
            **options,
        )
        self.tab = self.context.new_page()
        self.trouble = []
        self.apart = False  # whether a test has spoilt the page
        self.tab.on("pageerror", lambda error: self.trouble.append(f"exception: {error}"))
        self.tab.on("requestfailed", lambda r: self.trouble.append(f"not loaded: {r.url}"))
        self.tab.on(
            "request",
            lambda r: (
                r.url.startswith(("file:", "data:", "blob:", "about:"))
                or self.trouble.append(f"remote: {r.url}")
            ),
        )
        self.tab.on(
            "console",
            lambda m: m.type == "error" and self.trouble.append(f"console: {m.text}"),
        )

    def open(self, page):
        """Open a page of the book, or a place in it, and wait until its formulas are set."""
        path, _, place = str(page).partition("#")
        address = f"{(HTML / path).as_uri()}#{place}".removesuffix("#")
        self.tab.goto(address, wait_until="load", timeout=60_000)
        self.tab.evaluate("() => window.MathJax && MathJax.startup && MathJax.startup.promise")
        return self.tab

    def rest(self):
        """Wait until nothing slides or fades any more, and what is wide is marked."""
        self.tab.evaluate(AT_REST)


@pytest.fixture(scope="session")
def shared(seen, browser):
    """Give what `opened` gives for this page, not opened yet."""
    one = Reader(browser, width=390, height=844, reduced_motion="reduce")
    one.apart = True
    yield one
    one.context.close()


@pytest.fixture
def opened(seen, shared):
    """Give a page on a phone that tests share, in whatever order; anew after one that spoils it."""
    if shared.apart:
        shared.trouble.clear()
        shared.tab.set_viewport_size({"width": 390, "height": 844})
        shared.open(seen).wait_for_load_state("networkidle")
        shared.rest()
        shared.apart = False
    return shared


@pytest.fixture
def reader(browser):
    """Give a function that opens readers and closes them in the end."""
    readers = []

    def new(**options):
        readers.append(Reader(browser, **options))
        return readers[-1]

    yield new
    for one in readers:
        one.context.close()
