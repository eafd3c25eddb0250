"""The ledger's source, the notebooks' checks and the table of contents agree."""

import ast
import importlib.util
import json
import re
from collections import Counter
from pathlib import Path

import pytest
import yaml

from esfem_core.companion.claims import accepted
from esfem_core.companion.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[2]
ROWS = yaml.safe_load((ROOT / "book/claims.yml").read_text("utf8"))
ERRATA = yaml.safe_load((ROOT / "book/errata.yml").read_text("utf8"))
NOTEBOOKS = sorted((ROOT / "book").glob("*.ipynb"))
PAPERS = ["[N]", "[LMV]"]


def pages():
    """Return the pages of the table of contents."""
    toc = yaml.safe_load((ROOT / "_toc.yml").read_text("utf8"))
    chapters = [chapter["file"] for part in toc["parts"] for chapter in part["chapters"]]
    return [toc["root"], *chapters]


def claimed(notebook):
    """Return the ids of the calls claim("<id>", ...) in a notebook."""
    ids = []
    for cell in json.loads(notebook.read_text("utf8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        for node in ast.walk(ast.parse("".join(cell["source"]))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if name == "claim":
                    assert node.args, f"{notebook.name}: the id is the first argument of claim"
                    assert isinstance(node.args[0], ast.Constant), (
                        f"{notebook.name}: the id of a claim is written out"
                    )
                    ids.append(node.args[0].value)
    return ids


def test_rows_are_complete():
    for row in ROWS:
        fields = {"id", "source", "where", "claim", "chapter", "kind"}
        assert row["kind"] in ("check", "proof only"), row["id"]
        fields |= {"reason"} if row["kind"] == "proof only" else {"evidence", "range"}
        assert set(row) - {"runs"} == fields, row["id"]
        assert all(isinstance(row[key], str) and row[key].strip() for key in fields), row["id"]
        assert row.get("evidence") in (None, "exact", "order", "bound", "count", "time"), row["id"]
        assert row["source"] in PAPERS, row["id"]
        assert row["id"].startswith(row["source"].strip("[]") + "-"), row["id"]


def test_rows_name_the_stored_runs_that_they_rest_on():
    names = [experiment.name for experiment in EXPERIMENTS]
    for row in ROWS:
        for name in row.get("runs", []):
            assert name in names, row["id"]
            sources = (ROOT / f"{row['chapter']}.ipynb").read_text("utf8").replace("\\", "")
            by_number = re.sub(r"\d$", "{number}", name)  # asked for by the number of a figure
            assert f'"{name}"' in sources or f'"{by_number}"' in sources, row["id"]


def test_the_book_has_a_verdict_on_every_row_and_on_no_other():
    assert list(accepted()) == [row["id"] for row in ROWS]
    for row in ROWS:
        assert (accepted()[row["id"]] == "proof only") == (row["kind"] == "proof only"), row["id"]


def test_ids_are_unique():
    assert [name for name, n in Counter(row["id"] for row in ROWS).items() if n > 1] == []


def test_rows_follow_the_papers():
    def place(row):
        section = re.match(r"Section (\d+(?:\.\d+)*)\b", row["where"])
        assert section, f"{row['id']}: `where` begins with the section"
        return PAPERS.index(row["source"]), [int(n) for n in section[1].split(".")]

    places = [place(row) for row in ROWS]
    assert places == sorted(places)


def test_every_check_stands_once_in_its_chapter_and_no_other_check_exists():
    rows = {(row["chapter"], row["id"]): 1 for row in ROWS if row["kind"] == "check"}
    calls = Counter((f"book/{nb.stem}", name) for nb in NOTEBOOKS for name in claimed(nb))
    assert calls == rows


@pytest.mark.parametrize("chapter", sorted({row["chapter"] for row in ROWS}))
def test_every_chapter_is_in_the_book(chapter):
    assert (ROOT / f"{chapter}.ipynb").exists()
    assert chapter in pages()


def test_every_page_of_the_contents_exists():
    for page in pages():
        assert any((ROOT / f"{page}{suffix}").exists() for suffix in (".ipynb", ".md")), page


def test_errata_refer_to_checks():
    checks = {row["id"] for row in ROWS if row["kind"] == "check"}
    for entry in ERRATA:
        assert set(entry) == {"where", "printed", "corrected", "claim"}, entry
        assert entry["claim"] in checks, entry
        assert accepted()[entry["claim"]] != "confirmed", entry


def test_every_misprint_is_among_the_errata():
    misprints = {name for name, verdict in accepted().items() if verdict == "misprint"}
    assert misprints <= {entry["claim"] for entry in ERRATA}


def test_a_build_parses_the_ledger_once_and_sees_what_has_changed(tmp_path, monkeypatch):
    pytest.importorskip("sphinx")
    spec = importlib.util.spec_from_file_location("ledger", ROOT / "book/_ext/ledger.py")
    ledger = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(ledger)
    texts = []
    monkeypatch.setattr(yaml, "safe_load", lambda text: texts.append(text) or [{"id": text}])
    file = tmp_path / "book/claims.yml"
    file.parent.mkdir()
    for text in ("old", "new"):
        file.write_text(text)
        ledger.read_rows(tmp_path)[0]["id"] = "changed by a caller"
        assert ledger.read_rows(tmp_path) == [{"id": text}]
    assert texts == ["old", "new"]
