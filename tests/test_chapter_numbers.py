"""The chapters have numbers, those of their files, and whoever names a number links there."""

import json
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
TOC = yaml.safe_load((ROOT / "_toc.yml").read_text("utf8"))
PAGES = sorted([*(ROOT / "book").glob("*.ipynb"), *(ROOT / "book").glob("*.md")])
CODE = re.compile(r"```.*?```|`[^`\n]*`|\$\$.*?\$\$|\$[^$]*\$", re.S)


def text(path):
    if path.suffix == ".md":
        whole = path.read_text("utf8")
    else:
        cells = json.loads(path.read_text("utf8"))["cells"]
        whole = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return CODE.sub("", whole)


def test_chapters_are_numbered_in_the_order_of_their_files():
    numbered = [c["file"] for p in TOC["parts"] if "numbered" in p for c in p["chapters"]]
    assert [int(Path(file).name[:2]) for file in numbered] == list(range(1, len(numbered) + 1))
    assert len(numbered) == len(list((ROOT / "book").glob("[0-9][0-9]_*.ipynb")))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_the_number_of_a_chapter_leads_to_it(path):
    shown = text(path)
    assert re.findall(r"\bchapters?\s+\d+", re.sub(r"\[[^\]]*\]", "", shown), re.I) == []
    for label, file in re.findall(r"\[((?:[Cc]hapter\s+)?\d+)\]\((\w+)\.ipynb\)", shown):
        assert int(label.split()[-1]) == int(file[:2])
