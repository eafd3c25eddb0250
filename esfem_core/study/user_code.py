"""What the result of a user's function depends on: its code and what it uses, as one hash.

The function may stand in a notebook, so that no file tells what a name means. It is followed from
object to object: functions and classes by their code, the names in them by their values, and
values by content. Docstrings, comments and layout do not count.
"""

import ast
import copyreg
import dis
import functools
import gc
import hashlib
import importlib
import importlib.util
import inspect
import os
import random
import re
import sys
import sysconfig
import textwrap
from collections.abc import Callable, ItemsView, Iterator, KeysView, Mapping, ValuesView
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any
from uuid import uuid4
from weakref import WeakKeyDictionary, WeakSet, WeakValueDictionary

import numpy as np
import trimesh
from scipy.sparse import issparse
from scipy.sparse.linalg import SuperLU

from esfem_core.elements import SurfaceSpace
from esfem_core.study import dependencies, loaded
from esfem_core.study.dependencies import PACKAGE, code_hash, is_of_package

__all__ = ["code_of", "imports_of", "values_of"]

BY_TEXT = (str, bytes, bytearray, bool, int, float, complex, type(None), type(...), range)
"""Values that their `repr` tells all of."""

CACHES = (WeakKeyDictionary, WeakValueDictionary, WeakSet)
"""What an object has computed in the meantime: it does not count."""

WRAPPED = ("__wrapped__", "pyfunc", "py_func")
"""Where functools.cache, numpy.vectorize and the like keep the function that they call."""

WRAPPING = ("otypes", "signature", "excluded")
"""How numpy.vectorize calls it; what such an object keeps besides are caches."""

SENT = ("__main__", "__mp_main__")
"""Modules whose functions are sent to other processes with their code."""

DRAWING: tuple[Any, ...] = (random.random, np.random.random_sample)
SHARED = (os.environ, *(function.__self__ for function in DRAWING))
"""What a process has one of, such as the generator that numbers of numpy.random are drawn from.

It counts by name, since what it holds is another matter in every process.
"""

LEFT_OUT = {"__module__", "__qualname__", "__doc__", "__dict__", "__weakref__"} | {
    *("__firstlineno__", "__static_attributes__", "__slotnames__", "__annotations__"),
    *("__annotate__", "__annotate_func__", "__annotations_cache__"),
}
"""Members of a class that tell where it stands, or repeat what others tell."""


