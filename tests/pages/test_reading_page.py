"""The page that leads through the code shows what the sources say."""

import re

import pytest
from bs4 import BeautifulSoup
from conftest import HTML, soup


@pytest.fixture(scope="module")
def reading():
    return soup("book/reading_the_code.html")


def cells(row):
    return [cell.get_text(" ", strip=True) for cell in row.select("th, td")]


def test_lines_add_up(reading):
    (path,) = [t for t in reading.select(".esfem-house table") if "read it for" in t.text]
    *rows, last = [cells(row) for row in path.select("tbody tr")]
    for column in (-2, -1):
        assert sum(int(row[column]) for row in rows) == int(last[column].replace(",", ""))


def test_no_room_imports_from_a_later_one(reading):
    rows = [cells(row)[1:] for row in reading.select(".esfem-imports tbody tr")]
    assert {mark for row in rows for mark in row} == {"", "●", "■"}
    for i, row in enumerate(rows):
        assert row[i] == "■"
        assert set(row[i + 1 :]) <= {""}


@pytest.mark.parametrize("number", ["2.18", "2.19", "2.20", "2.21", "2.22"])
def test_an_equation_leads_to_the_line_that_names_it(reading, number):
    rows = [row for row in reading.select(".esfem-house tr") if cells(row)[0] == f"({number})"]
    links = [link["href"] for row in rows for link in row.select("li > p > a:first-child")]
    assert any("#" in link for link in links)
    for link in links:
        file, _, anchor = link.partition("#")
        listing = (HTML / "book" / file).resolve().read_text("utf8")
        text = listing[listing.index(f'id="{anchor}"') :] if anchor else listing
        shown = BeautifulSoup(text, "html.parser").get_text()
        low, high = re.escape(f"({number})"), r"\(2\.19\)-\(2\.21\)"
        assert re.search(rf"{low}|{high}", shown), link


def test_a_chapter_leads_to_the_functions_that_it_uses_and_they_lead_back():
    chapter = soup("book/05_g_stability.html")
    name = "esfem_core.theory.multipliers.smallest_eta"
    links = [a["href"] for a in chapter.select(".esfem-from-the-package a")]
    assert f"api/theory.html#{name}" in links
    room = soup("book/api/theory.html")
    back = [a["href"] for a in room.find(id=name).find_next("dd").select("a")]
    assert "../05_g_stability.html" in back


def test_names_that_share_a_line_of_a_docstring_stay_names():
    room = soup("book/api/theory.html")
    errors = room.find(id="esfem_core.theory.geometry.GeometricErrors").find_next("dd")
    assert {"distance, normal", "m, a, q"} <= {name.text for name in errors.select("li strong")}
