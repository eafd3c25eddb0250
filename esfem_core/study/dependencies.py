"""What the result of a function depends on: the code that it reaches, as one hash.

Stored results are as good as the code that made them. A hash of the whole package would call them
out of date after every change of a docstring or of a picture; here a function's own code is
followed, name by name, through the definitions of the package that it can reach. What cannot change
a result does not count: docstrings, comments, layout, what errors say, warnings, and what only
refuses input, as each ``if`` does that only raises ValueError or TypeError. Functions named
``check_...`` or ``warn...`` do nothing else, and ``permit_...`` sets who may read a file: calls of
them do not count. What ends a run does, since an experiment may store that. Of a class those
methods count whose names stand in code that is reached.

Code of the package is read from its files. That of a user, which may stand in a notebook, is
followed from object to object by :mod:`esfem_core.study.user_code`.
"""

import ast
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

__all__ = ["code_hash", "is_of_package", "reached"]

PACKAGE = Path(__file__).parents[1]
UNCOUNTED = "check_", "warn", "permit_"  # how names begin of functions whose calls do not count


@dataclass(frozen=True)
class _Module:
    """A file: what each of its names is bound to.

    Attributes
    ----------
    definitions : dict
        Statements of the module that bind a name or change what it is bound to. Methods stand
        beside their class, as "Class.method".
    always : list
        Statements without a name of their own.
    imports : dict
        For a name that is imported anywhere in the file: a module, and a name in it or None.
    """

    definitions: dict[str, list[ast.stmt]] = field(default_factory=dict)
    always: list[ast.stmt] = field(default_factory=list)
    imports: dict[str, tuple[str, str | None]] = field(default_factory=dict)


def is_of_package(function: Callable[..., Any]) -> bool:
    """Whether a function is defined at the top of a module of this package."""
    return isinstance(function, FunctionType) and is_at_top(*home(function))


def home(function: FunctionType) -> tuple[str | None, str]:
    """Where the code of a function stands: its module and its name there.

    A wrapper, as of functools.wraps, has the name of what it wraps, but its code is its own.
    """
    return function.__globals__.get("__name__"), function.__code__.co_qualname


def is_at_top(module: str | None, name: str) -> bool:
    """Whether a module of this package defines a name at its top."""
    read = _read(module, PACKAGE) if module else None
    return read is not None and name in read.definitions and "." not in name


def code_hash(function: Callable[..., Any]) -> str:
    """Hash of the code that a function of this package reaches.

    Parameters
    ----------
    function : callable
        Defined at the top of a module of the package.

    Returns
    -------
    str
        Twelve hexadecimal digits, the same for all versions of Python.

    Raises
    ------
    ValueError
        If the function is not defined there.

    Examples
    --------
    >>> from esfem_core.stepping import bdf
    >>> len(code_hash(bdf.delta))
    12
    """
    return hash_of(function.__module__, function.__qualname__, PACKAGE, whole=False)


def reached(function: Callable[..., Any]) -> list[str]:
    """Modules of the package that a function reaches, by name: what its hash depends on.

    Examples
    --------
    >>> from esfem_core.stepping import bdf
    >>> reached(bdf.delta)
    ['esfem_core.checks', 'esfem_core.stepping.bdf']
    """
    found = _closure(function.__module__, function.__qualname__, PACKAGE, whole=False)
    return sorted({module for module, _ in found})


@cache
def hash_of(module: str, name: str, package: Path, whole: bool = True) -> str:
    """Hash of what a name of this package reaches.

    If it is used by other code, classes count as a whole, since that code may call any method.
    """
    return _digest(_closure(module, name, package, whole))


@cache
def hash_of_all(module: str) -> str:
    """Hash of what a module of this package, or a folder of modules, reaches as a whole."""
    path = PACKAGE.joinpath(*module.split(".")[1:])
    starts = []
    for file in sorted(path.rglob("*.py")) or [path.with_suffix(".py")]:
        inside = file.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(part for part in inside if part != "__init__")
        read = _read(name, PACKAGE)
        assert read is not None
        starts += [(name, key) for key in ("", *read.definitions)]
    return _digest(_reached_from(starts, PACKAGE, whole=True))


def _digest(texts: dict[tuple[str, str], str]) -> str:
    total = hashlib.sha256()
    for key, text in sorted(texts.items()):
        total.update(f"{key}\0{text}\0".encode())
    return total.hexdigest()[:12]


def _closure(module: str, name: str, package: Path, whole: bool) -> dict[tuple[str, str], str]:
    """Code of all definitions that a name reaches, by module and name."""
    start = _read(module, package)
    if start is None or name not in start.definitions:
        raise ValueError(f"{module}.{name} is not defined at the top of a module of {package.name}")
    return _reached_from([(module, name)], package, whole)


def _reached_from(
    waiting: list[tuple[str, str]], package: Path, whole: bool
) -> dict[tuple[str, str], str]:
    found: dict[tuple[str, str], str] = {}
    named: set[str] = set()
    methods: dict[str, list[tuple[str, str]]] = {}  # of classes found, not yet named, by name
    while waiting:
        key = waiting.pop()
        if key in found:
            continue
        definition = _definition(*key, package)
        found[key] = definition.code
        named |= definition.names
        waiting += definition.targets
        for method in definition.methods:
            methods.setdefault(method.rpartition(".")[2], []).append((key[0], method))
        for name in list(methods) if whole else methods.keys() & named:
            waiting += methods.pop(name)
    return found


