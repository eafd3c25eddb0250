"""Numbers on disk for spreadsheets: CSV files that are whole up to the row before."""

import csv
import errno
import io
import math
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from esfem_core.checks import iterable, named, output_path, shown
from esfem_core.stepping import FULL, OwnFile, write_whole

__all__ = ["TableWriter", "save_table"]


class TableWriter:
    """Writes rows of numbers to a CSV file, each when it comes.

    Parameters
    ----------
    path : path
        Ends with ".csv"; a file that is there is replaced with the first row.

    Raises
    ------
    TypeError, ValueError, OSError
        If `path` is no path, does not end with ".csv", or is in a directory that does not exist or
        cannot be written to.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = TableWriter(f"{folder}/run.csv")
    ...     table.write({"t": 0.1, "centre": np.array([0.0, 0.5]), "amounts": {"u": 2.0}})
    ...     print(Path(folder, "run.csv").read_text())
    t,centre_0,centre_1,amounts_u
    0.1,0.0,0.5,2.0
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = output_path("path", path, (".csv",))
        self._own = OwnFile(self.path)
        self._columns: list[str] | None = None

    def write(self, row: Any) -> None:
        """Add a row.

        Parameters
        ----------
        row : NamedTuple or mapping of str to number, text, None, array or mapping
            Such as ``ec.measure(state)``. Arrays and mappings get a column for each entry; all
            digits are written.

        Raises
        ------
        TypeError, ValueError
            If it is neither, holds something else, has two columns of one name, or other columns
            than the first row.
        FileExistsError, FileNotFoundError
            If another run has written to the file since this writer was made, or has written, or
            it was removed.
        OSError
            If it cannot be written: the file is whole up to the row before.
        """
        self._write("row", row)

    def _write(self, called: str, row: Any) -> None:
        cells: dict[str, Any] = {}
        for name, entry in _cells(called, named(called, row)):
            if name in cells:
                raise ValueError(f"{called} must have different columns, got two called {name!r}")
            _check_for_utf8(called, name, name)
            _check_for_utf8(called, name, entry)
            cells[name] = entry
        if not cells:
            raise ValueError(f"{called} must have at least one column, got {shown(row)}")
        if self._columns is not None and self._columns != list(cells):
            raise ValueError(
                f"rows must all have the columns {', '.join(self._columns)}; got {', '.join(cells)}"
            )
        line = _line(cells.values())
        self._own.check()
        try:
            if self._columns is None:
                write_whole(self.path, (_line(cells) + line).encode())
            else:
                _append(self.path, line.encode())
        finally:
            self._own.written()
        self._columns = list(cells)


def save_table(path: str | os.PathLike[str], rows: Iterable[Any]) -> None:
    """Write rows of numbers to a CSV file as they come.

    Parameters
    ----------
    path : path
        Ends with ".csv".
    rows : iterable
        See :meth:`TableWriter.write`.

    Raises
    ------
    TypeError, ValueError
        If `path` ends otherwise, there is no row, or rows have different columns.
    FileNotFoundError, PermissionError
        If the directory does not exist, or cannot be written to.
    FileExistsError
        If another run has begun to write to the file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_table(f"{folder}/areas.csv", ({"t": t, "area": t**2} for t in (1.0, 2.0)))
    ...     print(Path(folder, "areas.csv").read_text())
    t,area
    1.0,1.0
    2.0,4.0
    """
    writer = TableWriter(path)
    empty = True
    for i, row in enumerate(iterable("rows", rows, "NamedTuples or mappings")):
        writer._write(f"rows[{i}]", row)
        empty = False
    if empty:
        raise ValueError("rows must hold at least one row, got none")


def _line(cells: Iterable[Any]) -> str:
    """A row as a line; csv puts text with a return in quotes only where it ends rows with one."""
    text = io.StringIO()
    csv.writer(text).writerow(cells)
    return text.getvalue().removesuffix("\r\n") + "\n"


def _append(path: Path, data: bytes) -> None:
    """Add to a file, all or nothing."""
    try:
        size = path.stat().st_size
    except FileNotFoundError as error:
        reason = "it was removed since its first row: take a new TableWriter"
        raise FileNotFoundError(error.errno, reason, str(path)) from None
    try:
        with path.open("ab", buffering=0) as file:
            if file.write(data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        with suppress(OSError):  # a file that cannot be written to was not begun
            os.truncate(path, size)
        advice = "make room" if error.errno in FULL else "see that it can be written to"
        reason = f"{error.strerror}; it is whole up to the row before: {advice}, and write again"
        raise OSError(error.errno, reason, str(path)) from error


def _cells(called: str, row: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    """Columns and their entries: numbers of Python, which csv writes with all digits, and text."""
    for key, value in row.items():
        name = _name(key)
        if isinstance(value, Mapping):
            yield from _cells(called, {f"{name}_{_name(of)}": entry for of, entry in value.items()})
        elif np.ma.isMaskedArray(value):
            raise TypeError(
                f"{called} must hold numbers, but {name!r} is masked: its holes have none"
            )
        elif isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim):
            if len(value) == 0:
                raise ValueError(f"{called} must hold a number or more in {name!r}, got none")
            yield from _cells(called, {f"{name}_{i}": entry for i, entry in enumerate(value)})
        else:
            yield name, _cell(called, name, value)


def _name(key: Any) -> str:
    """A name in a column; of a member of an Enum that is text, that text."""
    return str.__str__(key) if isinstance(key, str) else str(key)


def _cell(called: str, name: str, value: Any) -> Any:
    """An entry as csv writes it with all its digits."""
    dated = isinstance(value, np.generic | np.ndarray) and value.dtype.kind in "mM"
    # A date of NumPy is no number, but may become one.
    entry = value.item() if isinstance(value, np.generic | np.ndarray) and not dated else value
    for kind in (int, float):
        if isinstance(entry, kind) and not isinstance(entry, bool):
            return kind(entry)  # of an Enum not its name
    if dated or not isinstance(entry, Real | str | None):
        raise TypeError(
            f"{called} must hold real numbers, text or None, but {name!r} is {shown(value)}"
        )
    if not isinstance(entry, Real) or isinstance(entry, Integral | np.floating):
        return entry
    try:
        found = float(entry)  # programs take 1/3 for text or a date
    except OverflowError:
        found = math.inf
    if math.isinf(found):
        raise ValueError(
            f"{called} must hold numbers below 1.8e308, but {name!r} is {shown(value)}"
        )
    return found


def _check_for_utf8(called: str, column: str, entry: Any) -> None:
    """Refuse text that no file can hold."""
    try:
        if isinstance(entry, str):
            entry.encode()
    except UnicodeEncodeError:
        raise ValueError(
            f"{called} must hold text of whole characters, but column {column!r} has {entry!r}: "
            "half a character, which files cannot hold"
        ) from None
