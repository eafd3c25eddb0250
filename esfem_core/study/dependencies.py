"""What the result of a function depends on: the code that it reaches, as one hash.

Stored results are as good as the code that made them. A hash of the whole package would call them
out of date after every change of a docstring or of a picture; here a function's own code is
followed, name by name, through the definitions of the package that it can reach. Docstrings,
comments and layout do not count.

Code of the package is read from its files. That of a user, which may stand in a notebook, is
followed from object to object: functions, classes, and the values of the names that they use.
"""

import ast
import functools
import hashlib
import inspect
import re
import sys
import sysconfig
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import date, time, timedelta
from enum import Enum
from functools import cache
from numbers import Number
from pathlib import Path, PurePath
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    MethodType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any

import numpy as np
import trimesh

from esfem_core.elements import SurfaceSpace

__all__ = ["code_hash", "code_of", "is_of_package", "reached"]

PACKAGE = Path(__file__).parents[1]

BY_TEXT = (
    *(str, bytes, bytearray, Number, np.generic, type(None), type(...), Enum, range, slice),
    *(PurePath, date, time, timedelta, re.Pattern),
)
"""Values that their `repr` tells all of."""

WRAPPED = ("__wrapped__", "pyfunc", "py_func")
"""Where functools.cache, numpy.vectorize and the like keep the function that they call."""


@dataclass(frozen=True)
class _Module:
    """A file: what each of its names is bound to.

    Attributes
    ----------
    definitions : dict
        Statements of the module that bind a name or change what it is bound to.
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
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", "")
    return isinstance(function, FunctionType) and _is_at_top(module, name)


def _is_at_top(module: str | None, name: str) -> bool:
    read = _read(module, PACKAGE) if module else None
    return read is not None and name in read.definitions


def code_of(function: Callable[..., Any]) -> str:
    """Hash of the code that decides what a function returns, of this package or of a user.

    For a user's function, other functions and classes of the user that it reaches count, and the
    values of the names that it uses: numbers, strings, paths, arrays, lists, dicts and dataclasses
    of them, such as laws and problems, spaces, triangulations, and the attributes of other objects
    of the user's classes and of this package. What is left counts by its class, other packages not
    at all.

    Examples
    --------
    >>> def area(radius):
    ...     return factor * radius**2
    >>> factor = 3
    >>> before = code_of(area)
    >>> factor = 4
    >>> code_of(area) == before
    False
    """
    if is_of_package(function):
        return code_hash(function)
    walk = _Walk()
    walk.add(function)
    return hashlib.sha256("\0".join(walk.texts).encode()).hexdigest()[:12]


class _Walk:
    """Texts of all that a user's function reaches, in the order in which it is met."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._seen: dict[int, Any] = {}  # keeps what it has seen alive, so that no id is used twice

    def add(self, value: Any) -> None:
        """Follow a value: code as far as it goes, data by content."""
        if isinstance(value, BY_TEXT) and not np.ma.isMaskedArray(value):
            self.texts.append(repr(value))
        elif np.ma.isMaskedArray(value):
            self._add_all([np.ma.getdata(value), np.ma.getmaskarray(value)])
        elif isinstance(value, np.ndarray) and value.dtype.hasobject:  # bytes are addresses
            self.add([value.shape, value.tolist()])
        elif isinstance(value, np.ndarray):
            data = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
            self.texts.append(f"{value.dtype} {value.shape} {data}")
        elif id(value) in self._seen:
            self.texts.append("as before")
        else:
            self._seen[id(value)] = value
            self._add_object(value)

    def _add_object(self, value: Any) -> None:
        if isinstance(value, Mapping | list | tuple | set | frozenset):
            self.texts.append(f"{type(value).__name__} of {len(value)}")
        if isinstance(value, functools.partial):
            self._add_all([value.func, value.args, value.keywords])
        elif isinstance(value, MethodType):
            self._add_all([value.__func__, value.__self__])
        elif isinstance(value, FunctionType | type):
            self._add_definition(value)
        elif isinstance(value, Mapping):
            self._add_all(part for item in value.items() for part in item)
        elif isinstance(value, list | tuple):
            self._add_all(value)
        elif isinstance(value, set | frozenset):
            self._add_all(sorted(value, key=repr))
        elif isinstance(value, staticmethod | classmethod):
            self.add(value.__func__)
        elif isinstance(value, property):
            self._add_all([value.fget, value.fset])
        elif isinstance(value, ModuleType | BuiltinFunctionType | np.ufunc):
            self.texts.append(value.__name__)
        elif isinstance(value, SimpleNamespace):
            self.add(vars(value))
        elif is_dataclass(value):
            self._add_all(
                [type(value), {f.name: getattr(value, f.name, None) for f in fields(value)}]
            )
        elif isinstance(value, SurfaceSpace):
            self._add_all([value.nodes, value.cells, value.rule])
        elif isinstance(value, trimesh.Trimesh):
            self._add_all([np.array(value.vertices), np.array(value.faces)])
        else:
            self.add(type(value))
            self.add(_attributes(value))

    def _add_all(self, values: Any) -> None:
        for value in values:
            self.add(value)

    def _add_definition(self, value: Any) -> None:
        """Follow a function or a class."""
        module, name = value.__module__, value.__qualname__
        self.texts.append(name)
        if _is_at_top(module, top := name.partition(".")[0]):
            self.texts.append(_hash(module, top, PACKAGE))
            self._add_all(_enclosed(value).values())
        elif _is_library(module):
            pass
        elif isinstance(value, type):
            self._add_all(value.__bases__)
            for key, member in vars(value).items():
                if key not in LEFT_OUT:
                    self._add_all([key, member])
        else:
            self._add_function(inspect.unwrap(value))

    def _add_function(self, function: Any) -> None:
        inner = function.__code__.co_freevars
        names = {k: v for k, v in function.__globals__.items() if k not in inner}
        names |= _enclosed(function)
        text, chains = _source(function)
        self.texts.append(text)
        self._add_all([function.__defaults__, function.__kwdefaults__])
        for name, *rest in chains:
            if name in names:
                found = names[name]
                while rest and isinstance(found, ModuleType) and not _is_library(found.__name__):
                    found = getattr(found, rest.pop(0), None)
                self.add(found)


