"""What of a notebook a claim needs, and what it says if something in that is changed."""

import ast
import dis
import json
from pathlib import Path
from types import CodeType
from typing import Any

BOOK = Path(__file__).parents[1] / "book"


def statements(chapter: str, replace: tuple[str, str] | None = None) -> list[ast.stmt]:
    """Return the top-level statements of a notebook, after a replacement that must occur in it."""
    (path,) = BOOK.glob(f"{chapter}_*.ipynb")
    cells = json.loads(path.read_text("utf8"))["cells"]
    source = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    if replace is not None:
        old, new = replace
        assert source.count(old) == 1, f"{path.name} has {source.count(old)} times {old!r}"
        source = source.replace(old, new)
    return ast.parse(source).body


def call_of(name: str, body: list[ast.stmt]) -> tuple[int, ast.Call]:
    """Return the call claim("<name>", ...), and the number of its statement."""
    for i, statement in enumerate(body):
        for node in ast.walk(statement):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "claim":
                first = node.args[0]
                if isinstance(first, ast.Constant) and first.value == name:
                    return i, node
    raise AssertionError(f"there is no claim {name}")


def loaded(node: ast.stmt | ast.Expression) -> set[str]:
    """Return the global names that a piece of code reads, those in its functions included."""
    if isinstance(node, ast.Expression):
        return _read_by(compile(node, "slice", "eval"))
    names = _read_by(compile(ast.Module([node], type_ignores=[]), "slice", "exec"))
    return names - _targets(node)


def _read_by(code: CodeType) -> set[str]:
    """Global names that are read, and not set before by the same code."""
    read, written = set(), set()
    for step in dis.get_instructions(code):
        if step.opname in ("LOAD_NAME", "LOAD_GLOBAL") and step.argval not in written:
            read.add(step.argval)
        elif step.opname == "STORE_NAME":
            written.add(step.argval)
    inner = (_read_by(c) for c in code.co_consts if isinstance(c, CodeType))
    return read.union(*(names - (written - read) for names in inner))


def _targets(statement: ast.stmt) -> set[str]:
    """Names that a loop sets itself."""
    loops = [n for n in ast.walk(statement) if isinstance(n, ast.For)]
    return {n.id for loop in loops for n in ast.walk(loop.target) if isinstance(n, ast.Name)}


def bound(statement: ast.stmt) -> set[str]:
    """Return the names that a statement binds, or whose values it may change."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {statement.name}
    found: set[str] = set()
    for node in ast.walk(statement):
        match node:
            case ast.Name(id=name, ctx=ast.Store()):
                found.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.alias(name=name, asname=other):
                found.add(other or name.split(".")[0])
            case (
                ast.Subscript(value=inner, ctx=ast.Store())
                | ast.Call(func=ast.Attribute(value=inner, attr="append" | "update" | "setdefault"))
            ):
                while isinstance(inner, ast.Subscript | ast.Attribute | ast.Call):
                    inner = inner.func if isinstance(inner, ast.Call) else inner.value
                if isinstance(inner, ast.Name):
                    found.add(inner.id)
    return found - _targets(statement)


def _is_expectation(node: ast.AST) -> bool:
    """Whether this is expect(...), which says what a chapter states beside its claims."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Call)
        and getattr(node.value.func, "id", "") == "expect"
    )


class _WithoutAsserts(ast.NodeTransformer):
    def visit_Assert(self, node: ast.Assert) -> ast.stmt:
        return ast.copy_location(ast.Pass(), node)

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        return ast.copy_location(ast.Pass(), node) if _is_expectation(node) else node


def needed(body: list[ast.stmt], last: int, call: ast.Call) -> list[ast.stmt]:
    """Return the statements before the `last` on which a call depends, without their asserts."""
    stated = (s for s in body[:last] if not (isinstance(s, ast.Assert) or _is_expectation(s)))
    candidates = [(s, bound(s), loaded(s)) for s in stated]
    names, size = loaded(ast.Expression(call)), 0
    while len(names) > size:  # a function may read what is bound only after it
        size = len(names)
        names = names.union(*(reads for _, binds, reads in candidates if binds & names))
    found = [_WithoutAsserts().visit(s) for s, binds, _ in candidates if binds & names]
    return [ast.fix_missing_locations(s) for s in found]


def run_claim(chapter: str, name: str, replace: tuple[str, str] | None = None) -> Any:
    """Run what a claim needs, with a replacement in the source, and return the claim."""
    body = statements(chapter, replace)
    last, call = call_of(name, body)
    module = ast.Module(needed(body, last, call), type_ignores=[])
    space: dict[str, Any] = {"__name__": "slice"}
    exec(compile(module, f"{chapter}, {name}", "exec"), space)
    return eval(compile(ast.Expression(call), f"{chapter}, {name}", "eval"), space)
