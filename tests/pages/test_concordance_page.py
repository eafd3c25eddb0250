"""The concordance leads somewhere, and the search finds the papers' numbers in it."""

import json

import pytest
import yaml
from conftest import HTML, ROOT, soup

ENTRIES = yaml.safe_load((ROOT / "book/concordance.yml").read_text("utf8"))


@pytest.fixture(scope="module")
def concordance():
    return soup("book/concordance.html")


def test_each_entry_links_to_its_chapter_and_to_its_claims(concordance):
    ledger = soup("book/ledger.html")
    rows = concordance.select(".esfem-concordance tbody tr")
    entries = [entry for paper in ENTRIES.values() for entry in paper]
    assert len(rows) == len(entries)
    for row, entry in zip(rows, entries, strict=True):
        links = [link["href"] for link in row.select("a")]
        assert f"{entry['chapter'].removeprefix('book/')}.html" in links, entry["item"]
        claims = [link for link in links if link.startswith("ledger.html#")]
        assert len(claims) == len(entry.get("claims", [])), entry["item"]
        assert all(ledger.find(id=link.split("#")[1]) for link in claims), entry["item"]


def test_the_search_finds_the_numbers_of_the_papers():
    text = (HTML / "searchindex.js").read_text("utf8")
    index = json.loads(text.removeprefix("Search.setIndex(").rstrip().removesuffix(")"))
    found, documents = index["indexentries"], index["docnames"]
    for paper in ENTRIES.values():
        for entry in paper:
            for term in (entry["item"], *entry.get("terms", [])):
                pages = {documents[place[0]] for place in found[term.lower()]}
                assert "book/concordance" in pages, term
