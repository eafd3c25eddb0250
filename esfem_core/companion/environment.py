"""What a stored result has to say about where it was computed: date, code, libraries, machine."""

import hashlib
import os
import platform
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from esfem_core.companion.dependencies import code_hash

__all__ = ["code_of", "environment", "source_hash"]

PACKAGE = Path(__file__).parents[1]


def source_hash(package: str | Path = PACKAGE) -> str:
    """Hash of the package's Python files, with their names, in all its folders.

    Parameters
    ----------
    package : path
        The folder ``esfem_core``, of the package that is imported by default.

    Returns
    -------
    str
        Twelve hexadecimal digits.

    Raises
    ------
    ValueError
        If there is no Python file.

    Examples
    --------
    >>> len(source_hash())
    12
    """
    package = Path(package)
    # Strings and not paths are sorted: their order is the same on every system.
    files = {path.relative_to(package).as_posix(): path for path in package.rglob("*.py")}
    if not files:
        raise ValueError(f"there is no Python file in {package}")
    source = hashlib.sha256()
    for name in sorted(files):
        source.update(name.encode() + b"\0")
        source.update(hashlib.sha256(files[name].read_bytes()).digest())
    return source.hexdigest()[:12]


@cache
def _package() -> str:
    """Hash of the package, once per process: what is loaded stays when a file is edited."""
    return source_hash()


def code_of(function: Callable[..., Any]) -> str:
    """Hash of the code that decides what a function returns: "this code" of a stored result.

    For a function of this package it is the code that the function reaches, see
    :mod:`esfem_core.companion.dependencies`; for any other one, the whole package.
    """
    inside = function.__module__.partition(".")[0] == PACKAGE.name
    return code_hash(function) if inside else _package()


def environment(function: Callable[..., Any] | None = None) -> dict[str, str]:
    """Date (UTC), code, libraries and machine.

    Parameters
    ----------
    function : callable, optional
        What computed the result; "esfem_core" has the hash of its code, or of the whole package if
        None.

    Examples
    --------
    >>> list(environment())
    ['date', 'esfem_core', 'python', 'numpy', 'scipy', 'machine']
    """
    code = _package() if function is None else code_of(function)
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "esfem_core": f"{version('esfem-core')}, source {code}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "machine": f"{_processor()}, {os.cpu_count()} cores, {sys.platform}",
    }


def _processor() -> str:
    """Its name, where the system says it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text("utf8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
