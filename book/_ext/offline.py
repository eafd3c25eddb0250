"""Sphinx extension: what the theme and Jupyter Book would ask of a server, taken out.

The pages are read from disk and without a network, where a live kernel cannot be reached and a
browser refuses to preload fonts (the icons are drawn without them).
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

FONT_PRELOAD = re.compile(r'\s*<link rel="preload" as="font"[^>]*>')


def drop_thebe(app: Sphinx, config: object) -> None:
    """Silence sphinx-thebe, which Jupyter Book always loads and which names a remote script."""
    for event, listeners in app.events.listeners.items():
        app.events.listeners[event] = [
            listener for listener in listeners if listener.handler.__module__ != "sphinx_thebe"
        ]
    app.registry.css_files = [f for f in app.registry.css_files if f[0] != "sphinx-thebe.css"]


def drop_font_preloads(app: Sphinx, exception: Exception | None) -> None:
    """Remove the preload links from the finished pages."""
    for page in Path(app.outdir).rglob("*.html"):
        page.write_text(FONT_PRELOAD.sub("", page.read_text("utf8")), "utf8")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.set_html_assets_policy("always")  # tooltips may hold formulas where the page has none
    app.connect("config-inited", drop_thebe)
    app.connect("build-finished", drop_font_preloads)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