def code_of(function: Callable[..., Any]) -> str:
    """Hash of the code that decides what a function returns, of this package or of a user.

    For a user's function, other functions and classes of the user that it reaches count, and the
    values of the names that it uses: numbers, strings, arrays, sparse matrices, containers of them,
    laws, problems, spaces, triangulations with their units, attributes and colours, and other
    objects. Those of the user's classes and of other packages count by what pickle would keep of
    them. What it cannot keep counts by its attributes, or, if it has none, by its class if that is
    Python's own, such as a lock; of other packages it is another one at each look, so that no
    result that it may have changed is taken for that of today. Objects of this package count by
    what their constructor took, if they keep all of it, or else by their public attributes, or by
    all if none is. Modules count as far as they are used, compiled ones by their files, and those
    of other packages by their names.

    What a function reaches only by a text does not count: ``globals()[name]``, ``vars()``, ``eval``
    and ``exec``. A dict of functions, ``{"law": law}[name]``, does.

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
    return _digest(function, {})[:12]


def imports_of(function: Callable[..., Any]) -> dict[str, str]:
    """What each process imports for itself of a user's function: functions of modules, by name.

    Returns
    -------
    dict
        For each of them a hash of its byte code, and of the numbers and strings that it uses where
        its module has such lines as ``N = 3``. (Others may differ from machine to machine.)
        Different versions of Python have no names in common.
    """
    seen: dict[int, tuple[int, Any]] = {}
    _digest(function, seen)
    found: dict[str, str] = {}
    for _, value in seen.values():
        module, name = dependencies.home(value) if isinstance(value, FunctionType) else (None, "")
        if module in SENT or _is_library(module) or _head(module) == PACKAGE.name:
            continue
        name = f"{module}.{name} ({sys.implementation.cache_tag})"
        # Several may have the same name.
        parts = [found.get(name), loaded.byte_code(value.__code__), loaded.constants(value)]
        found[name] = _digest(parts, {})[:12]
    return found


def values_of(function: Callable[..., Any]) -> str:
    """Hash of what a function reaches as it is loaded, to compare processes of one machine.

    It is as that of :func:`code_of`, but files are not looked at: another process may lack them,
    such as the cells of a notebook. It may be another one in each process, as where a module draws
    a number when it is imported.
    """
    return _digest(function, {}, loaded_only=True)[:12]


def _digest(value: Any, seen: dict[int, tuple[int, Any]], loaded_only: bool = False) -> str:
    """Hash of the texts of all that a value reaches, in the order in which it is met.

    `seen` are the objects met before, with their numbers, by id, and receives those that it meets;
    they are kept alive, so that no id is used twice.
    """
    texts, waiting = [], [value]
    while waiting:
        value = waiting.pop()
        if type(value) in BY_TEXT:
            texts.append(repr(value))
        elif id(value) in seen:
            texts.append(f"as number {seen[id(value)][0]}")
        else:
            if not loaded_only or type(value) not in (tuple, frozenset):
                # Which of them are one object is another matter where code comes from a cache.
                seen[id(value)] = len(seen), value
            plain = loaded_only and isinstance(value, FunctionType)
            text, parts = _told_of_function(value, True) if plain else _told(value)
            text += _compiled(value)
            if isinstance(value, set | frozenset):  # each by itself: their order is none
                parts = sorted(
                    repr(part) if type(part) in BY_TEXT else _digest(part, dict(seen), loaded_only)
                    for part in parts
                )
            texts.append(text)
            waiting += reversed(parts)
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


Told = tuple[str, list[Any]]
"""What is to be said of an object, and the other objects that tell the rest."""


def _told(value: Any) -> Told:
    """What tells an object: code as far as it goes, data by content."""
    if isinstance(value, type):
        return _told_of_class(value)
    if isinstance(value, FunctionType):
        return _told_of_function(value)
    if isinstance(value, ModuleType):
        return _told_of_module(value)
    if isinstance(value, np.ndarray | np.generic):
        return _told_of_array(value)
    kind = type(value)
    if isinstance(value, SurfaceSpace):
        return "", [kind, value.nodes, value.cells, value.rule]
    if isinstance(value, trimesh.Trimesh):
        return "", [kind, *_told_of_mesh(value)]
    if _is_library(_module_of(kind)):
        return _told_of_library(value)
    return "", [kind, _made_of(value) if _head(_module_of(kind)) == PACKAGE.name else _kept(value)]


def _told_of_mesh(mesh: trimesh.Trimesh) -> list[Any]:
    """Vertices, triangles, and what else a mesh was given, without what trimesh computes of it."""
    plain = (np.ndarray, trimesh.Trimesh)  # of trimesh's own attributes the others are caches
    given = {
        name: part
        for name, part in vars(mesh).items()
        if isinstance(part, plain) or _head(_module_of(type(part))) != "trimesh"
    }
    metadata = {name: part for name, part in mesh.metadata.items() if name != "file_path"}
    given |= {"metadata": metadata}
    # density and center_mass, where they are set
    data = {name: np.array(part) for name, part in mesh._data.data.items()}
    colours = getattr(mesh.visual, f"{mesh.visual.kind}_colors", None)
    return [np.array(mesh.vertices), np.array(mesh.faces), data, given, colours]


def _told_of_array(value: Any) -> Told:
    name, own = type(value).__name__, []
    if not _is_library(_module_of(type(value))):
        own = [type(value), vars(value)]
    if np.ma.isMaskedArray(value):
        return name, [*own, np.ma.getdata(value), np.ma.getmaskarray(value)]
    if value.dtype.hasobject:  # bytes are addresses
        return name, [*own, value.shape, value.tolist()]
    data = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return f"{name} {value.dtype} {value.shape} {data}", own


def _told_of_library(value: Any) -> Told:
    """What tells an object of a class that is built in, or of another package."""
    name = type(value).__name__
    if isinstance(value, CACHES) or any(value is shared for shared in SHARED):
        return name, []
    if isinstance(value, Mapping):
        parts = [part for item in value.items() for part in item]
        return f"{name} of {len(value)}", [getattr(value, "default_factory", None), *parts]
    if isinstance(value, list | tuple | set | frozenset | KeysView | ValuesView | ItemsView):
        return f"{name} of {len(value)}", list(value)
    if isinstance(value, CodeType):
        return name, loaded.byte_code(value)
    if isinstance(value, memoryview):
        return name, [value.format, value.shape, value.tobytes()]
    if isinstance(value, SuperLU):
        return name, [value.L, value.U, value.perm_r, value.perm_c]
    if isinstance(value, MethodType):
        return name, [value.__func__, value.__self__]
    if isinstance(value, BuiltinFunctionType):
        return value.__qualname__, [value.__self__]
    if isinstance(value, np.ufunc):  # numpy.frompyfunc shows its function to no one else
        return value.__name__, [part for part in gc.get_referents(value) if callable(part)]
    if isinstance(value, staticmethod | classmethod):
        return name, [value.__func__]
    if isinstance(value, property):
        return name, [value.fget, value.fset, value.fdel]
    if issparse(value):
        return name, _entries(value)
    return "", [type(value), _kept(value)]


def _entries(matrix: Any) -> list[Any]:
    """What tells a sparse matrix, in the same form for every format."""
    entries = matrix.tocoo()
    return [matrix.shape, entries.coords, entries.data]


def _told_of_module(module: ModuleType) -> Told:
    """What tells a module that is used as a whole."""
    name = module.__name__
    if _head(name) == PACKAGE.name:
        return f"{name} {dependencies.hash_of_all(name)}", []
    if _is_library(name):
        return name, []
    own = {name: part for name, part in vars(module).items() if not _is_dunder(name)}
    return "", [own]


def _is_dunder(name: str) -> bool:
    """Whether a name of a module is one of Python's own."""
    return name.startswith("__") and name.endswith("__")


