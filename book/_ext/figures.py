"""Sphinx extension: figures for a dark page, and the full picture behind every figure.

matplotlib draws black on white. Each of its files gets a sibling for the dark theme, in which greys
are turned round between the colours of that theme and lines that would be too dark are lighter. A
page shows one of the two, and a click or a tap opens it alone, where a phone can magnify it. It has
its size before it is loaded, so that what is below stays where it is.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

IMAGE = re.compile(r'<img (?P<rest>[^>]*)src="(?P<file>[^"]*_images/[0-9a-f]{64})\.svg"')
COLOUR = re.compile(r"#[0-9a-f]{6}\b")
STROKE = re.compile(r"stroke: (#[0-9a-f]{6})\b")
SIZE = re.compile(r'<svg [^>]*\bwidth="([\d.]+)pt" height="([\d.]+)pt"')
BEHIND = re.compile(r'(<g id="patch_\d+">\s*<path [^>]*style="fill: )#ffffff')
Rgb = tuple[float, ...]
PAPER, INK = (18, 18, 18), (206, 214, 221)  # of the theme when it is dark
CONTRAST = 4.5  # of a line with the paper, at least
POINT = 4 / 3  # in pixels of CSS


def rgb(colour: str) -> Rgb:
    """Return red, green and blue, 0 to 255."""
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def mixed(a: Rgb, b: Rgb, share: float) -> str:
    """Return a colour between two."""
    return "#" + "".join(f"{round(p + share * (q - p)):02x}" for p, q in zip(a, b, strict=True))


def luminance(colour: Rgb) -> float:
    """Return the relative luminance of WCAG 2.2."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (part / 255 for part in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(colour: str) -> float:
    """Return the contrast with the dark paper."""
    return (luminance(rgb(colour)) + 0.05) / (luminance(PAPER) + 0.05)


def lighter(colour: str) -> str:
    """Mix a colour with white until it can be told from the dark paper."""
    tried = (mixed(rgb(colour), (255, 255, 255), share / 20) for share in range(21))
    return next(c for c in tried if contrast(c) >= CONTRAST)


def dark(svg: str) -> str:
    """Return the picture for the dark theme."""
    drawn = set(STROKE.findall(svg))  # areas of a colour map stay as they are

    def turned(match: re.Match[str]) -> str:
        colour = match[0]
        if len(set(rgb(colour))) == 1:
            return mixed(INK, PAPER, rgb(colour)[0] / 255)
        return lighter(colour) if colour in drawn else colour

    svg = COLOUR.sub(turned, BEHIND.sub(r"\1none", svg))
    # Black is what says nothing; alone in a window, the picture has no page behind it.
    root = f'<svg fill="{mixed(INK, INK, 0)}" style="background: {mixed(PAPER, PAPER, 0)}" '
    return svg.replace("<svg ", root, 1)


def size(svg: str) -> str:
    """Return width and height as an image on a page states them, in pixels."""
    found = SIZE.search(svg)
    if not found:
        return ""
    width, height = (round(POINT * float(points)) for points in found.groups())
    return f'width="{width}" height="{height}" '


def link(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """Show the picture of the theme, and open it alone when asked."""
    paths = {name: Path(app.srcdir, path) for path, name in app.builder.images.items()}

    def both(match: re.Match[str]) -> str:
        rest, file = match["rest"], match["file"]
        room = size(paths[f"{file.rpartition('/')[2]}.svg"].read_text("utf8"))
        # The theme puts images on white cards, unless they are of the class "dark-light".
        return "".join(
            f'<a class="esfem-full esfem-{kind}" href="{name}" title="the picture alone">'
            f'<img {rest}src="{name}" class="dark-light" {room}{more}/></a>'
            for kind, name, more in (
                ("light", f"{file}.svg", ""),
                ("dark", f"{file}-dark.svg", 'loading="lazy" '),
            )
        )

    context["body"] = re.sub(IMAGE.pattern + r"[^>]*>", both, context.get("body") or "")


def draw_dark(app: Sphinx, exception: Exception | None) -> None:
    """Write the pictures for the dark theme."""
    for path in Path(app.outdir, "_images").glob("*.svg"):
        if not path.stem.endswith("-dark"):
            sibling = path.with_name(f"{path.stem}-dark.svg")
            sibling.write_text(dark(path.read_text("utf8")), "utf8")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("html-page-context", link)
    app.connect("build-finished", draw_dark)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
