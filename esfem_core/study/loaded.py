"""What a process has loaded, beside the file that it came from.

A file can be edited after it was imported; what a process computes with is what it has loaded.
"""

import __future__

import ast
import inspect
from collections.abc import Iterator
from functools import lru_cache
from types import CodeType, FunctionType
from typing import Any

__all__ = ["byte_code", "codes", "constants", "source"]

FUTURES = sum({getattr(__future__, name).compiler_flag for name in __future__.all_feature_names})
"""Flags of code under ``from __future__ import``."""


def source(code: CodeType) -> str:
    """The lines of a function in its file.

    Raises
    ------
    OSError, TypeError
        If there is no such file, or it has other code by now.
    SyntaxError
        If it cannot be read.
    """
    lines, loaded = _lines(code), _without_places(code)
    named = _functions("".join(lines), code.co_filename, code.co_flags & FUTURES)
    starts = [
        found.co_firstlineno
        for found in named.get(code.co_qualname, [])
        if _without_places(found) == loaded
    ]
    if not starts:
        raise OSError(f"{code.co_filename} has been edited")
    start = min(starts, key=lambda line: abs(line - code.co_firstlineno))
    return "".join(inspect.getblock(lines[start - 1 :]))


def _lines(code: CodeType) -> list[str]:
    """The file of a function as it is now."""
    return inspect.findsource(code.replace(co_firstlineno=1))[0]


@lru_cache(100)
def _functions(text: str, file: str, flags: int) -> dict[str, list[CodeType]]:
    """All functions of a file, by name."""
    flags |= ast.PyCF_ALLOW_TOP_LEVEL_AWAIT  # in the cell of a notebook
    named: dict[str, list[CodeType]] = {}
    for code in codes(compile(text, file, "exec", flags, dont_inherit=True)):
        named.setdefault(code.co_qualname, []).append(code)
    return named


def _without_places(code: CodeType) -> CodeType:
    """The same code at no line of its file."""
    constants = [_without_places(c) if isinstance(c, CodeType) else c for c in code.co_consts]
    return code.replace(co_firstlineno=1, co_linetable=b"", co_consts=tuple(constants))


def codes(code: CodeType) -> Iterator[CodeType]:
    """The byte code of a function and of the functions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def byte_code(code: CodeType) -> list[Any]:
    """What tells the byte code of a function, wherever it stands."""
    return [
        (
            c.co_code,
            c.co_flags,  # whether it has *args and the like
            c.co_varnames[: c.co_argcount + c.co_kwonlyargcount],
            c.co_names,
            c.co_freevars,
            [constant for constant in c.co_consts if not isinstance(constant, CodeType)],
        )
        for c in codes(code)
    ]


def constants(function: FunctionType) -> dict[str, Any]:
    """Values of the names that a function uses and its file binds in lines such as ``N = 3``."""
    try:
        known = _literals("".join(_lines(function.__code__)))
    except (OSError, TypeError, SyntaxError):
        return {}
    used = {name for code in codes(function.__code__) for name in code.co_names}
    return {name: function.__globals__.get(name) for name in sorted(used & known)}


@lru_cache(100)
def _literals(text: str) -> set[str]:
    """Names that a file gives a number or a string, and nothing else."""
    bound: dict[str, list[ast.expr | None]] = {}
    for statement in ast.parse(text).body:
        if isinstance(statement, ast.Assign):
            for target in statement.targets:
                if isinstance(target, ast.Name):
                    bound.setdefault(target.id, []).append(statement.value)
    return {name for name, values in bound.items() if all(map(_is_literal, values))}


def _is_literal(value: ast.expr | None) -> bool:
    return isinstance(value.operand if isinstance(value, ast.UnaryOp) else value, ast.Constant)
