"""Sphinx extension: where the numbered places of the papers are in the book.

The entries stand in ``book/concordance.yml``. Each has a target, and a term of the index, so that
the search of the pages, which takes no notice of numbers in the text, finds "(2.19)".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import yaml
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from ledger import cells, table
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from esfem_core.companion.claims import anchor

SOURCE = "book/concordance.yml"


def read_entries(root: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the entries of each paper."""
    return yaml.safe_load((root / SOURCE).read_text("utf8"))


class Concordance(SphinxDirective):
    """The table of one paper."""

    option_spec: ClassVar = {"source": directives.unchanged_required}

    def run(self) -> list[nodes.Node]:
        """Set the table, with a target and terms of the index for each entry."""
        root = Path(self.env.srcdir)
        self.env.note_dependency(str(root / SOURCE))
        paper = self.options["source"]
        lines = [self.line(paper, entry) for entry in read_entries(root)[paper]]
        titles = [paper, "says", "chapter", "equations", "claims", "code"]
        return [table(titles, lines, "esfem-concordance")]

    def markdown(self, text: str) -> nodes.container:
        """Parse text."""
        node = nodes.container()
        self.state.nested_parse(StringList([text], source=SOURCE), 0, node)
        return node

    def line(self, paper: str, entry: dict[str, Any]) -> nodes.row:
        """Return the line of an entry."""
        name = re.sub(r"[^a-z0-9]+", "-", f"{paper} {entry['item']}".lower()).strip("-")
        terms = [entry["item"], *entry.get("terms", [])]
        index = addnodes.index(entries=[("single", t, name, "", None) for t in terms])
        place = nodes.paragraph("", "", index, nodes.Text(entry["item"]))
        page = entry["chapter"].removeprefix("book/")
        claims = nodes.paragraph()
        for claim in entry.get("claims", []):
            if claims.children:
                claims += nodes.Text(", ")
            uri = f"ledger.html#claim-{anchor(claim)}"
            claims += nodes.reference("", claim, internal=True, refuri=uri)
        equations = ", ".join(f"{{eq}}`{label}`" for label in entry.get("equations", []))
        code = ", ".join(f"{{py:obj}}`~esfem_core.{name}`" for name in entry.get("code", []))
        texts = (entry["says"], f"{{doc}}`{page}`", equations, code)
        says, chapter, equations_, code_ = (self.markdown(text) for text in texts)
        return cells(place, says, chapter, equations_, claims, code_, ids=[name])


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directive."""
    app.add_directive("concordance", Concordance)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
