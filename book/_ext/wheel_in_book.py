"""Sphinx extension: the wheel of the package, a part of the book.

``make wheel`` puts it into ``_build/wheel``; the built book has a copy with its checksum, and the
directive ``wheel`` says how to install it from there.
"""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

FOLDER = "wheel"
"""Of the built book."""


def the_wheel(root: Path) -> Path:
    """Return the one that was built."""
    found = sorted((root / "_build" / FOLDER).glob("*.whl"))
    if len(found) != 1:
        raise ExtensionError(f"_build/{FOLDER} must hold one wheel, not {len(found)}: `make wheel`")
    return found[0]


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Wheel(SphinxDirective):
    """Link to the wheel, with its size, its checksum and the command that installs it."""

    def run(self) -> list[nodes.Node]:
        """Set a paragraph and two lines of code."""
        wheel = the_wheel(Path(self.env.srcdir))
        self.env.note_dependency(str(wheel))
        up = "../" * self.env.docname.count("/")
        link = nodes.reference("", wheel.name, refuri=f"{up}{FOLDER}/{wheel.name}", internal=False)
        size = f", {wheel.stat().st_size / 1e6:.1f} MB, with this SHA-256:"
        lines = f"{checksum(wheel)}  {wheel.name}", f"python -m pip install {wheel.name}"
        return [
            nodes.paragraph("", "", link, nodes.Text(size)),
            nodes.literal_block(lines[0], lines[0], language="none"),
            nodes.paragraph("", "In the folder into which it was downloaded:"),
            nodes.literal_block(lines[1], lines[1], language="bash"),
        ]


def copy(app: Sphinx, exception: Exception | None) -> None:
    """Put the wheel and its checksum beside the pages."""
    if exception is None and app.builder.format == "html":
        wheel, folder = the_wheel(Path(app.srcdir)), Path(app.outdir) / FOLDER
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        shutil.copy(wheel, folder)
        (folder / "SHA256SUMS").write_text(f"{checksum(wheel)}  {wheel.name}\n", "ascii")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.add_directive("wheel", Wheel)
    app.connect("build-finished", copy)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
