"""Cells that a reader wants to copy: short, changeable, and never ended by a bare assert."""

import ast
import json
import re
from pathlib import Path
from statistics import median

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "book").glob("*.ipynb"))
CHAPTERS = [path for path in NOTEBOOKS if re.match(r"\d\d_", path.name)]
FOLDED = {"hide-input", "hide-cell", "remove-input", "remove-cell"}
LONGEST, MEDIAN, MEDIAN_OF_ALL = 40, 15, 12  # lines


def code(path):
    cells = json.loads(path.read_text("utf8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def tags(cell):
    return set(cell["metadata"].get("tags", []))


def lengths(path):
    """Lines of the cells whose source a reader sees."""
    visible = [cell for cell in code(path) if not tags(cell) & FOLDED]
    return {cell["id"]: len("".join(cell["source"]).splitlines()) for cell in visible}


def named(paths):
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.stem)


@named(NOTEBOOKS)
def test_no_visible_cell_has_more_than_forty_lines(path):
    assert {name: n for name, n in lengths(path).items() if n > LONGEST} == {}


@named(NOTEBOOKS)
def test_half_of_the_visible_cells_have_at_most_fifteen_lines(path):
    assert median(lengths(path).values()) <= MEDIAN


def test_half_of_all_visible_cells_have_at_most_twelve_lines():
    assert median(n for path in NOTEBOOKS for n in lengths(path).values()) <= MEDIAN_OF_ALL


@named(NOTEBOOKS)
def test_no_bare_assert_ends_a_reader_s_run(path):
    bare = [
        cell["id"]
        for cell in code(path)
        if any(
            isinstance(node, ast.Assert) for node in ast.walk(ast.parse("".join(cell["source"])))
        )
    ]
    assert bare == []


@named(CHAPTERS)
def test_a_chapter_has_a_cell_of_parameters_after_its_imports(path):
    cells = code(path)
    tagged = [i for i, cell in enumerate(cells) if "parameters" in tags(cell)]
    assert len(tagged) == 1
    assert tagged[0] <= 3
    body = ast.parse("".join(cells[tagged[0]]["source"])).body
    assert all(isinstance(node, ast.Assign) for node in body)
    set_here = [
        n.id
        for node in body
        for target in node.targets
        for n in ast.walk(target)
        if isinstance(n, ast.Name)
    ]
    assert set_here
    assert all(name.isupper() or len(name) == 1 for name in set_here)  # r is a formula's letter


@named(CHAPTERS)
def test_every_exercise_has_a_solution_and_one_asks_for_a_prediction(path):
    cells = json.loads(path.read_text("utf8"))["cells"]
    text = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    boxes = re.findall(r"\{admonition\} (Exercise|Solution)(.*?)\n:::", text, re.S)
    assert [kind for kind, _ in boxes] == ["Exercise", "Solution"] * (len(boxes) // 2)
    assert any(re.search("predict|before you run", body, re.I) for _, body in boxes[::2])
