"""Sphinx extension: the claims ledger and the errata page.

The rows stand in ``book/claims.yml`` and ``book/errata.yml``; the measurements come from what the
notebooks show when they run; the verdicts are computed by `esfem_core.companion.claims`. A row
without a measurement, a measurement without a row and an erratum that no check bears out are
warnings, and so fail the build. Of the stored runs that verdicts rest on, the ledger says how many
the present code has made.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import yaml
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from esfem_core.companion import campaign
from esfem_core.companion.claims import (
    CONFIRMED,
    PROOF_ONLY,
    SIGNS,
    Claim,
    anchor,
    read_html,
)
from esfem_core.companion.experiments import EXPERIMENTS

LOG = logging.getLogger(__name__)
FAILED = tuple(v for v in SIGNS if v not in (CONFIRMED, PROOF_ONLY))
Row = dict[str, Any]
PAPERS = ("[N]", "[LMV]")
Measured = dict[str, list[tuple[str, Claim]]]  # by claim id: the page and what it measured


def read_rows(root: Path) -> list[Row]:
    """Return the rows of the ledger."""
    return [row.copy() for row in parsed((root / "book/claims.yml").read_text("utf8"))]


@cache
def parsed(text: str) -> list[Row]:
    """Return the rows of a text; a build asks for those of the ledger nine times."""
    return yaml.safe_load(text)


def read_errata(root: Path) -> list[Row]:
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


def problems(rows: list[Row], found: Measured, documents: set[str]) -> Iterator[str]:
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
    """Common parts of the directives."""

    def markdown(self, text: str) -> nodes.container:
        """Parse text of the source files."""
        node = nodes.container()
        self.state.nested_parse(StringList([text], source="book/claims.yml"), 0, node)
        return node

    def rows(self) -> list[Row]:
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
    """List the claims of one paper, or those with some verdicts, with measurement and verdict."""

    option_spec: ClassVar = {
        "source": directives.unchanged_required,
        "verdicts": directives.unchanged_required,
    }

    def run(self) -> list[nodes.Node]:
        """Set what is known from the source; verdicts and measurements follow."""
        chosen = self.options.get("verdicts")
        rows = [
            self.line(row, chosen)
            for row in self.rows()
            if self.options.get("source") in (None, row["source"])
        ]
        titles = ["where", "claim, in our words", "evidence, range", "check"]
        return [table(titles, rows, "esfem-ledger")]

    def line(self, row: Row, chosen: str | None) -> nodes.row:
        """Return the line of a row; only that in the list of its paper can be linked to."""
        name = row["id"]
        place = nodes.paragraph("", f"{row['source']} " if chosen else "")
        place += nodes.Text(row["where"])
        cell = nodes.container("", nodes.paragraph("", "", nodes.literal("", name)), place)
        scope = nodes.container("", nodes.paragraph("", row.get("evidence", "")))
        if "range" in row:
            scope += self.markdown(row["range"])
        attributes = {"verdicts": chosen} if chosen else {"ids": [f"claim-{anchor(name)}"]}
        check = LedgerPart(kind="check", claim=name)
        # For the filters of the page: chapter, and kind of evidence.
        classes = [f"in-{Path(row['chapter']).name}", f"kind-{row.get('evidence', 'none')}"]
        return cells(
            cell,
            self.markdown(row["claim"]),
            scope,
            check,
            ledger=name,
            classes=classes,
            **attributes,
        )


class LedgerRuns(LedgerDirective):
    """List the stored runs, how many of them the present code has made, and who rests on them."""

    def run(self) -> list[nodes.Node]:
        """Set the table."""
        rows = self.rows()
        lines = []
        for experiment in EXPERIMENTS:
            stored, current = stored_rows(experiment)
            dates = sorted(str(row.provenance["date"]) for row in stored)
            resting = nodes.paragraph()
            for row in rows:
                if experiment.name in row.get("runs", []):
                    if resting.children:
                        resting += nodes.Text(", ")
                    uri = f"#claim-{anchor(row['id'])}"
                    resting += nodes.reference("", row["id"], internal=True, refuri=uri)
            if not resting.children:
                resting += nodes.Text("none")
            texts = [experiment.title, f"{current} of {len(stored)}", dates[-1] if dates else ""]
            name = nodes.paragraph("", "", nodes.literal("", experiment.name))
            lines.append(cells(name, *(nodes.paragraph("", text) for text in texts), resting))
        titles = ["stored runs", "of", "by this code", "last", "verdicts that rest on them"]
        return [table(titles, lines, "esfem-runs")]


class StoredCount(LedgerDirective):
    """Say how many of the stored results the present code has made, and in what time."""

    def run(self) -> list[nodes.Node]:
        """Set the sentence."""
        count = current = 0
        seconds = 0.0
        for experiment in EXPERIMENTS:
            stored, by_this_code = stored_rows(experiment)
            count, current = count + len(stored), current + by_this_code
            seconds += sum(row.provenance["seconds"] for row in stored)
        which = f"All {count}" if current == count else f"{current} of the {count}"
        made = f"{which} stored results were made by the code of this book, "
        return [nodes.paragraph("", f"{made}all together in {seconds / 3600:.1f} processor hours.")]


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


def stored_rows(experiment: campaign.Experiment) -> tuple[list[campaign.Row], int]:
    """Return the stored results of an experiment, and how many the present code has made."""
    stored = campaign.read(campaign.DATA / f"{experiment.name}.jsonl")
    return stored, sum(campaign.is_current(experiment, row) for row in stored)


def verdict(row: Row, found: Measured) -> str | None:
    """Return the verdict on a row, or None if it was not measured."""
    if row["kind"] == PROOF_ONLY:
        return PROOF_ONLY
    checks = found.get(row["id"])
    return checks[0][1].verdict if checks else None


def check_cell(row: Row, found: Measured, page: str) -> nodes.container:
    """Return the verdict on a row, the link to its check and what was measured there."""
    result = verdict(row, found)
    text = f"{SIGNS[result]} {result}" if result else "not measured"
    kind = (result or "not measured").replace(" ", "-")
    badge = nodes.inline("", text, classes=["esfem-verdict", f"esfem-{kind}"])
    checks = found.get(row["id"])
    if not checks:
        return nodes.container(
            "", nodes.paragraph("", "", badge), nodes.paragraph("", row.get("reason", ""))
        )
    claim = checks[0][1]
    uri = f"{page}#check-{anchor(row['id'])}"
    link = nodes.reference("", "the check", internal=True, refuri=uri)
    cell = nodes.container("", nodes.paragraph("", "", badge, nodes.Text(" · "), link))
    items = []
    for form, m in claim.lines():
        label = f"{form}: " if claim.corrected else ""
        line = f"{'✓' if m.holds else '✗'} {label}{m.name}: {m.value:.4g} ({m.expected})"
        items.append(nodes.list_item("", nodes.paragraph("", line)))
    cell += nodes.bullet_list("", *items)
    if claim.note:
        cell += nodes.paragraph("", claim.note)
    if row.get("runs"):
        cell += nodes.paragraph("", f"From stored runs: {', '.join(row['runs'])}.")
    return cell


def summary(rows: dict[str, Row], found: Measured) -> nodes.container:
    """Return the counts by paper and verdict."""
    counts = Counter((row["source"], verdict(row, found)) for row in rows.values())
    lines = [
        cells(*(nodes.paragraph("", str(c)) for c in (paper, *(counts[paper, v] for v in SIGNS))))
        for paper in PAPERS
        if any(row["source"] == paper for row in rows.values())
    ]
    titles = ["paper", *(f"{sign} {v}" for v, sign in SIGNS.items())]
    return table(titles, lines, "esfem-summary")


def state(app: Sphinx) -> tuple[dict[str, Row], Measured]:
    """Return the rows by id, and what the notebooks of this build measured."""
    return {row["id"]: row for row in read_rows(Path(app.srcdir))}, measurements(app)


def fill(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Put verdicts and measurements where the directives left places for them."""
    parts = list(doctree.findall(LedgerPart))
    if not parts:
        return
    rows, found = state(app)
    for line in list(doctree.findall(nodes.row)):
        if "erratum" in line and verdict(rows[line["erratum"]], found) not in FAILED:
            LOG.warning("book/errata.yml: the check of %s does not fail", line["erratum"])
            line.parent.remove(line)
        chosen = line.get("verdicts")
        if chosen and verdict(rows[line["ledger"]], found) not in chosen.split(", "):
            line.parent.remove(line)
    parts = list(doctree.findall(LedgerPart))
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
    app.add_directive("stored-count", StoredCount)
    app.add_directive("ledger-table", LedgerTable)
    app.add_directive("ledger-runs", LedgerRuns)
    app.add_directive("errata-table", ErrataTable)
    app.connect("doctree-read", collect)
    app.connect("env-check-consistency", check)
    app.connect("doctree-resolved", fill)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