def _compiled(value: Any) -> str:
    """Hash of the file of a user's compiled module that a value is or stands in, if it does."""
    named = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    module = sys.modules.get(named) if isinstance(named, str) else None
    return "" if module is None or _is_library(named) else _hash_of_file(module)


@cache  # by what is loaded: the file may be made anew in the meantime
def _hash_of_file(module: ModuleType) -> str:
    file = getattr(module, "__file__", None) or ""
    if not file.endswith(tuple(EXTENSION_SUFFIXES)):
        return ""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _told_of_class(value: type) -> Told:
    module, name = _module_of(value), value.__qualname__
    if dependencies.is_at_top(module, top := _head(name)) and "<locals>" not in name:
        assert module is not None
        return f"{name} {dependencies.hash_of(module, top, PACKAGE)}", []
    if _is_library(module):
        return f"{module}.{name}", []
    members = [item for item in vars(value).items() if item[0] not in LEFT_OUT]
    return name, [type(value), *value.__bases__, *(part for item in members for part in item)]


def _told_of_function(function: FunctionType, loaded_only: bool = False) -> Told:
    module, name = dependencies.home(function)
    inside = "<locals>" in name
    if dependencies.is_at_top(module, top := _head(name)):
        assert module is not None
        # Inside another function, several may have the same name.
        rest = [_source(function)[0], *_held(function)] if inside else []
        return f"{name} {dependencies.hash_of(module, top, PACKAGE)}", rest
    if module is not None and _is_library(module):  # None: made by exec, as by sympy.lambdify
        return f"{module}.{name}", _held(function) if inside else []
    code, chains, imported = _loaded(function) if loaded_only else _source(function)
    enclosed, *defaults = _held(function)
    names = function.__globals__ | imported | enclosed
    used = [_found(names[name], rest) for name, *rest in chains if name in names]
    return function.__code__.co_name, [code, *defaults, vars(function), *used]


