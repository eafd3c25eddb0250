"""Finished cases, one line of a file each.

A file can be written by several processes at once, which can be killed at any moment: a line is
appended whole or cut off by the next writer. What the parameters are decides which case a line is,
and the last one of a case counts; who has renewed cases leaves, at the end, a new file without the
lines that do not count.
"""

import hashlib
import json
import os
import shlex
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from esfem_core.checks import items, path_of, shown
from esfem_core.stepping import FULL, write_whole
from esfem_core.study.locks import FileLocks

__all__ = [
    "Row",
    "Store",
    "UnsavedRowsError",
    "case_key",
    "plain",
    "read",
    "reason_of",
    "select",
    "set_aside",
]

TAIL = 2**16  # bytes before its end that tell whether a file is still the one that was read
BEGINNING = b'{"parameters": '  # of a line
UTF_16 = "it is text in UTF-16: save it as UTF-8"
OTHERS = {b"\x1f\x8b": "it is compressed: unpack it", b"\xff\xfe": UTF_16, b"\xfe\xff": UTF_16}
LARGEST = 1024  # bits of an integer, as many as floats can have: what Python writes is limited, too

Parameters = Mapping[str, Any]
Results = Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """One finished case.

    Attributes
    ----------
    parameters, results : dict
        JSON values.
    provenance : dict
        "seconds", and what :func:`esfem_core.study.environment.environment` says of the function
        that computed it.
    """

    parameters: Parameters
    results: Results
    provenance: Mapping[str, Any]

    @property
    def code(self) -> str:
        """Hash of the code that made it."""
        return str(self.provenance.get("esfem_core", "")).partition(", source ")[2]


class UnsavedRowsError(OSError):
    """Finished rows could not be written.

    Attributes
    ----------
    rows : list of Row
    """

    def __init__(self, message: str, rows: list[Row]) -> None:
        super().__init__(message)
        self.rows = rows

    def __reduce__(self) -> tuple[object, ...]:  # for pools: exceptions are pickled by their text
        return type(self), (str(self), self.rows), vars(self)


def plain(name: str, value: Any, *, arrays: bool = True) -> Any:
    """A value as JSON can hold it: NumPy's scalars as numbers, its arrays as lists.

    Parameters
    ----------
    name : str
        What the message calls it.
    value : object
        Named tuples become dicts, other tuples lists. NaN and infinity stay what they are.
    arrays : bool
        Whether it may hold arrays.

    Raises
    ------
    TypeError, ValueError
        If it, or something in it, has no such form, or is an integer of more than 1024 bits.

    Examples
    --------
    >>> plain("results", {"n": np.int64(3), "x": np.eye(2), "pair": (1.5, None)})
    {'n': 3, 'x': [[1.0, 0.0], [0.0, 1.0]], 'pair': [1.5, None]}
    >>> plain("results", {"n": [1j]})
    Traceback (most recent call last):
        ...
    TypeError: results['n'][0] must be a number, a string, a boolean, None, an array, or a list or
    a dict of those with strings as keys, got 1j
    """
    if np.ma.isMaskedArray(value):
        raise TypeError(f"{name} must hold numbers, but is masked: its holes have none")
    if isinstance(value, np.ndarray) and value.dtype.kind in "mMV":  # dates turn into integers
        raise TypeError(f"{name} must hold numbers or strings, got an array of {value.dtype}")
    if isinstance(value, np.generic):
        if value.dtype.kind in "biufU":
            value = float(value) if value.dtype.kind == "f" else value.item()
    elif isinstance(value, np.ndarray) and (arrays or not value.ndim):
        value = value.astype(float).tolist() if value.dtype.kind == "f" else value.tolist()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int) and value.bit_length() > LARGEST:
        raise ValueError(
            f"{name} must be an integer of at most {LARGEST} bits, got one of {value.bit_length()}"
        )
    for kind in (int, float):
        if isinstance(value, kind):
            return kind(value)
    if isinstance(value, str):
        return str.__str__(value)  # of an Enum not its name, as str(value) would give
    if hasattr(value, "_asdict") and not isinstance(value, type):
        value = value._asdict()
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {
            str.__str__(key): plain(f"{name}[{key!r}]", entry, arrays=arrays)
            for key, entry in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(f"{name}[{i}]", entry, arrays=arrays) for i, entry in enumerate(value)]
    raise TypeError(
        f"{name} must be a number, a string, a boolean, None, {'an array, ' * arrays}or a list or "
        f"a dict of those with strings as keys, got {shown(value)}"
    )


