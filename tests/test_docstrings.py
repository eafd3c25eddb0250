"""Docstrings of public names are markup of the book: |A| outside of literals would be looked up."""

import ast
import re
from pathlib import Path

import pytest

import esfem_core

MODULES = sorted(Path(esfem_core.__file__).parent.rglob("*.py"))
BARS = re.compile(r"(?<![\w|])\|(?=\S)[^|\n]*(?<=\S)\|(?![\w|])")
LEFT_ALONE = re.compile(
    r"``.*?``|:\w+:`.*?`|\.\. math::.*?(?=\n\S|\Z)|^Examples\n-+\n.*", re.S | re.M
)


def bars(docstring):
    return BARS.findall(LEFT_ALONE.sub("", docstring))


def test_bars_are_found_where_they_are_markup():
    assert bars("Relative to |A| |x|.") == ["|A|", "|x|"]
    assert bars("``|A|``, :math:`|x|`\n\n.. math:: |b|\n\nExamples\n--------\n>>> |c|") == []


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.stem)
def test_no_public_docstring_has_them(path):
    nodes = ast.walk(ast.parse(path.read_text("utf8")))
    public = [
        n for n in nodes if isinstance(n, ast.ClassDef | ast.FunctionDef) and n.name[0] != "_"
    ]
    assert [found for n in public for found in bars(ast.get_docstring(n) or "")] == []
