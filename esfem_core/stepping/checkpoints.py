"""Runs that go on: saved and read back bit for bit.

What a run needs to go on are its last p states, with the products M w of conserved functions as
the scheme has them. A file holds the numbers only, nothing that is executed when it is read: the
problem, the order and the step are given again to :func:`esfem_core.evolve`.
"""

import inspect
import io
import json
import math
import os
import warnings
import zipfile
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from esfem_core.checks import items, level_outside, output_path, path_of, shown
from esfem_core.elements import SurfaceSpace
from esfem_core.stepping.files import OwnFile, write_whole
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.state import (
    EvolutionError,
    State,
    check_state,
    known_space,
    same_space,
)

__all__ = ["close_idle", "load", "save", "saving", "space_of"]

KIND, VERSION = "esfem_core states", 1
ENDED = "the run has ended: esfem_core.save(path, states) saves what was yielded, elsewhere"


def save(path: str | os.PathLike[str], states: Iterable[State] | State) -> None:
    """Save states, bit for bit, so that a run can go on from them.

    The file is a NumPy archive (npz) without pickled objects. At any moment, also if the disk is
    full or the process is killed, either the old file or the new one is there whole.

    Parameters
    ----------
    path : path
        Ends with ".npz".
    states : iterable of State, or one State
        Of one space, in the order of time: the last p of a run of order p, or more.

    Raises
    ------
    TypeError, ValueError
        If `path` does not end with ".npz", there are no states, or they do not fit together.
    FileNotFoundError, PermissionError
        If the directory does not exist, or cannot be written to.
    OSError
        If the file cannot be written; an older one is untouched.

    Examples
    --------
    >>> import tempfile
    >>> import esfem_core as ec
    >>> space, problem = ec.SurfaceSpace(ec.sphere("octahedron", 2)), ec.problems.growing_sphere()
    >>> states = list(ec.evolve(space, problem, order=2, step=0.1, end=0.5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ec.save(f"{folder}/run.npz", states[-2:])
    ...     space, states = ec.load(f"{folder}/run.npz")
    >>> *_, last = ec.evolve(space, problem, order=2, step=0.1, end=1.0, start=states)
    >>> last
    State(t=1, nodes=66, fields: u)
    """
    file = output_path("path", path, (".npz",))
    given = [states] if isinstance(states, State) else items("states", states, State)
    _write(file, space_of(given), given)


def load(path: str | os.PathLike[str]) -> tuple[SurfaceSpace, list[State]]:
    """Read what :func:`save` has written, bit for bit.

    Parameters
    ----------
    path : path

    Returns
    -------
    space : SurfaceSpace
        With the same nodes, elements and quadrature.
    states : list of State
        For ``evolve(..., start=states)``.

    Raises
    ------
    OSError
        If there is no such file, or the system cannot read it: too many are open, or it may not be.
    TypeError, ValueError
        If `path` is no path, or the file is damaged, compressed, another one or of a later version.

    Examples
    --------
    >>> import esfem_core as ec
    >>> folder = getfixture("tmp_path")
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron"))
    >>> ec.save(folder / "run.npz", [ec.State(0.5, space.nodes, space=space)])
    >>> space, states = ec.load(folder / "run.npz")
    >>> states[-1].t
    0.5
    """
    path = path_of("path", path, "a file")
    if not path.is_file():
        raise FileNotFoundError(f"path must be a file, but there is no file {str(path)!r}")
    data = path.read_bytes()  # what the system refuses here says nothing about the file
    try:
        header, arrays = _read(data)
        if header["kind"] != KIND:
            raise ValueError(f"it holds {shown(header['kind'])}")
        version = header["version"]
    except MemoryError:
        raise
    except Exception as error:  # damaged bytes make the readers of zip, npy and JSON raise anything
        raise ValueError(
            f"{str(path)!r} is damaged, or was not written by esfem_core.save: {error}"
        ) from error
    if type(version) is not int or version != VERSION:
        raise ValueError(
            f"{str(path)!r} has version {version} of the format, this is esfem_core for version "
            f"{VERSION}: read it with the esfem_core that wrote it"
        )
    try:
        return _rebuilt(header, arrays)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{str(path)!r} is damaged: {error}") from error


def saving(
    states: Iterator[State], path: Path, every: int, order: int, before: Sequence[State] = ()
) -> Generator[State, None, None]:
    """Hand on the states of a run, and save the last ones now and then.

    Saved are the last order + 1 states: one more than a run needs to go on, so that
    :func:`esfem_core.respaced` keeps its order. The first time is when the starting values are
    known, then after each `every` steps, and at the end or when the run fails or is left. A run
    that is left with break may be closed much later, when another one has gone on from its file:
    that one's states are not replaced then. What is known of states `before` those of the run is
    saved with them, so that a file does not lose them when a run goes on from it.

    Warns
    -----
    EvolutionWarning
        If the file cannot be written: the older one is untouched, and the run goes on.
    """
    last = deque(before, maxlen=order + 1)
    n = -order  # of the last step; at 0 the starting values are known
    saved: State | None = None
    own = OwnFile(path)

    def keep(then: str = f"the run goes on and tries again after {every} steps") -> None:
        nonlocal saved
        if n < 0 or not last or saved is last[-1]:
            return
        try:
            _write(path, space_of(list(last)), list(last))
        except OSError as error:
            held = "no state of this run" if saved is None else f"the states up to t = {saved.t:g}"
            there = f". It holds {held}" if path.exists() else ""
            warnings.warn(
                f"the states up to t = {last[-1].t:g} could not be saved ({error}){there}; {then}",
                EvolutionWarning,
                stacklevel=level_outside(),
            )
        else:
            saved = last[-1]
            own.written()

    try:
        for n, state in enumerate(states, start=1 - order):
            last.append(state)
            if n % every == 0:
                keep()
            yield state
    except EvolutionError as error:
        keep(ENDED)
        if saved is not None:
            error.add_note(
                f"{str(path)!r} holds the good states up to t = {saved.t:g}: space, states = "
                f"esfem_core.load({str(path)!r}), then evolve(..., start=states) goes on from them"
            )
        last.clear()  # do not try again
        raise
    except GeneratorExit:  # left with break, now or long ago
        if own.is_another():
            last.clear()
        raise
    finally:  # also if it is interrupted
        keep(ENDED)


