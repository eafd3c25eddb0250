"""The ledger shows what the chapters measured, and verdicts that follow from it."""

import json
import os
import re
from collections import Counter
from pathlib import Path

import pytest
import yaml
from conftest import HTML, ROOT, soup

from esfem_core.companion import campaign
from esfem_core.companion.claims import SIGNS, accepted, anchor, read_html
from esfem_core.companion.experiments import EXPERIMENTS

ROWS = yaml.safe_load((ROOT / "book/claims.yml").read_text("utf8"))
KNOWN = campaign.DATA / "verdicts.json"
ERRATA = yaml.safe_load((ROOT / "book/errata.yml").read_text("utf8"))


@pytest.fixture(scope="module")
def ledger():
    return soup("book/ledger.html")


@pytest.fixture(scope="module")
def measured():
    """Return the claims that the chapters show, by id, read from their measurements."""
    found = {}
    for path in sorted((HTML / "book").glob("*.html")):
        for claim in read_html(path.read_text("utf8")):
            found.setdefault(claim.id, []).append((f"book/{path.stem}", claim))
    return found


def expected(row, measured):
    return measured[row["id"]][0][1].verdict if row["kind"] == "check" else "proof only"


def test_every_check_ran_once_in_its_chapter(measured):
    ran = {name: [page for page, _ in claims] for name, claims in measured.items()}
    assert ran == {row["id"]: [row["chapter"]] for row in ROWS if row["kind"] == "check"}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["id"])
def test_row(row, ledger, measured):
    line = ledger.find(id=f"claim-{anchor(row['id'])}")
    assert line is not None
    verdict = expected(row, measured)
    assert line.select_one(".esfem-verdict").text.split(maxsplit=1)[1] == verdict
    if row["kind"] == "proof only":
        assert row["reason"].split()[0] in line.text
        return
    assert line.find_all("td")[2].text.split()[0] == row["evidence"]
    for name in row.get("runs", []):
        assert name in line.text
    claim = measured[row["id"]][0][1]
    for m in (*claim.as_printed, *claim.corrected):
        assert f"{m.name}: {m.value:.4g} ({m.expected})" in line.text
    (link,) = line.select(f"a[href$='#check-{anchor(row['id'])}']")
    page = Path("book") / link["href"].split("#")[0]
    assert page == Path(f"{row['chapter']}.html")
    box = soup(page).find(id=f"check-{anchor(row['id'])}")
    assert box.select_one(".esfem-verdict").text.split(maxsplit=1)[1] == verdict
    assert box.select_one(f"a[href='ledger.html#claim-{anchor(row['id'])}']")


@pytest.mark.parametrize("holder", ["book/ledger.html", "book/intro.html"])
def test_summary_counts_the_verdicts(holder, measured):
    head, *lines = soup(holder).select(".esfem-summary tr")
    verdicts = [cell.text.strip().split(maxsplit=1)[1] for cell in head.find_all("th")[1:]]
    counts = Counter((row["source"], expected(row, measured)) for row in ROWS)
    shown = {}
    for line in lines:
        paper, *numbers = (cell.text.strip() for cell in line.find_all("td"))
        shown |= {(paper, v): int(n) for v, n in zip(verdicts, numbers, strict=True) if n != "0"}
    assert shown == dict(counts)


def test_what_fails_comes_first(ledger, measured):
    (first, *papers) = ledger.select(".esfem-ledger tbody")
    names = [line.code.text for line in first.find_all("tr")]
    worst = list(SIGNS)[:2]
    assert names == [row["id"] for row in ROWS if expected(row, measured) in worst]
    assert sum(len(part.find_all("tr")) for part in papers) == len(ROWS)


def test_the_page_counts_the_rows_that_this_code_has_made(ledger):
    lines = ledger.select(".esfem-runs tbody tr")
    shown = {line.code.text: line.find_all("td")[2].text.strip() for line in lines}
    for experiment in EXPERIMENTS:
        rows = campaign.stored(experiment.name)
        current = sum(campaign.is_current(experiment, row) for row in rows)
        assert shown.pop(experiment.name) == f"{current} of {len(rows)}"
    assert shown == {}
    links = [link["href"].split("#claim-")[1] for link in ledger.select(".esfem-runs a")]
    assert set(links) == {anchor(row["id"]) for row in ROWS if row.get("runs")}


def test_the_front_page_adds_these_rows_up(ledger):
    """With "All 800" for "800 of the 800"."""
    shown = re.search(r"(All|\d+ of the) (\d+) stored results", soup("book/intro.html").text)
    lines = [
        line.find_all("td")[2].text.split(" of ") for line in ledger.select(".esfem-runs tr")[1:]
    ]
    current, count = (sum(int(line[i]) for line in lines) for i in (0, 1))
    assert shown.group(1) == ("All" if current == count else f"{current} of the")
    assert shown.group(2) == str(count)


def test_errata_are_checks_that_fail_as_printed(measured):
    lines = soup("book/errata.html").select(".esfem-errata tbody tr")
    assert len(lines) == len(ERRATA)
    for entry, line in zip(ERRATA, lines, strict=True):
        claim = measured[entry["claim"]][0][1]
        assert claim.kind is not None
        assert line.select_one(".esfem-verdict").text.split(maxsplit=1)[1] == claim.verdict


def test_no_verdict_changed_unnoticed(measured):
    """A verdict that changes is a finding or a fault: look, then run with ACCEPT_VERDICTS=1."""
    now = {row["id"]: expected(row, measured) for row in ROWS}
    if os.environ.get("ACCEPT_VERDICTS"):
        KNOWN.write_text(json.dumps(now, indent=1) + "\n", "utf8")
        accepted.cache_clear()
    assert now == accepted()
