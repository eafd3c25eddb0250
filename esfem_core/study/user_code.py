"""What the result of a user's function depends on: its code and what it uses, as one hash.

The function may stand in a notebook, so that no file tells what a name means. It is followed from
object to object: functions and classes by their code, the names in them by their values, and
values by content. Docstrings, comments and layout do not count.
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
from dataclasses import fields, is_dataclass
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
from esfem_core.study import dependencies
from esfem_core.study.dependencies import PACKAGE, code_hash, is_at_top, is_of_package

__all__ = ["code_of"]

BY_TEXT = (
    *(str, bytes, bytearray, Number, np.generic, type(None), type(...), Enum, range, slice),
    *(PurePath, date, time, timedelta, re.Pattern),
)
"""Values that their `repr` tells all of."""

WRAPPED = ("__wrapped__", "pyfunc", "py_func")
"""Where functools.cache, numpy.vectorize and the like keep the function that they call."""


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
        if is_at_top(module, top := name.partition(".")[0]):
            self.texts.append(dependencies.hash_of(module, top, PACKAGE))
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
            return repr(dependencies.syntax(tree.body)), [
                list(c) for s in tree.body for c in dependencies.chains(s)
            ]
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
