"""What a stored result has to say about where it was computed: date, code, libraries, machine."""

import hashlib
import os
import platform
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scipy

from esfem_core.study.dependencies import PACKAGE

__all__ = ["environment", "source_hash"]


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


@cache
def _version() -> str:
    return version("esfem-core")


def environment(code: str | None = None) -> dict[str, str]:
    """Date (UTC), code, libraries and machine.

    Parameters
    ----------
    code : str, optional
        Hash of the code that computed the result, see
        :func:`esfem_core.study.user_code.code_of`; that of the whole package if None.

    Examples
    --------
    >>> list(environment())
    ['date', 'esfem_core', 'python', 'numpy', 'scipy', 'machine']
    """
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "esfem_core": f"{_version()}, source {code or _package()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "machine": f"{_processor()}, {os.cpu_count()} cores, {sys.platform}",
    }


@cache
def _processor() -> str:
    """Its name, where the system says it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text("utf8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