class _Definition(NamedTuple):
    """Code of a name, and what it reaches."""

    code: str
    targets: set[tuple[str, str]]  # modules and names there
    names: set[str]  # all attributes and texts in it, which may be names of methods
    methods: list[str]  # of a class


@cache
def _definition(module: str, name: str, package: Path) -> _Definition:
    """A name of a module; "" stands for statements without a name."""
    here = _read(module, package)
    assert here is not None
    statements = here.definitions.get(name, here.always)
    targets, names = {(module, "")}, set()
    for statement in statements:
        for chain in chains(statement):
            targets.update(_targets(module, chain, package))
        names |= _names(statement)
    methods = [key for key in here.definitions if name and key.startswith(f"{name}.")]
    return _Definition(repr(syntax(statements)), targets, names, methods)


def _names(statement: ast.stmt) -> set[str]:
    """All attributes and texts in a statement."""
    nodes = list(ast.walk(statement))
    texts = {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return texts | {n.attr for n in nodes if isinstance(n, ast.Attribute)}


def _targets(module: str, chain: list[str], package: Path) -> Iterator[tuple[str, str]]:
    """Definitions of the package that a.b.c in a module stands for; none for other names."""
    here = _read(module, package)
    if here is None:
        return
    if not chain:  # the module itself, as an object
        yield from ((module, name) for name in here.definitions)
        return
    name, rest = chain[0], chain[1:]
    if name in here.definitions:
        yield module, name
    elif name in here.imports:
        source, inner = here.imports[name]
        if inner is None:
            yield from _targets(source, rest, package)
        elif _read(f"{source}.{inner}", package):
            yield from _targets(f"{source}.{inner}", rest, package)
        else:
            yield from _targets(source, [inner, *rest], package)
    else:
        yield from _targets(f"{module}.{name}", rest, package)


def chains(statement: ast.stmt) -> Iterator[list[str]]:
    """All a.b.c in a statement, as lists of names, and all names."""
    inner: set[int] = set()
    for node in ast.walk(statement):
        if id(node) in inner:
            continue
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            inner.add(id(node))
            parts.append(node.attr)
            node = node.value
        if isinstance(node, ast.Name):
            inner.add(id(node))
            yield [node.id, *reversed(parts)]


@cache
def _read(module: str, package: Path) -> _Module | None:
    """A module of the package, or None if there is none of this name."""
    head, *parts = module.split(".")
    if head != package.name:
        return None
    path = package.joinpath(*parts)
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not file.is_file():
        return None
    tree = _WhatCounts().visit(ast.parse(file.read_text("utf8")))
    found = _Module()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                found.imports[alias.asname or alias.name] = node.module, alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                whole = alias.name if alias.asname else alias.name.partition(".")[0]
                found.imports[alias.asname or whole] = whole, None
    for statement in tree.body:
        if isinstance(statement, ast.ClassDef):
            found.definitions.update(_methods(statement))
        names = _bound(statement)
        for name in names:
            found.definitions.setdefault(name, []).append(statement)
        if not names and not isinstance(statement, ast.Import | ast.ImportFrom):
            found.always.append(statement)
    found.definitions.pop("__all__", None)
    return found


class _WhatCounts(ast.NodeTransformer):
    """Takes out of a file what errors say, warnings, and what only refuses input.

    Errors of other kinds may be part of an algorithm: some are caught, and another way is tried.
    """

    def visit_If(self, node: ast.If) -> ast.If | None:
        self.generic_visit(node)
        return None if not node.orelse and all(map(_refuses, node.body)) else node

    def visit_Raise(self, node: ast.Raise) -> ast.Raise:
        return ast.Raise(node.exc.func if isinstance(node.exc, ast.Call) else node.exc)

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        called = node.value.func if isinstance(node.value, ast.Call) else None
        name = getattr(called, "attr", getattr(called, "id", ""))
        return None if name.lstrip("_").startswith(UNCOUNTED) else node


def _refuses(statement: ast.stmt) -> bool:
    error = statement.exc if isinstance(statement, ast.Raise) else None
    return isinstance(error, ast.Name) and error.id in ("TypeError", "ValueError")


def _methods(statement: ast.ClassDef) -> dict[str, list[ast.stmt]]:
    """Take the methods out of a class; those that Python itself calls, as __add__, stay there."""
    methods: dict[str, list[ast.stmt]] = {}
    rest: list[ast.stmt] = []
    for member in statement.body:
        if isinstance(member, ast.FunctionDef) and not member.name.startswith("__"):
            methods.setdefault(f"{statement.name}.{member.name}", []).append(member)
        else:
            rest.append(member)
    statement.body = rest
    return methods


def _bound(statement: ast.stmt) -> list[str]:
    """Names that a statement of a module binds, or whose value it changes."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [statement.name]
    targets: list[ast.expr] = []
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
        targets = [statement.target]
    return [
        node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)
    ]


def syntax(node: Any) -> Any:
    """A piece of syntax as nested tuples, without places in the file and without docstrings."""
    if isinstance(node, list):
        return [syntax(entry) for entry in node if not _is_text(entry)]
    if not isinstance(node, ast.AST):
        return node
    fields = ((name, value) for name, value in ast.iter_fields(node) if value not in (None, []))
    return type(node).__name__, *((name, syntax(value)) for name, value in fields)


def _is_text(node: Any) -> bool:
    """Whether a statement is a string and nothing else, such as a docstring."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