def _found(value: Any, attributes: list[str]) -> Any:
    """The a.b.c in the code of a user, as far as it leads through modules that count."""
    for name in attributes:
        if not isinstance(value, ModuleType) or _is_library(value.__name__):
            break
        value = getattr(value, name, None)
    return value


def _made_of(value: Any) -> Any:
    """What tells an object of this package from others of its class, without caches of it.

    That is what its constructor was given, if it keeps all of it under the same names, and else
    its public attributes, or all if none is.
    """
    if isinstance(value, tuple):
        return tuple(value)
    if is_dataclass(value):
        return {f.name: getattr(value, f.name, None) for f in fields(value)}
    attributes: dict[str, Any] = getattr(value, "__dict__", {})
    given, names = {}, []
    with suppress(ValueError):  # of the constructor of an exception
        names = list(inspect.signature(type(value)).parameters)
    for name in names:
        if f"_{name}" in attributes:
            given[name] = attributes[f"_{name}"]
        elif name in attributes or isinstance(getattr(type(value), name, None), property):
            given[name] = getattr(value, name)
    if names and len(given) == len(names):
        return given
    public = {name: part for name, part in attributes.items() if not name.startswith("_")}
    return given | (public or attributes)


def _kept(value: Any) -> Any:
    """What pickle would keep of an object, as plain values and other objects."""
    attributes = getattr(value, "__dict__", {})
    if any(name in attributes for name in WRAPPED) and _is_library(_module_of(type(value))):
        return [attributes[name] for name in (*WRAPPED, *WRAPPING) if name in attributes]
    registered = copyreg.dispatch_table.get(type(value))
    try:
        reduced = registered(value) if registered else value.__reduce_ex__(4)
    except Exception:  # whatever its class finds wrong with it
        if not attributes and _head(_module_of(type(value))) not in sys.stdlib_module_names:
            return uuid4().hex  # nothing tells it from others, which may hold other numbers
        return _without_caches(value, attributes)
    if isinstance(reduced, str):
        return reduced
    parts = list(reduced)
    parts[2:3] = [_without_caches(value, state) for state in parts[2:3]]
    # Entries of lists and dicts come as iterators.
    return [list(part) if isinstance(part, Iterator) else part for part in parts]


def _without_caches(value: Any, state: Any) -> Any:
    """Attributes, or pairs of them and of slots, without what the object can compute again."""
    if isinstance(state, tuple):
        return [_without_caches(value, part) for part in state]
    if not isinstance(state, dict):
        return state
    members = (item for kind in type(value).__mro__ for item in vars(kind).items())
    known = {name for name, member in members if isinstance(member, functools.cached_property)}
    return {name: part for name, part in state.items() if name not in known | {"__doc__"}}


def _enclosed(function: FunctionType) -> dict[str, Any]:
    """Values that a function has from the one in which it stands."""
    found = {}
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    for name, cell in cells:
        with suppress(ValueError):  # not bound yet
            found[name] = cell.cell_contents
    return found


def _held(function: FunctionType) -> list[Any]:
    """Values that a function carries with it."""
    return [_enclosed(function), function.__defaults__, function.__kwdefaults__]


def _source(function: FunctionType) -> tuple[Any, list[list[str]], dict[str, Any]]:
    """Code of a function, the a.b.c in it, and what it imports.

    That is its byte code if it has no source, or the source has been edited since it was loaded.
    """
    code = function.__code__
    if code.co_name != "<lambda>":  # which need not be alone in its lines
        try:
            tree = ast.parse(_renumbered(textwrap.dedent(loaded.source(code))))
        except (OSError, TypeError, SyntaxError):
            pass
        else:
            found = [chain for part in tree.body for chain in dependencies.chains(part)]
            return repr(dependencies.syntax(tree.body)), found, _imports(tree, function)
    return _loaded(function)