def _attributes(value: Any) -> dict[str, Any]:
    """What tells an object from others of its class: of this package, what is no cache of it."""
    inner, module = getattr(value, "__dict__", {}), type(value).__module__
    if _is_library(module):
        return {name: inner[name] for name in WRAPPED if name in inner}
    if _head(module) == PACKAGE.name:
        return {name: part for name, part in inner.items() if not name.startswith("_")}
    return dict(inner)


def _enclosed(function: Any) -> dict[str, Any]:
    """Values that a function has from the one in which it stands."""
    found = {}
    if isinstance(function, FunctionType):
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        for name, cell in cells:
            with suppress(ValueError):  # not bound yet
                found[name] = cell.cell_contents
    return found


LEFT_OUT = {"__module__", "__qualname__", "__doc__", "__dict__", "__weakref__"} | {
    "__firstlineno__",
    "__static_attributes__",
    "__annotations__",
}


def _source(function: Any) -> tuple[str, list[list[str]]]:
    """Code of a user's function, and the a.b.c in it; its byte code where it has no source."""
    if function.__name__ != "<lambda>":
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        except (OSError, TypeError, SyntaxError):
            pass
        else:
            return repr(_plain(tree.body)), [list(c) for s in tree.body for c in _chains(s)]
    codes = list(_codes(function.__code__))
    names = dict.fromkeys(name for code in codes for name in (*code.co_names, *code.co_freevars))
    texts = ((c.co_code, [k for k in c.co_consts if not isinstance(k, CodeType)]) for c in codes)
    return repr([*texts, *names]), [[name] for name in names]


def _codes(code: CodeType) -> Iterator[CodeType]:
    """The byte code of a function and of the functions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _head(module: str | None) -> str:
    return (module or "").partition(".")[0]


@cache
def _is_library(module: str | None) -> bool:
    """Whether a module is none of the user's: built in, or installed."""
    if module in (None, "__main__", "__mp_main__"):
        return module is None
    file = getattr(sys.modules.get(_head(module)), "__file__", None)
    if file is None:
        return _head(module) in sys.stdlib_module_names
    path = Path(file)
    standard = Path(sysconfig.get_path("stdlib"))
    return bool({"site-packages", "dist-packages"} & set(path.parts)) or standard in path.parents


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
    return _hash(function.__module__, function.__qualname__, PACKAGE)


def reached(function: Callable[..., Any]) -> list[str]:
    """Modules of the package that a function reaches, by name.

    Examples
    --------
    >>> from esfem_core.stepping import bdf
    >>> reached(bdf.delta)
    ['esfem_core.checks', 'esfem_core.stepping.bdf']
    """
    found = _closure(function.__module__, function.__qualname__, PACKAGE)
    return sorted({module for module, _ in found})


@cache
def _hash(module: str, name: str, package: Path) -> str:
    total = hashlib.sha256()
    for key, text in sorted(_closure(module, name, package).items()):
        total.update(f"{key}\0{text}\0".encode())
    return total.hexdigest()[:12]


def _closure(module: str, name: str, package: Path) -> dict[tuple[str, str], str]:
    """Code of all definitions that a name reaches, by module and name."""
    start = _read(module, package)
    if start is None or name not in start.definitions:
        raise ValueError(f"{module}.{name} is not defined at the top of a module of {package.name}")
    found: dict[tuple[str, str], str] = {}
    waiting = [(module, name)]
    while waiting:
        key = waiting.pop()
        if key not in found:
            found[key], targets = _definition(*key, package)
            waiting += targets
    return found


@cache
def _definition(module: str, name: str, package: Path) -> tuple[str, set[tuple[str, str]]]:
    """Code of a name, and what it reaches at once; "" stands for statements without a name."""
    here = _read(module, package)
    assert here is not None
    statements = here.definitions.get(name, here.always)
    targets = {(module, "")}
    for statement in statements:
        for chain in _chains(statement):
            targets.update(_targets(module, chain, package))
    return repr(_plain(statements)), targets


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


def _chains(statement: ast.stmt) -> Iterator[list[str]]:
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
    tree = ast.parse(file.read_text("utf8"))
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
        names = _bound(statement)
        for name in names:
            found.definitions.setdefault(name, []).append(statement)
        if not names and not isinstance(statement, ast.Import | ast.ImportFrom):
            found.always.append(statement)
    found.definitions.pop("__all__", None)
    return found


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


def _plain(node: Any) -> Any:
    """A piece of syntax as nested tuples, without places in the file and without docstrings."""
    if isinstance(node, list):
        return [_plain(entry) for entry in node if not _is_text(entry)]
    if not isinstance(node, ast.AST):
        return node
    fields = ((name, value) for name, value in ast.iter_fields(node) if value not in (None, []))
    return type(node).__name__, *((name, _plain(value)) for name, value in fields)


def _is_text(node: Any) -> bool:
    """Whether a statement is a string and nothing else, such as a docstring."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
