"""Sphinx extension: the claims ledger and the errata page.

The rows stand in ``book/claims.yml`` and ``book/errata.yml``; the measurements come from what the
notebooks show when they run; the verdicts are computed by `esfem_core.companion.claims`. A row
without a measurement, a measurement without a row and an erratum that no check bears out are
warnings, and so fail the build.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import yaml
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from esfem_core.companion import claims
from esfem_core.companion.claims import (
    CORRECTED,
    NOT_CONFIRMED,
    Claim,
    Measurement,
    anchor,
    read_html,
)

LOG = logging.getLogger(__name__)
PROOF_ONLY = "proof only"
SIGNS = claims.SIGNS | {PROOF_ONLY: "∎"}
PAPERS = ("[N]", "[LMV]")
Measured = dict[str, list[tuple[str, Claim]]]  # by claim id: the page and what it measured


def read_rows(root: Path) -> list[dict[str, str]]:
    """Return the rows of the ledger."""
    return yaml.safe_load((root / "book/claims.yml").read_text("utf8"))


def read_errata(root: Path) -> list[dict[str, str]]:
    """Return the candidates of the errata page."""
    return yaml.safe_load((root / "book/errata.yml").read_text("utf8"))


def collect(app: Sphinx, doctree: nodes.document) -> None:
    """Keep what the cells of a page measured."""
    shown = [raw.astext() for raw in doctree.findall(nodes.raw) if "data-claim" in raw.astext()]
    if shown:
        app.env.metadata[app.env.docname]["esfem_claims"] = "\n".join(shown)


def measurements(app: Sphinx) -> Measured:
    """Return what the pages of the book measured."""
    found: Measured = {}
    for document, metadata in sorted(app.env.metadata.items()):
        for claim in read_html(metadata.get("esfem_claims", "")):
            found.setdefault(claim.id, []).append((document, claim))
    return found


def problems(rows: list[dict[str, str]], found: Measured, documents: set[str]) -> Iterator[str]:
    """Yield where the ledger and what the notebooks measured do not fit together."""
    for row in rows:
        pages = [page for page, _ in found.get(row["id"], [])]
        if row["chapter"] not in documents:
            yield f"{row['id']}: there is no page {row['chapter']}"
        if pages != ([row["chapter"]] if row["kind"] == "check" else []):
            yield (
                f"{row['id']}, {row['kind']}, in {row['chapter']}: "
                f"measured in {', '.join(pages) or 'no page'}"
            )
    for name in found.keys() - {row["id"] for row in rows}:
        yield f"{name} is measured in {found[name][0][0]} but has no row in book/claims.yml"


class LedgerPart(nodes.General, nodes.Element):
    """Stands where text goes that is known only after every notebook has run."""


def table(titles: list[str], rows: list[nodes.row], name: str) -> nodes.container:
    """Return a table that scrolls sideways where the screen is narrow."""
    group = nodes.tgroup(cols=len(titles))
    group += [nodes.colspec(colwidth=1) for _ in titles]
    head = cells(*(nodes.paragraph("", title) for title in titles))
    group += [nodes.thead("", head), nodes.tbody("", *rows)]
    return nodes.container("", nodes.table("", group), classes=["esfem-table", name])


def cells(*contents: nodes.Node, **attributes: Any) -> nodes.row:
    """Return a table row."""
    return nodes.row("", *(nodes.entry("", content) for content in contents), **attributes)


class LedgerDirective(SphinxDirective):
    """Common parts of the three directives."""

    def markdown(self, text: str) -> nodes.container:
        """Parse text of the source files."""
        node = nodes.container()
        self.state.nested_parse(StringList([text], source="book/claims.yml"), 0, node)
        return node

    def rows(self) -> list[dict[str, str]]:
        """Read the ledger, and note that this page depends on it."""
        root = Path(self.env.srcdir)
        self.env.note_dependency(str(root / "book/claims.yml"))
        return read_rows(root)


class LedgerSummary(LedgerDirective):
    """Count the claims by paper and verdict."""

    def run(self) -> list[nodes.Node]:
        """Leave a place for the table."""
        return [LedgerPart(kind="summary")]


class LedgerTable(LedgerDirective):
    """List the claims of one paper with measurement and verdict."""

    option_spec: ClassVar = {"source": directives.unchanged_required}

    def run(self) -> list[nodes.Node]:
        """Set what is known from the source; verdicts and measurements follow."""
        rows = [
            cells(
                nodes.container(
                    "",
                    nodes.paragraph("", "", nodes.literal("", row["id"])),
                    nodes.paragraph("", row["where"]),
                ),
                self.markdown(row["claim"]),
                LedgerPart(kind="check", claim=row["id"]),
                ids=[f"claim-{anchor(row['id'])}"],
            )
            for row in self.rows()
            if row["source"] == self.options["source"]
        ]
        return [table(["where", "claim, in our words", "check"], rows, "esfem-ledger")]


class ErrataTable(LedgerDirective):
    """List the slips that a check of the book tells apart."""

    def run(self) -> list[nodes.Node]:
        """Set the table; entries that no check bears out are removed when verdicts are known."""
        root = Path(self.env.srcdir)
        self.env.note_dependency(str(root / "book/errata.yml"))
        sources = {row["id"]: row["source"] for row in self.rows()}
        rows = []
        for entry in read_errata(root):
            if entry["claim"] not in sources:
                LOG.warning("book/errata.yml: there is no claim %s", entry["claim"])
                continue
            rows.append(
                cells(
                    nodes.paragraph("", f"{sources[entry['claim']]} {entry['where']}"),
                    self.markdown(entry["printed"]),
                    self.markdown(entry["corrected"]),
                    LedgerPart(kind="check", claim=entry["claim"]),
                    erratum=entry["claim"],
                )
            )
        return [table(["where", "printed", "should be", "check"], rows, "esfem-errata")]


def verdict(row: dict[str, str], found: Measured) -> str | None:
    """Return the verdict on a row, or None if it was not measured."""
    if row["kind"] == PROOF_ONLY:
        return PROOF_ONLY
    checks = found.get(row["id"])
    return checks[0][1].verdict if checks else None


def check_cell(row: dict[str, str], found: Measured, page: str) -> nodes.container:
    """Return the verdict on a row, the link to its check and what was measured there."""
    result = verdict(row, found)
    text = f"{SIGNS[result]} {result}" if result else "not measured"
    kind = (result or NOT_CONFIRMED).replace(" ", "-")
    badge = nodes.inline("", text, classes=["esfem-verdict", f"esfem-{kind}"])
    checks = found.get(row["id"])
    if not checks:
        return nodes.container(
            "", nodes.paragraph("", "", badge), nodes.paragraph("", row.get("reason", ""))
        )
    claim = checks[0][1]
    uri = f"{page}#check-{anchor(row['id'])}"
    link = nodes.reference("", "the check", internal=True, refuri=uri)

    def item(label: str, m: Measurement) -> nodes.list_item:
        line = f"{'✓' if m.holds else '✗'} {label}{m.name}: {m.value:.4g} ({m.expected})"
        return nodes.list_item("", nodes.paragraph("", line))

    items = [item("as printed: " if claim.corrected else "", m) for m in claim.as_printed]
    items += [item("corrected: ", m) for m in claim.corrected]
    cell = nodes.container("", nodes.paragraph("", "", badge, nodes.Text(" · "), link))
    cell += nodes.bullet_list("", *items)
    if claim.note:
        cell += nodes.paragraph("", claim.note)
    return cell


def summary(rows: dict[str, dict[str, str]], found: Measured) -> nodes.container:
    """Return the counts by paper and verdict."""
    counts = Counter((row["source"], verdict(row, found)) for row in rows.values())
    lines = [
        cells(*(nodes.paragraph("", str(c)) for c in (paper, *(counts[paper, v] for v in SIGNS))))
        for paper in PAPERS
        if any(row["source"] == paper for row in rows.values())
    ]
    titles = ["paper", *(f"{sign} {v}" for v, sign in SIGNS.items())]
    return table(titles, lines, "esfem-summary")


def state(app: Sphinx) -> tuple[dict[str, dict[str, str]], Measured]:
    """Return the rows by id, and what the notebooks of this build measured."""
    return {row["id"]: row for row in read_rows(Path(app.srcdir))}, measurements(app)


def fill(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Put verdicts and measurements where the directives left places for them."""
    parts = list(doctree.findall(LedgerPart))
    if not parts:
        return
    rows, found = state(app)
    for line in [line for line in doctree.findall(nodes.row) if "erratum" in line]:
        if verdict(rows[line["erratum"]], found) not in (CORRECTED, NOT_CONFIRMED):
            LOG.warning("book/errata.yml: the check of %s does not fail", line["erratum"])
            line.parent.remove(line)
    for part in parts:
        if part["kind"] == "summary":
            part.replace_self(summary(rows, found))
        else:
            row = rows[part["claim"]]
            page = app.builder.get_relative_uri(docname, row["chapter"])
            part.replace_self(check_cell(row, found, page))


def check(app: Sphinx, env: object) -> None:
    """Warn of every disagreement between the ledger and the notebooks."""
    rows = read_rows(Path(app.srcdir))
    for problem in problems(rows, measurements(app), app.env.found_docs):
        LOG.warning("ledger: %s", problem)


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directives."""
    app.add_node(LedgerPart)
    app.add_directive("ledger-summary", LedgerSummary)
    app.add_directive("ledger-table", LedgerTable)
    app.add_directive("errata-table", ErrataTable)
    app.connect("doctree-read", collect)
    app.connect("env-check-consistency", check)
    app.connect("doctree-resolved", fill)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
