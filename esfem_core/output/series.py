"""Runs on disk for ParaView, with curved elements.

A VTU file is written without a library, since that of VTK is large and meshio does not escape
names; both read it back in the tests.
"""

import base64
import math
import os
import re
import sys
import warnings
import zlib
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from esfem_core.checks import flag, iterable, level_outside, object_of, output_path
from esfem_core.elements import nodal_average
from esfem_core.stepping import (
    EvolutionWarning,
    OwnFile,
    State,
    check_state,
    known_space,
    write_whole,
)

__all__ = ["SeriesWriter", "save_series"]

LAGRANGE_TRIANGLE = 69  # VTK_LAGRANGE_TRIANGLE, of any degree
TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
BYTE_ORDER = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
NOT_IN_XML = re.compile("[\x00-\x1f\ud800-\udfff\ufffe\uffff]")  # or, as an end of a line, not kept
FAST = 1  # level of compression: floats hardly shrink, elements do at any level


class SeriesWriter:
    """Writes states for ParaView, each when it comes: in a loop what `save_series` is in one call.

    At any moment the PVD file lists states of one run, each in a whole file. A series that is there
    is shortened with the first state: to nothing, or with `go_on` to what comes before that state.
    The list is rewritten with each state: of runs of 100,000 steps, write one state in many.

    Parameters
    ----------
    path : path
        Ends with ".pvd"; the states go to files beside it, "run.pvd" to "run_00000.vtu" and so on.
    normals : bool
        Write unit normals at the nodes, too, as "normals".
    go_on : bool
        Keep what an earlier run has written of times before the first state that comes: of its
        files, all must be there, or are left out, and the last one is read.

    Raises
    ------
    TypeError, ValueError
        If `path` does not end with ".pvd", has characters that XML cannot hold, or is a link into
        another folder, or `go_on` meets a list that is damaged, or another one.
    FileNotFoundError, PermissionError
        If the directory does not exist, or cannot be written to.

    Examples
    --------
    >>> import tempfile
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     series = ec.SeriesWriter(f"{folder}/run.pvd")
    ...     for state in ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 0.3):
    ...         series.write(state)
    ...     sorted(os.listdir(folder))
    ['run.pvd', 'run_00000.vtu', 'run_00001.vtu', 'run_00002.vtu', 'run_00003.vtu']
    """

    def __init__(
        self, path: str | os.PathLike[str], *, normals: bool = False, go_on: bool = False
    ) -> None:
        self.path = output_path("path", path, (".pvd",))
        _check_for_xml("the name of path", self.path.stem)
        _check_one_folder(self.path)
        self._own = OwnFile(self.path)
        self._normals = flag("normals", normals)
        flag("go_on", go_on)
        self._before = _entries(self.path) if go_on and self.path.exists() else []
        self._lines = b""  # of the list, as written
        self._number = 0  # of the next file
        self._last: State | None = None

    def write(self, state: State) -> None:
        """Write a state; afterwards the series is complete up to it.

        Parameters
        ----------
        state : State
            Of a run, or with a space of its own. The space may be another than before, functions
            may not.

        Raises
        ------
        TypeError, ValueError
            If it is no state that knows its space, has other functions than the one before, also in
            a series that it goes on with, an earlier time, or a function with a name that XML
            cannot hold; or if the last file of a series that it goes on with is damaged, or that of
            the state write-protected.
        FileExistsError
            If another run has written to the series since this writer was made, or has written.
        OSError
            If a file cannot be written; the series is what it was, or at the first state what is
            kept of it.

        Warns
        -----
        EvolutionWarning
            If files of a series that it goes on with are gone: they are not listed any more.
        """
        arrays = self._point_data(state)
        self._own.check()
        if self._last is None:
            kept = _there(self.path, [entry for entry in self._before if entry[0] < state.t])
            if kept:
                _check_arrays(self.path.parent / kept[-1][1], state.t, arrays)
            self._lines = b"".join(_line(*entry) for entry in kept)
            self._number = _first_free(self.path.stem, (name for _, name in kept))
        name = f"{self.path.stem}_{self._number:05d}.vtu"
        lines = self._lines + _line(state.t, name)
        file = output_path("the file of a state", self.path.with_name(name), (".vtu",))
        if self._last is None and self.path.exists():
            # Its list must not name files of this run for those of another.
            write_whole(self.path, _pvd(self._lines))
            self._own.written()
        write_whole(file, _vtu(state, arrays))
        write_whole(self.path, _pvd(lines))
        self._own.written()
        self._lines, self._number, self._last = lines, self._number + 1, state

    def _point_data(self, state: State) -> dict[str, NDArray[Any]]:
        space = known_space(state)
        check_state(space, state)
        last = self._last or state
        if _functions(state) != _functions(last):
            raise ValueError(
                f"states of a series must have the same functions, but that of t = {state.t:g} "
                f"has {_functions(state)}, the one before {_functions(last)}"
            )
        if state.t < last.t:
            raise ValueError(f"states must come in the order of time, got {state.t} after {last.t}")
        # Programs want each array at all times, and starting states have no velocity.
        velocity = np.full_like(state.x, np.nan) if state.v is None else state.v
        more = {"v": velocity}
        if self._normals:
            at = state.surface()
            normals = nodal_average(at, at.normal)
            more["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        for name in more:
            if name in state.fields:
                raise ValueError(f"a function must not be called {name!r}: that is written, too")
        for name in state.fields:
            _check_for_xml("the name of a function", name)
        return {**state.fields, **more}


def save_series(
    path: str | os.PathLike[str],
    states: Iterable[State],
    *,
    normals: bool = False,
    go_on: bool = False,
) -> State:
    """Write states for ParaView as they come: one VTU file each, and a PVD file with their times.

    The elements are true Lagrange triangles of the degree of the space, with all functions and the
    velocity "v" as point data (NaN in starting states, which have none); VTU files carry their
    time, too. After each state the files on disk are whole and complete up to it, so that a run can
    be watched, or killed.

    Parameters
    ----------
    path : path
        Ends with ".pvd"; the states go to files beside it, "run.pvd" to "run_00000.vtu" and so on.
    states : iterable of State
        For example ``ec.evolve(...)`` itself, which is run to its end. To do more with the states
        of a run, write each in a loop with :class:`SeriesWriter`.
    normals : bool
        Write unit normals at the nodes, too, as "normals".
    go_on : bool
        Keep what an earlier run has written of times before the first state, for a run that goes on
        from :func:`esfem_core.load`.

    Returns
    -------
    State
        The last one.

    Raises
    ------
    TypeError, ValueError
        If `path` does not end with ".pvd", there are no states, one knows no space, has other
        functions than the one before or an earlier time, or `go_on` meets a list, or a last file,
        that is damaged or another one.
    FileNotFoundError, PermissionError
        If the directory does not exist, or cannot be written to.
    FileExistsError
        If another run has begun to write to the series.
    OSError
        If a file cannot be written; the series is complete up to the state before.

    Warns
    -----
    EvolutionWarning
        If files of a series that it goes on with are gone: they are not listed any more.

    Examples
    --------
    >>> import tempfile
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 3, ec.to_unit_sphere)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 0.3)
    ...     last = ec.save_series(f"{folder}/run.pvd", run)
    >>> last
    State(t=0.3, nodes=578, fields: u)
    """
    writer = SeriesWriter(path, normals=normals, go_on=go_on)
    last: State | None = None
    several = [states] if isinstance(states, State) else iterable("states", states, "States")
    for i, state in enumerate(several):
        writer.write(object_of(f"states[{i}]", state, State))
        last = state
    if last is None:
        raise ValueError("states must hold at least one state, got none")
    return last


def _functions(state: State) -> str:
    """Names and shapes of the functions of a state, as a message shows them."""
    return ", ".join(f"{n!r} {('N', *w.shape[1:])}" for n, w in state.fields.items()) or "none"


def _check_arrays(file: Path, t: float, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Refuse to go on from a VTU file that cannot be read, or has other arrays."""
    try:
        listed = ElementTree.parse(file).iterfind(".//PointData/DataArray")
        before = {e.get("Name", ""): int(e.get("NumberOfComponents", 1)) for e in listed}
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(
            f"the series lists {str(file)!r}, which cannot be read ({error}); start with an "
            "earlier state, or take its line out of the list"
        ) from error
    now = {name: values[0].size for name, values in arrays.items()}
    if now != before:
        raise ValueError(
            f"states of a series must have the same functions, but for that of t = {t:g} there are "
            f"{_components(now)}, and in {str(file)!r} {_components(before)}"
        )


def _components(arrays: Mapping[str, int]) -> str:
    return ", ".join(f"{name!r} ({count})" for name, count in arrays.items())


def _check_for_xml(name: str, text: str) -> None:
    """Refuse a name that no reader of the file would get back."""
    if not text or NOT_IN_XML.search(text):
        raise ValueError(f"{name} must be of characters that XML can hold, got {text!r}")


def _first_free(stem: str, names: Iterable[str]) -> int:
    """A number larger than those of all these files.

    Examples
    --------
    >>> _first_free("run", ["run_00001.vtu", "run_00002.vtu", "other_00007.vtu"])
    3
    """
    found = (re.fullmatch(rf"{re.escape(stem)}_(\d+)\.vtu", name) for name in names)
    return max((int(number[1]) for number in found if number), default=-1) + 1


def _check_one_folder(path: Path) -> None:
    """Refuse a link to a list elsewhere: from both places, its files would have to be beside it."""
    there = Path(os.path.realpath(path))
    if there.parent != Path(os.path.realpath(path.parent)):
        raise ValueError(
            f"path must be no link into another folder, got {str(path)!r}, where it is "
            f"{str(there)!r}: give that path, the files of the states go beside it"
        )


def _there(path: Path, entries: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """The entries of a series whose files are there."""
    there = [entry for entry in entries if os.path.isfile(path.parent / entry[1])]
    if len(there) < len(entries):
        gone = [name for _, name in sorted({*entries} - {*there})]
        more = f" and {len(gone) - 3} more" if len(gone) > 3 else ""
        warnings.warn(
            f"{str(path)!r} lists files that are gone: {', '.join(gone[:3])}{more}; the series "
            "goes on without them",
            EvolutionWarning,
            stacklevel=level_outside(),
        )
    return there


def _entries(path: Path) -> list[tuple[float, str]]:
    """Times and files of a series."""
    try:
        root = ElementTree.parse(path).getroot()
        if root.tag != "VTKFile" or root.get("type") != "Collection":
            raise ValueError(f"it holds <{root.tag}> and no collection of VTK files")
        found = [(float(e.attrib["timestep"]), e.attrib["file"]) for e in root.iter("DataSet")]
        if not all(math.isfinite(t) for t, _ in found):
            raise ValueError("a time in it is not finite")
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"{str(path)!r} is damaged, or no series: {error}") from error
    if any(e.get("part", "0") != "0" or e.get("group") for e in root.iter("DataSet")):
        raise ValueError(
            f"{str(path)!r} lists parts or groups, as esfem_core does not: they would be lost; "
            "choose another path"
        )
    return found


def _line(t: float, name: str) -> bytes:
    return f'    <DataSet timestep="{t!r}" part="0" file="{escape(name)}"/>\n'.encode()


def _pvd(lines: bytes) -> bytes:
    head = f'<VTKFile type="Collection" version="1.0" byte_order="{BYTE_ORDER}">\n  <Collection>\n'
    return f'<?xml version="1.0"?>\n{head}'.encode() + lines + b"  </Collection>\n</VTKFile>\n"


def _vtu(state: State, point_data: Mapping[str, NDArray[Any]]) -> bytes:
    space = known_space(state)
    n_cells, n = space.cells.shape
    data = [
        '<?xml version="1.0"?>',
        f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{BYTE_ORDER}" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">',
        "<UnstructuredGrid>",
        "<FieldData>",
        _data_array("TimeValue", np.array([state.t])),
        "</FieldData>",
        f'<Piece NumberOfPoints="{len(state.x)}" NumberOfCells="{n_cells}">',
        "<Points>",
        _data_array("Points", state.x),
        "</Points>",
        "<Cells>",
        _data_array("connectivity", space.cells.ravel()),
        _data_array("offsets", n * np.arange(1, n_cells + 1)),
        _data_array("types", np.full(n_cells, LAGRANGE_TRIANGLE, np.uint8)),
        "</Cells>",
        "<PointData>",
        *(_data_array(name, values) for name, values in point_data.items()),
        "</PointData>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    return "\n".join(data).encode()


def _data_array(name: str, values: NDArray[Any]) -> str:
    """One block of compressed data: number of blocks, sizes of a full and of the last one."""
    raw = values.tobytes()
    packed = zlib.compress(raw, FAST)
    head = np.array([1, len(raw), 0, len(packed)], np.uint64).tobytes()
    text = base64.b64encode(head) + base64.b64encode(packed)
    components = f'NumberOfComponents="{values.shape[1]}" ' if values.ndim == 2 else ""
    size = f'NumberOfTuples="{len(values)}" ' if name == "TimeValue" else ""
    return (
        f'<DataArray type="{TYPES[values.dtype.str[1:]]}" Name="{escape(name)}" {components}{size}'
        f'format="binary">\n{text.decode()}\n</DataArray>'
    )