def close_idle(states: Generator[State, None, None]) -> None:
    """Close a run, unless a thread that nobody waits for is in the middle of a step."""
    if inspect.getgeneratorstate(states) != inspect.GEN_RUNNING:
        states.close()


def space_of(states: Sequence[State]) -> SurfaceSpace:
    """The space of states that fit together."""
    given = items("states", states, State)
    spaces = [known_space(state, f"states[{i}]") for i, state in enumerate(given)]
    first, space = states[0], spaces[0]
    for i, state in enumerate(states):
        if not same_space(spaces[i], space):
            raise ValueError(
                f"states must belong to one space, but states[{i}] has another than states[0]; "
                "after remeshing, take those since then"
            )
        check_state(space, state, f"states[{i}]")
        shapes = {name: w.shape for name, w in state.fields.items()}
        if shapes != {name: w.shape for name, w in first.fields.items()}:
            raise ValueError(
                f"states must have the same functions, but states[{i}] has {_listed(state)} and "
                f"states[0] has {_listed(first)}"
            )
        if i and not state.t > states[i - 1].t:
            raise ValueError(
                f"states must be in the order of time, but t = {states[i - 1].t!r} is followed by "
                f"{state.t!r}"
            )
    return space


def _listed(state: State) -> str:
    return ", ".join(f"{name!r} {w.shape}" for name, w in state.fields.items()) or "none"


def _write(path: Path, space: SurfaceSpace, states: Sequence[State]) -> None:
    """The header says which arrays there are, so that none can be missing or too many."""
    arrays: dict[str, Any] = {"nodes": space.nodes, "cells": space.cells}
    listed = []
    for i, state in enumerate(states):
        names = {"fields": list(state.fields), "products": list(state.products)}
        known = {"t": state.t, "v": state.v is not None, "method": state.method}
        listed.append({**known, **names})
        arrays[f"{i}/x"] = state.x
        if state.v is not None:
            arrays[f"{i}/v"] = state.v
        for kind, values in (("fields", state.fields), ("products", state.products)):
            arrays |= {f"{i}/{kind}/{j}": w for j, w in enumerate(values.values())}
    header = {
        "kind": KIND,
        "version": VERSION,
        "exactness": space.rule.exactness,
        "boundary": len(space.boundary_nodes) > 0,
        "states": listed,
        "shapes": {name: array.shape for name, array in arrays.items()},
    }
    buffer = io.BytesIO()
    np.savez(buffer, header=np.array(json.dumps(header)), **arrays)
    write_whole(path, buffer.getvalue())


def _read(data: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays, each read to its end and its checksum."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        for member in file.infolist():  # a small file could make any amount of them
            if member.compress_type != zipfile.ZIP_STORED:
                raise ValueError(
                    f"its array {member.filename.removesuffix('.npy')} is compressed, which save "
                    "does not: numpy.savez(new, **numpy.load(old)) unpacks a file that you trust"
                )
        members = {name.removesuffix(".npy"): file.read(name) for name in file.namelist()}
    arrays = {name: _array(name, data) for name, data in members.items()}
    header = json.loads(str(arrays.pop("header")))
    return header, arrays


def _array(name: str, data: bytes) -> Any:
    """The array of a file .npy; room is made for what is there, not for what it says."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):  # others are for headers that no array of numbers has
        raise ValueError(f"array {name} has version {version} of the format npy, not (1, 0)")
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    said, there = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if said != there and not dtype.hasobject:
        raise ValueError(f"array {name} should have {said} bytes, but has {there}")
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def _rebuilt(header: dict[str, Any], arrays: dict[str, Any]) -> tuple[SurfaceSpace, list[State]]:
    """Space and states, checked like those of a user."""
    if unlike := sorted(arrays.keys() ^ header["shapes"].keys()):
        how = "not in its list" if unlike[0] in arrays else "missing"
        raise ValueError(f"array {unlike[0]} is {how}")
    for name, shape in header["shapes"].items():
        found, kind = arrays[name], np.int64 if name == "cells" else np.float64
        # Of either order of bytes: machines differ in that.
        if found.dtype.newbyteorder("=") != kind or list(found.shape) != shape:
            raise ValueError(f"{name} has type {found.dtype} and shape {found.shape}, not {shape}")
    space = SurfaceSpace.from_nodes(
        arrays["nodes"],
        arrays["cells"],
        header["exactness"],
        boundary=header.get("boundary", False),  # files of versions without boundaries
    )
    if not np.array_equal(space.cells, arrays["cells"]):
        raise ValueError("elements are oriented inwards, or against each other")
    states = []
    for i, one in enumerate(header["states"]):
        fields, products = (
            {name: arrays[f"{i}/{kind}/{j}"] for j, name in enumerate(one[kind])}
            for kind in ("fields", "products")
        )
        v = arrays[f"{i}/v"] if one["v"] else None
        x = arrays[f"{i}/x"]
        method = None if one["method"] is None else tuple(one["method"])
        states.append(
            State(one["t"], x, v, space=space, fields=fields, products=products, method=method)
        )
    space_of(states)
    return space, states
