"""Sphinx extension: from a function to the chapters whose cells use it, and back.

The cells are read, not run. A chapter ends with links to what it takes from the package; the
documentation of a function or class names the chapters.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import sources
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

BOOK = Path(__file__).parents[1]
# The book's own machinery, not what a chapter is about.
MACHINERY = tuple(
    f"{sources.PACKAGE}.{room}" for room in ("companion", "tables", "output.plotting")
)


@cache
def chapters() -> dict[int, Path]:
    """Return the notebooks that are chapters, by number."""
    return {int(p.name[:2]): p for p in sorted(BOOK.glob("[0-9][0-9]_*.ipynb"))}


def cells(notebook: Path) -> Iterator[ast.Module]:
    """Yield the code cells, parsed."""
    for cell in json.loads(notebook.read_text("utf8"))["cells"]:
        if cell["cell_type"] == "code":
            lines = "".join(cell["source"]).splitlines()
            yield ast.parse(
                "\n".join("" if line.startswith(("%", "!")) else line for line in lines)
            )


def dotted(node: ast.expr) -> str:
    """Return ``a.b.c`` for such an expression, else nothing."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (before := dotted(node.value)):
        return f"{before}.{node.attr}"
    return ""


@cache
def used(notebook: Path) -> list[str]:
    """Return what the cells take from the package, where it is defined, in order of use."""
    names: dict[str, str] = {}  # of the notebook, and what they stand for
    found: dict[str, None] = {}
    for cell in cells(notebook):
        for node in ast.walk(cell):
            if isinstance(node, ast.Import):
                names |= {a.asname or a.name: a.name for a in node.names}
            if isinstance(node, ast.ImportFrom):
                names |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
        for node in ast.walk(cell):
            if isinstance(node, ast.Name | ast.Attribute):
                first, _, rest = dotted(node).partition(".")
                module, inside = sources.split(
                    sources.home(f"{names.get(first, '')}.{rest}".strip("."))
                )
                name = inside.partition(".")[0]
                if module and name in dict(sources.definitions(module)):
                    found[f"{module}.{name}"] = None
    return [name for name in found if not name.startswith(MACHINERY)]


def name_chapters(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Add the chapters to a docstring."""
    numbers = [n for n, notebook in chapters().items() if name in used(notebook)]
    if numbers:
        links = (f":doc:`{n} </book/{chapters()[n].stem}>`" for n in numbers)
        lines += ["", f"In the cells of chapter {', '.join(links)}.", ""]


def list_names(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """End a chapter with links to what its cells use."""
    number = {f"book/{p.stem}": n for n, p in chapters().items()}.get(docname)
    objects = app.env.domains["py"].objects
    known = [n for n in used(chapters()[number]) if n in objects] if number else []
    if not known:
        return
    line = nodes.paragraph()
    for name in known:
        entry, shown = objects[name], nodes.literal("", name.rpartition(".")[2])
        if line.children:
            line += nodes.Text(" · ")
        line += make_refnode(app.builder, docname, entry.docname, entry.node_id, [shown], name)
    last = next(iter(doctree.findall(nodes.section)))
    last += nodes.container(
        "", nodes.rubric("", "From the package"), line, classes=["esfem-from-the-package"]
    )


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("autodoc-process-docstring", name_chapters, priority=900)  # after napoleon
    app.connect("doctree-resolved", list_names)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
