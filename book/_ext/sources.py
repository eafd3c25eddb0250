"""What the sources of the package say of themselves, read without importing them.

Modules are named by their dotted path, ``esfem_core.stepping.scheme``; what stands in a module by
its name there, ``SurfaceSpace.load``.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

PACKAGE = "esfem_core"
ROOT = Path(__file__).parents[2] / PACKAGE
Definition = ast.FunctionDef | ast.ClassDef


def path_of(module: str) -> Path:
    """Return the file of a module; it need not exist."""
    base = ROOT.joinpath(*module.split(".")[1:])
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def modules(room: str) -> list[str]:
    """Return a room and what is in it, by path; ``esfem_core.errors`` is a room of one module."""
    if not path_of(room).name.startswith("__init__"):
        return [room]
    inside = path_of(room).parent.rglob("*.py")
    names = [".".join(p.relative_to(ROOT.parent).with_suffix("").parts) for p in inside]
    return sorted(n.removesuffix(".__init__") for n in names if not n.endswith(".__main__"))


@cache
def source(module: str) -> str:
    """Return the text of a module."""
    return path_of(module).read_text("utf8")


@cache
def tree(module: str) -> ast.Module:
    """Return the syntax tree of a module."""
    return ast.parse(source(module))


@cache
def imports(module: str) -> tuple[tuple[str, str, str], ...]:
    """Return what a module imports from the package: name here, module there, name there."""
    return tuple(
        (a.asname or a.name, node.module or "", a.name)
        for node in ast.walk(tree(module))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE
        for a in node.names
    )


def definitions(module: str) -> Iterator[tuple[str, Definition]]:
    """Yield functions, classes and methods with their names in the module."""

    def inside(node: ast.Module | Definition, prefix: str) -> Iterator[tuple[str, Definition]]:
        for child in node.body:
            if isinstance(child, Definition):
                yield prefix + child.name, child
                yield from inside(child, f"{prefix}{child.name}.")

    return inside(tree(module), "")


def split(name: str) -> tuple[str, str]:
    """Split a name into the module and what is in it; one of them may be empty."""
    parts = name.split(".")
    for i in range(len(parts), 0, -1):
        module = ".".join(parts[:i])
        if parts[0] == PACKAGE and path_of(module).exists():
            return module, ".".join(parts[i:])
    return "", name


def home(name: str) -> str:
    """Follow a name through the modules that hand it on to where it is defined.

    ``esfem_core.SurfaceSpace.load`` becomes ``esfem_core.elements.space.SurfaceSpace.load``. A
    function that a room hands out and whose module has its name, as ``repair``, goes before it.
    """
    module, inside = split(name)
    room, _, last = module.rpartition(".")
    if room and not inside and (last, module, last) in imports(room):
        return f"{module}.{last}"
    if module and inside:
        first, *rest = inside.split(".")
        for here, origin, there in imports(module):
            if here == first:
                return home(".".join([origin, there, *rest]))
    return name


def handed_out(module: str) -> list[str]:
    """Return the names in ``__all__``."""
    for node in tree(module).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def first_line(name: str) -> str:
    """Return the first line of the docstring of a module or of something in it."""
    module, inside = split(name)
    found: dict[str, str | None] = {"": ast.get_docstring(tree(module))}
    found |= {here: ast.get_docstring(node) for here, node in definitions(module)}
    # A string under an assignment describes the name.
    for node, after in pairwise(tree(module).body):
        match node, after:
            case (
                ast.Assign(targets=[ast.Name(target)]) | ast.AnnAssign(target=ast.Name(target)),
                ast.Expr(ast.Constant(str(text))),
            ):
                found[target] = text
    return (found.get(inside) or "").split("\n")[0]


class Lines(NamedTuple):
    """Lines of some modules: all, and those of them that hold code."""

    all: int
    code: int

    def __add__(self, other: Lines) -> Lines:  # type: ignore[override]
        """Add line by line."""
        return Lines(self.all + other.all, self.code + other.code)


def lines(module: str) -> Lines:
    """Count the lines of a module; blank lines, comments and docstrings are no code."""
    silent = {
        *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
        *(tokenize.ENCODING, tokenize.ENDMARKER),
    }
    text = source(module)
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in silent:
            code |= set(range(token.start[0], token.end[0] + 1))
    for node in (tree(module), *(node for _, node in definitions(module))):
        if ast.get_docstring(node) is not None:
            code -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return Lines(len(text.splitlines()), len(code))


class Place(NamedTuple):
    """A place in a paper: [N] (2.19), [LMV] Lemma 3.1."""

    paper: str
    kind: str
    number: tuple[int, ...]

    def __str__(self) -> str:
        number = ".".join(map(str, self.number))
        return f"{self.paper} {self.kind} {number}" if self.kind else f"{self.paper} ({number})"


KINDS = ("", "Theorem", "Proposition", "Lemma", "Remark", "Example", "Figure", "Section")
WORDS = "|".join(kind for kind in KINDS if kind)
PLACE = rf"\((?P<eq>\d+\.\d+)\)|(?:(?P<kind>{WORDS})s?\s+)?(?P<number>\d+(?:\.\d+)*)"
BETWEEN = r"\s*(?P<between>-|–|,\s+and|,|and|to)\s*"


def places(text: str) -> Iterator[tuple[int, Place]]:
    """Yield the places that a text names right after a paper, and where in the text.

    ``[N] (2.19)-(2.21)`` names three, ``[LMV] Figures 1 and 2`` two, ``[N] 7.3`` is a section.
    """
    for paper in re.finditer(r"\[(N|LMV)\]\s+", text):
        at, last, kind, between = paper.end(), None, "Section", ""
        while found := re.compile(PLACE, re.I).match(text, at):
            if found["eq"]:
                kind = ""
            elif found["kind"]:
                kind = found["kind"].capitalize()
            elif last and not last.kind:
                break  # a number after an equation is no place
            number = tuple(map(int, (found["eq"] or found["number"]).split(".")))
            place = Place(f"[{paper[1]}]", kind, number)
            if last and between in ("-", "–", "to") and last.kind == kind:
                for n in range(last.number[-1] + 1, number[-1]):
                    yield found.start(), place._replace(number=(*number[:-1], n))
            yield found.start(), place
            separator = re.compile(BETWEEN).match(text, found.end())
            if not separator:
                break
            at, last, between = separator.end(), place, separator["between"]


def cited(module: str) -> dict[Place, list[str]]:
    """Return the places of the papers that a module names, each with who names it.

    These are names in the module, the innermost function or class around the line, or "" for the
    module's own docstring.
    """
    found: dict[Place, list[str]] = {}
    text = source(module)
    inner = sorted(definitions(module), key=lambda d: d[1].lineno)
    for offset, place in places(text):
        line = text.count("\n", 0, offset) + 1
        around = [n for n, node in inner if node.lineno <= line <= (node.end_lineno or 0)]
        names = found.setdefault(place, [])
        name = around[-1] if around else ""
        if name not in names:
            names.append(name)
    return dict(sorted(found.items(), key=lambda item: sort_key(item[0])))


def sort_key(place: Place) -> tuple[int, int, tuple[int, ...]]:
    """[N] before [LMV]; equations, then theorems, ..., figures, sections; then by number."""
    return place.paper == "[LMV]", KINDS.index(place.kind), place.number
