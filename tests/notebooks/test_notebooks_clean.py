"""Notebooks are committed without outputs, prove something, and name no machine."""

import ast
import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "book").glob("*.ipynb"))
ABSOLUTE = re.compile(
    r"""["'(](?:/(?:home|Users|root|tmp|work|mnt|var|usr)/|[A-Za-z]:\\|file://)"""
)


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
class TestNotebook:
    @pytest.fixture
    def notebook(self, path):
        return json.loads(path.read_text("utf8"))

    @pytest.fixture
    def code(self, notebook):
        return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]

    def test_has_no_outputs(self, code):
        assert [c["id"] for c in code if c["outputs"] or c["execution_count"] is not None] == []

    def test_states_something_that_can_fail(self, code):
        trees = [ast.parse("".join(c["source"])) for c in code]
        calls = [n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.Call)]
        stated = [n for n in calls if getattr(n.func, "id", "") in ("expect", "claim")]
        assert stated
        assert not any(isinstance(n.args[0], ast.Constant) for n in stated if n.func.id == "expect")

    def test_runs_on_the_kernel_that_everyone_has(self, notebook):
        assert notebook["metadata"]["kernelspec"]["name"] == "python3"
        assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)

    def test_begins_with_one_title(self, notebook):
        first, *rest = [c for c in notebook["cells"] if c["cell_type"] == "markdown"]
        assert notebook["cells"][0] is first
        assert "".join(first["source"]).startswith("# ")
        assert not any(re.search(r"^# ", "".join(c["source"]), re.M) for c in rest)

    def test_names_no_path_of_a_machine(self, notebook):
        for cell in notebook["cells"]:
            found = ABSOLUTE.search("".join(cell["source"]))
            assert found is None, found
