"""Sphinx extension: what the theme and Jupyter Book do that these pages cannot use, put right.

The pages are read from disk and without a network, where a live kernel cannot be reached. The
theme's icons come from a script of 1.5 MB; ``icons.css`` draws the few that are used. Some controls
have a name for screen readers that is none, or another than the one that is seen. What pops up at a
link to a chapter would end with the colon before a list.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import sphinx_tippy
from bs4 import Tag
from sphinx.application import Sphinx

PUT_RIGHT = [
    (re.compile(pattern), right)
    for pattern, right in (
        (r"\s*<link[^>]*/vendor/fontawesome/[^>]*>", ""),
        (r"\s*<script[^>]*/vendor/fontawesome/[^>]*></script>", ""),
        (r'(<summary) aria-label="Toggle hidden content"', r"\1"),  # over "Show code cell source"
        (r'<summary>(?=<span class="toctree-toggle")', '<summary aria-label="pages of this part">'),
        (r'(<div role="list" class="citation-list"|<div class="[^"]*citation[^"]*" role="list")',
         '<div class="citation-list"'),
    )
]  # fmt: skip


def drop_thebe(app: Sphinx, config: object) -> None:
    """Silence sphinx-thebe, which Jupyter Book always loads and which names a remote script."""
    for event, listeners in app.events.listeners.items():
        app.events.listeners[event] = [
            listener for listener in listeners if listener.handler.__module__ != "sphinx_thebe"
        ]
    app.registry.css_files = [f for f in app.registry.css_files if f[0] != "sphinx-thebe.css"]


tip_of = sphinx_tippy._get_header_html


def whole_tip(header: Tag, start: bool = True) -> str:
    """Return heading and first paragraph, and the list that it announces."""
    tip: str = tip_of(header, start)
    first = header.find_next_sibling("p")
    listed = first and first.text.rstrip().endswith(":") and first.find_next_sibling(True)
    if listed and listed.name in ("ul", "ol") and tip.endswith(str(first)):
        tip += str(listed)
    return tip


def put_right(app: Sphinx, exception: Exception | None) -> None:
    """Change the finished pages."""
    for page in Path(app.outdir).rglob("*.html"):
        text = page.read_text("utf8")
        for pattern, right in PUT_RIGHT:
            text = pattern.sub(right, text)
        page.write_text(text, "utf8")
    shutil.rmtree(Path(app.outdir) / "_static/vendor/fontawesome", ignore_errors=True)


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.set_html_assets_policy("always")  # tooltips may hold formulas where the page has none
    sphinx_tippy._get_header_html = whole_tip
    app.connect("config-inited", drop_thebe)
    app.connect("build-finished", put_right)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