def case_key(parameters: Parameters) -> str:
    """What tells cases apart: their parameters, in whatever order.

    Examples
    --------
    >>> case_key({"b": 1, "a": [0.5]}) == case_key({"a": [0.5], "b": 1.0})
    True
    """
    return json.dumps(_counted(parameters), sort_keys=True)


def _counted(value: Any) -> Any:
    """The same with integers for floats that are integers."""
    if isinstance(value, Mapping):
        return {key: _counted(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_counted(entry) for entry in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def read(path: str | Path) -> list[Row]:
    """The finished cases in a file; none if there is no such file yet.

    Of several rows of a case, as after two files were put together, the last one counts.

    Parameters
    ----------
    path : path
        Of a file that a study has written, named after its function.

    Returns
    -------
    list of Row
        In the order in which the cases came first.

    Raises
    ------
    TypeError
        If it is no path.
    ValueError
        If it is a folder, or a line is not a row. (A line that is the beginning of one is what a
        killed process leaves; it is not read.)

    Examples
    --------
    >>> from esfem_core.study import run
    >>> folder = getfixture("tmp_path")
    >>> def square(side):
    ...     return {"area": side**2}
    >>> _ = run([{"side": 2}, {"side": 3}], square, folder, workers=0, progress=False)
    >>> [row.results["area"] for row in read(folder / "square.jsonl")]
    [4, 9]
    """
    path = path_of("path", path, "a file")
    if path.is_dir():
        raise ValueError(f"path must be a file, but {str(path)!r} is a directory")
    rows = _parse(path, path.read_bytes())[0] if path.exists() else []
    return list({case_key(row.parameters): row for row in rows}.values())


def select(rows: Iterable[Row], **parameters: Any) -> list[Row]:
    """Rows with these parameters; values are the same that are the same case.

    None finds rows without the parameter, too: what was not given had its default.

    Parameters
    ----------
    rows : iterable of Row
    **parameters
        Values of some of their parameters.

    Returns
    -------
    list of Row

    Examples
    --------
    >>> rows = [Row({"order": p, "step": s}, {}, {}) for p in (1, 2) for s in (0.1, 0.05)]
    >>> [row.parameters["step"] for row in select(rows, order=2)]
    [0.1, 0.05]
    """
    wanted = {name: plain(name, value) for name, value in parameters.items()}
    key = case_key(wanted)
    found = items("rows", rows, Row, 0)
    return [row for row in found if case_key({n: row.parameters.get(n) for n in wanted}) == key]


def _parse(path: Path, data: bytes) -> tuple[list[Row], int]:
    """Rows of a file, and how many of its bytes they are."""
    *lines, last = data.split(b"\n")
    left_over = len(last) if _is_cut_off(last) else 0
    if not left_over:
        lines.append(last)  # whole, but for its end
    rows = []
    for number, line in enumerate(lines, start=1):
        try:
            if line.strip():
                rows.append(_row(line))
        except ValueError as error:
            if line.startswith(BEGINNING) and _is_cut_off(line):  # others were put after it
                continue
            raise ValueError(f"{path} is not a file of results: line {number}: {error}") from None
    return rows, len(data) - left_over


def _is_cut_off(line: bytes) -> bool:
    """Whether a line is the beginning of a row, or zeros, as after a failure of power.

    Of a row that something else has spoilt, such as lost ends of lines, this is not said.
    """
    found = line.rstrip(b"\0")
    if not found.startswith(BEGINNING):
        return BEGINNING.startswith(found)
    text = found.decode(errors="replace")
    try:
        json.loads(text)
    except json.JSONDecodeError as error:
        at_end = error.pos > len(text) - len("-Infinity") and error.msg != "Extra data"
        return at_end or error.msg.startswith("Unterminated string")
    except ValueError:  # an integer that is too long
        return False
    return found != line


def _row(line: bytes) -> Row:
    for mark, what in OTHERS.items():
        if line.startswith(mark):
            raise ValueError(what)
    try:
        found = json.loads(line)
    except ValueError as error:
        if isinstance(error, json.JSONDecodeError) and line.startswith(BEGINNING):
            raise ValueError(f"it is no JSON: {error.msg}, character {error.pos + 1}") from None
        beginning = line[:20].decode(errors="replace")  # such as a mark of a merge
        raise ValueError(f"it is no JSON, but begins with {beginning!r}") from None
    if not isinstance(found, dict) or set(found) != {"parameters", "results", "provenance"}:
        raise ValueError("it must hold parameters, results and provenance")
    if not all(isinstance(part, dict) for part in found.values()):
        raise ValueError("parameters, results and provenance must be dicts")
    return Row(**found)


def _line(row: Row) -> bytes:
    return json.dumps(vars(row)).encode() + b"\n"


class Store:
    """The file of rows of one study, for this process and for others at the same time.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ValueError
        If it is not a file of rows.
    OSError
        If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()  # what is replaced is the file, and not a link to it
        if path.is_dir():
            raise IsADirectoryError(
                f"the results belong into the file {str(path)!r}, but this is a folder: move it, "
                "or give the study another name or folder"
            )
        self._claimed: set[str] = set()
        self._began = self._renewed = False
        self._forget()
        self._refresh()
        self._locks = FileLocks(self.path.with_name(f".{self.path.name}.lock"))

    def find(self, parameters: Parameters) -> Row | None:
        """A copy of the row of a case, if the file has one now."""
        self._refresh()
        return deepcopy(self._rows.get(case_key(parameters)))

    def claim(self, parameters: Parameters) -> bool:
        """Reserve a case; False if someone else, or this process, computes it already.

        Raises
        ------
        OSError
            If nothing can be written into the folder, or, at the first case, into the file.
        """
        key = case_key(parameters)
        if key in self._claimed or not self._locks.take(_number(key)):
            return False
        if not self._began and self.path.exists():
            self.path.open("ab").close()
        self._began = True
        self._claimed.add(key)
        return True

    def release(self, parameters: Parameters) -> None:
        """Let others compute a case."""
        key = case_key(parameters)
        self._claimed.discard(key)
        self._locks.give_back(_number(key))

    def put(self, row: Row) -> Row:
        """Write a row, also where other code has made one of the same case.

        Returns
        -------
        Row
            What the file has now: another one if someone else was faster.

        Raises
        ------
        OSError
            If it cannot be written; the file is then what it was.
        """
        with self._locks.writing():
            self._refresh()
            key = case_key(row.parameters)
            old = self._rows.get(key)
            if old and old.code == row.code:
                return deepcopy(old)
            self._append(key, _line(row))
            self._renewed |= bool(old)
        return row

    def close(self) -> None:
        """Release all cases."""
        if self._renewed:
            with suppress(OSError, ValueError):  # it has all rows, also as it is
                self._compact()
        self._locks.close()

    def _forget(self) -> None:
        """Know nothing of the file."""
        self._rows: dict[str, Row] = {}
        self._seen: tuple[int, ...] = ()
        self._end, self._tail = 0, b""  # of that part of the file of which the rows are known

    def _refresh(self) -> None:
        """Read the file if it has changed."""
        try:
            if _look(self.path.stat()) == self._seen:
                return
            with self.path.open("rb", buffering=0) as file:
                self._take(file)
        except FileNotFoundError:
            self._forget()

    def _take(self, file: FileIO) -> None:
        """Take in what the file holds now; rows are most of the work, and looked at once.

        That others have written the file anew is seen by its number, or by what is no longer there.
        """
        seen = _look(os.fstat(file.fileno()))
        if seen[:1] != self._seen[:1] or not self._tail.endswith(b"\n"):
            self._forget()
        file.seek(self._end - len(self._tail))
        data = file.read()
        if not data.startswith(self._tail):
            self._forget()
            file.seek(0)
            data = file.read()
        new = data[len(self._tail) :]
        try:
            rows, size = _parse(self.path, new)
        except ValueError:
            file.seek(0)
            _parse(self.path, file.read())  # tells the number of the line
            raise
        self._know({case_key(row.parameters): row for row in rows}, new[:size], seen)

    def _know(self, rows: Mapping[str, Row], data: bytes, seen: tuple[int, ...]) -> None:
        """Add the next bytes of the file to those of which the rows are known."""
        self._rows.update(rows)
        self._end += len(data)
        self._tail = (self._tail + data)[-TAIL:]
        self._seen = seen

    def _append(self, key: str, line: bytes) -> None:
        """Add a line, whole or not at all, after the last row."""
        with self.path.open("a+b", buffering=0) as file:
            self._take(file)
            end = self._end
            file.truncate(end)
            row = _row(line)  # as anyone who reads it
            if end and not self._tail.endswith(b"\n"):
                line = b"\n" + line
            try:
                _write(file.fileno(), line)
            except BaseException:
                file.truncate(end)
                raise
            self._know({key: row}, line, _look(os.fstat(file.fileno())))

    def _compact(self) -> None:
        """Leave out the lines that do not count."""
        with self._locks.writing():
            self._forget()  # nothing is taken from memory
            self._refresh()
            if not self._rows:  # the file is gone
                return
            write_whole(self.path, b"".join(map(_line, self._rows.values())))


def _look(status: os.stat_result) -> tuple[int, ...]:
    """What is another when a file has changed; first of all, which file it is."""
    return status.st_ino, status.st_size, status.st_mtime_ns


def _write(file: int, data: bytes) -> None:
    """Write all of it, to the disk."""
    while data:
        data = data[os.write(file, data) :]
    os.fsync(file)


def _number(key: str) -> int:
    """A lock for a case; 0 is not among them."""
    return 1 + int.from_bytes(hashlib.sha256(key.encode()).digest()[:7], "big")


def reason_of(error: Exception) -> str:
    """What a message says of an error: no number of the system, and no path a second time."""
    return getattr(error, "strerror", None) or str(error)


def set_aside(unsaved: list[tuple[Store, Row]], reason: Exception) -> UnsavedRowsError:
    """Write rows that have no room where they belong to another place; what to tell of it."""
    rows = [row for _, row in unsaved]
    text = f"{len(rows)} finished rows could not be written ({reason_of(reason)})"
    try:
        folder = Path(tempfile.mkdtemp(prefix="esfem-study-"))
        advice = []
        for store in dict.fromkeys(store for store, _ in unsaved):
            lines = b"".join(_line(row) for other, row in unsaved if other is store)
            # It begins with an end of line, in case the other file does not end with one.
            (folder / store.path.name).write_bytes(b"\n" + lines)
            paths = (shlex.quote(str(path)) for path in (folder / store.path.name, store.path))
            advice.append("cat {} >> {}".format(*paths))
        text += f". They are kept; {_help(reason)}, then: {'; '.join(advice)}"
    except OSError:
        text += ", nowhere; this error has them in its `rows`"
    return UnsavedRowsError(text, rows)


def _help(reason: Exception) -> str:
    """What must be done before rows can be written again."""
    if isinstance(reason, OSError):
        return "make room" if reason.errno in FULL else "see that the file can be written"
    return "put the file in order"