def _loaded(function: FunctionType) -> tuple[Any, list[list[str]], dict[str, Any]]:
    """Byte code of a function, and the a.b.c in it."""
    code = function.__code__
    found = [chain for inner in loaded.codes(code) for chain in _chains(inner)]
    return loaded.byte_code(code), found, {}


def _renumbered(text: str) -> str:
    """The same with other numbers in names that sympy.lambdify makes: it counts in all it does."""
    numbers: dict[str, int] = {}
    return re.sub(
        r"\b_Dummy_\d+\b",
        lambda found: f"_Dummy_{numbers.setdefault(found[0], len(numbers))}",
        text,
    )


def _chains(code: CodeType) -> Iterator[list[str]]:
    """All a.b.c in byte code, as lists of names."""
    chain: list[str] = []
    for step in dis.get_instructions(code):
        if step.opname in ("LOAD_ATTR", "LOAD_METHOD") and chain:
            chain.append(step.argval)
        elif step.opname not in ("CACHE", "EXTENDED_ARG"):
            if chain:
                yield chain
            named = step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF")
            chain = [step.argval] if named else []


def _imports(tree: ast.Module, function: FunctionType) -> dict[str, Any]:
    """What the names are that a function imports itself; those of other packages are left out."""
    found = {}
    package = function.__globals__.get("__package__")
    for node in ast.walk(tree):
        with suppress(Exception):  # whatever a module raises that cannot be imported
            if isinstance(node, ast.ImportFrom):
                source = importlib.util.resolve_name(
                    "." * node.level + (node.module or ""), package
                )
                for alias in [] if _is_library(source) else node.names:
                    module = importlib.import_module(source)
                    if not hasattr(module, alias.name):
                        importlib.import_module(f"{source}.{alias.name}")
                    found[alias.asname or alias.name] = getattr(module, alias.name)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    if not _is_library(alias.name):
                        module = importlib.import_module(alias.name)
                        head = _head(alias.name)
                        found[alias.asname or head] = module if alias.asname else sys.modules[head]
    return found


def _head(name: str | None) -> str:
    return (name or "").partition(".")[0]


def _module_of(kind: type) -> str | None:
    module = kind.__module__
    return module if isinstance(module, str) else None  # Cython's functions have a descriptor there


@cache
def _is_library(module: str | None) -> bool:
    """Whether a module is none of the user's: built in, or installed."""
    if module is None or module in SENT:
        return module is None
    head = _head(module)
    if head == PACKAGE.name:  # installed or not, it is followed
        return False
    if (path := _place(head)) is None:
        return head in sys.stdlib_module_names
    standard = Path(sysconfig.get_path("stdlib"))
    installed = {"site-packages", "dist-packages"} & set(path.parts)
    return bool(installed) or standard in path.parents or _is_of_pip(path)


def _is_of_pip(path: Path) -> bool:
    """Whether pip has put a module into its folder, whatever that is called: it keeps lists.

    A package that is worked on (``pip install -e``) is in none of them.
    """
    top = path.parent if path.stem == "__init__" else path
    entry = re.compile(f"^{re.escape(top.name)}[/,]", re.MULTILINE)
    lists = top.parent.glob("*.dist-info/RECORD")
    return any(entry.search(each.read_text("utf-8", "replace")) for each in lists)


def _place(head: str) -> Path | None:
    """The file or folder of a module, without importing it."""
    module = sys.modules.get(head)
    if module is None:
        found = None
        with suppress(ImportError, ValueError):
            found = importlib.util.find_spec(head)
        file = found.origin if found and found.has_location else None
        folders = found.submodule_search_locations if found else None
    else:
        file, folders = getattr(module, "__file__", None), getattr(module, "__path__", None)
    return next((Path(place) for place in (file, *(folders or ())) if place), None)
