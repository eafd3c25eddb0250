"""Every numbered place of both papers is in the concordance, and what it points to exists."""

import re
from collections import Counter
from pathlib import Path
from pydoc import locate

import pytest
import yaml

ROOT = Path(__file__).parents[2]
ENTRIES = yaml.safe_load((ROOT / "book/concordance.yml").read_text("utf8"))
ROWS = yaml.safe_load((ROOT / "book/claims.yml").read_text("utf8"))
ALL = [entry for entries in ENTRIES.values() for entry in entries]
CHAPTERS = {path.stem: path.read_text("utf8") for path in (ROOT / "book").glob("*.ipynb")}


def numbered(counts):
    return [f"({section}.{n})" for section, last in counts.items() for n in range(1, last + 1)]


EXPECTED = {
    "[N]": [
        *numbered({2: 27, 3: 7, 4: 37, 5: 7, 6: 24, 7: 2}),
        *("Theorem 2.1", "Proposition 1"),
        *(
            f"Lemma {n}"
            for n in ["3.1", "3.2", "3.3", "3.4", "4.1", "4.2", "5.1", "5.2", "5.3", "5.4", "6.1"]
        ),
        *(f"Remark {n}" for n in range(1, 5)),
        *(f"Figure {n}" for n in range(1, 6)),
    ],
    "[LMV]": [
        *numbered({1: 2, 2: 12, 3: 5, 4: 1, 5: 13, 6: 2}),
        *(f"Lemma {n}" for n in ["2.1", "2.2", "3.1", "3.2", "4.1", "5.1"]),
        *("Theorem 5.1", "Theorem 5.2", "Remark (1)", "Remark (2)"),
        *(f"Figure {n}" for n in range(1, 5)),
    ],
}


@pytest.mark.parametrize("paper", EXPECTED)
def test_every_number_of_a_paper_has_one_entry(paper):
    items = Counter(entry["item"] for entry in ENTRIES[paper])
    assert max(items.values()) == 1
    assert [item for item in EXPECTED[paper] if item not in items] == []
    others = [item for item in items if item not in EXPECTED[paper]]
    assert [item for item in others if not re.fullmatch(r"Section \d+(\.\d+)*", item)] == []


def test_every_claim_of_the_ledger_is_in_it_and_no_other():
    claims = {claim for entry in ALL for claim in entry.get("claims", [])}
    assert claims == {row["id"] for row in ROWS}


def test_the_chapters_and_the_equations_exist():
    labels = {label for text in CHAPTERS.values() for label in re.findall(r"\((eq-[\w-]+)\)", text)}
    for entry in ALL:
        assert entry["chapter"].removeprefix("book/") in CHAPTERS, entry
        assert set(entry.get("equations", [])) <= labels, entry


def test_the_code_exists():
    for name in {name for entry in ALL for name in entry.get("code", [])}:
        assert locate(f"esfem_core.{name}") is not None, name


def test_an_entry_says_no_more_than_it_should():
    keys = {"item", "says", "chapter", "equations", "claims", "code", "terms"}
    for entry in ALL:
        assert set(entry) <= keys, entry
        assert entry["says"].strip(), entry
