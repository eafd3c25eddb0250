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
        nodes = [n for cell in code for n in ast.walk(ast.parse("".join(cell["source"])))]
        stated = [n.test for n in nodes if isinstance(n, ast.Assert)]
        stated += [
            n.args[-1 if n.func.id == "claim" else 0]
            for n in nodes
            if isinstance(n, ast.Call) and getattr(n.func, "id", "") in ("claim", "expect")
        ]
        assert stated
        assert not any(isinstance(test, ast.Constant) for test in stated), "cannot fail"

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
