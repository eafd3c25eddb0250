"""Runs that go on: saved and read back bit for bit, or with another step.

What a run needs to go on are its last p states, with the products M w of conserved functions as
the scheme has them. A file holds the numbers only, nothing that is executed when it is read: the
problem, the order and the step are given again to :func:`esfem_core.evolve`.
"""

import inspect
import io
import json
import os
import warnings
import zipfile
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from esfem_core.checks import (
    Array,
    items,
    number,
    output_path,
    path_of,
    shown,
    whole_number,
)
from esfem_core.elements import SurfaceSpace
from esfem_core.solvers import DirectSolver, superlu
from esfem_core.stepping.bdf import MOST_STEPS, combine
from esfem_core.stepping.files import write_whole
from esfem_core.stepping.guard import EvolutionWarning, level_outside
from esfem_core.stepping.state import (
    EvolutionError,
    Method,
    State,
    check_state,
    known_space,
    same_space,
)
from esfem_core.stepping.times import later

__all__ = ["close_idle", "load", "respaced", "save", "saving", "space_of"]

KIND, VERSION = "esfem_core states", 1
MOST = 6  # states that are made for another step, unless an order asks for more
SAME_TIME = 1e-9  # relative to the step
ROUNDING = 1e-3  # of times, relative to the step
OWN_MASS = 1e-10  # how well, relatively, a product is M(x) w for the positions x of its own state
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
    FileNotFoundError, PermissionError
        If there is no such file, or it may not be read.
    ValueError
        If the file is damaged or another one, or of a later version.
    """
    path = path_of("path", path, "a file")
    if not path.is_file():
        raise FileNotFoundError(f"path must be a file, but there is no file {str(path)!r}")
    try:
        header, arrays = _read(path)
        if header["kind"] != KIND:
            raise ValueError(f"it holds {shown(header['kind'])}")
        version = header["version"]
    except (PermissionError, MemoryError):  # neither says anything about the file
        raise
    except Exception as error:  # damaged bytes make the readers of zip, npy and JSON raise anything
        raise ValueError(
            f"{str(path)!r} is damaged, or was not written by esfem_core.save: {error}"
        ) from error
    if version != VERSION:
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
    :func:`respaced` keeps its order. The first time is when the starting values are known, then
    after each `every` steps, and at the end or when the run fails or is left. A run that is left
    with break may be closed much later, when another one has gone on from its file: that one's
    states are not replaced then. What is known of states `before` those of the run is saved with
    them, so that a file does not lose them when a run goes on from it.

    Warns
    -----
    EvolutionWarning
        If the file cannot be written: the older one is untouched, and the run goes on.
    """
    last = deque(before, maxlen=order + 1)
    n = -order  # of the last step; at 0 the starting values are known
    saved: State | None = None
    found = _identity(path)  # the file as this run has found it, or has written it

    def keep(then: str = f"the run goes on and tries again after {every} steps") -> None:
        nonlocal saved, found
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
            saved, found = last[-1], _identity(path)

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
        if _identity(path) not in (found, None):
            last.clear()
        raise
    finally:  # also if it is interrupted
        keep(ENDED)


def close_idle(states: Generator[State, None, None]) -> None:
    """Close a run, unless a thread that nobody waits for is in the middle of a step."""
    if inspect.getgeneratorstate(states) != inspect.GEN_RUNNING:
        states.close()


def _identity(path: Path) -> tuple[int, int, int] | None:
    """What tells the file that is there from any that takes its place; None if there is none."""
    try:
        file = path.stat()
    except OSError:
        return None
    return file.st_ino, file.st_mtime_ns, file.st_size


def respaced(states: Sequence[State], step: float, order: int | None = None) -> list[State]:
    """States with another step between them, to go on with: the last one stays what it is.

    Positions and functions are interpolated in time by polynomials through the states nearest to
    each new time. Of conserved functions w it is the amounts M w that are interpolated, so that
    their sums stay exactly what they are; where M is the mass matrix of the state's own surface
    (mass="updated"), w then solves M(x) w = (interpolated amounts). So from p + 1 states, whose
    interpolation has an error O(tau^{p+1}), a run of order p goes on with its order; p states,
    with O(tau^p), do as well, with larger errors of v in the first steps.

    Parameters
    ----------
    states : sequence of State
        Of one space, in the order of time, not necessarily a step apart. They must reach back
        over the p - 1 new steps before the last one.
    step : float
        The new step.
    order : int, optional
        Order p of the run that goes on: exactly p states are made, from p + 1 of the given ones
        each. If not given, all that the given ones reach back for, six at most, from seven each;
        `evolve` takes the last p.

    Returns
    -------
    list of State
        For ``evolve(..., step=step, start=states)``; v is None in new ones.

    Raises
    ------
    TypeError, ValueError
        If the states do not fit together, or do not reach back far enough, or if the step is lost
        in the rounding of the times.

    Examples
    --------
    A run of order 2 goes on with a third of its step:

    >>> import esfem_core as ec
    >>> space, problem = ec.SurfaceSpace(ec.sphere("octahedron", 2)), ec.problems.growing_sphere()
    >>> states = list(ec.evolve(space, problem, order=2, step=0.3, end=0.9))
    >>> start = ec.respaced(states[-3:], 0.1, order=2)
    >>> [state.t for state in start]
    [0.8, 0.9]
    >>> *_, last = ec.evolve(space, problem, order=2, step=0.1, end=1.0, start=start)
    """
    given = items("states", states, State)
    space = space_of(given)
    step = number("step", step, above=0)
    if abs(given[-1].t - later(given[-1].t, -step) - step) > ROUNDING * step:
        raise ValueError(
            f"step must be larger against the time, t = {given[-1].t:g}, got {step:g}: the times "
            "of such steps are not told apart"
        )
    p = None if order is None else whole_number("order", order, 1, MOST_STEPS)
    nearest = MOST + 1 if p is None else p + 1
    times = [given[-1].t]
    while len(times) < (p or MOST) and later(times[-1], -step) > given[0].t - SAME_TIME * step:
        times.append(later(times[-1], -step))
    if p is not None and len(times) < p:
        raise ValueError(
            f"states must reach back to t = {given[-1].t - (p - 1) * step:g} for order {p} and "
            f"step {step:g}, but the first is of t = {given[0].t:g}: give more of the last states, "
            "or take a smaller step"
        )
    found = [_at_time(space, given, t, step, nearest) for t in reversed(times)]
    return [_for_step(state, given[-1].method, p, step) for state in found]


def _for_step(state: State, method: Method | None, order: int | None, step: float) -> State:
    """The state, its products belonging to the method with another step."""
    if method is not None:
        method = (method[0], order or method[1], step)
    if not state.products or state.method == method:
        return state
    return State(
        state.t,
        state.x,
        state.v,
        space=state.space,
        fields=state.fields,
        products=state.products,
        method=method,
    )


def _at_time(
    space: SurfaceSpace, states: Sequence[State], t: float, step: float, nearest: int
) -> State:
    """The state at a time, interpolated through those nearest to it."""
    near = sorted(states, key=lambda s: abs(s.t - t))[:nearest]
    if abs(near[0].t - t) <= SAME_TIME * step:
        return near[0]
    near.sort(key=lambda s: s.t)
    weights = _lagrange(np.array([s.t for s in near]), t)
    x = combine(weights, [s.x for s in near])
    fields, products, M = {}, {}, None
    any_products = any(s.products for s in near)
    for name in near[0].fields:
        fields[name] = combine(weights, [s[name] for s in near])
        if any_products and not any(name in s.products for s in near):
            continue  # not conserved
        own = [space.mass_times(s.x, s[name]) for s in near]
        amounts = [s.products.get(name, b) for s, b in zip(near, own, strict=True)]
        products[name] = combine(weights, amounts)
        if all(_close(a, b) for a, b in zip(amounts, own, strict=True)):
            M = space.mass(x) if M is None else M
            solver = DirectSolver(partial(superlu, order=space.elimination_order))
            fields[name] = solver.solve(M, products[name], fields[name])
    return State(t, x, None, space=space, fields=fields, products=products)


def _close(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= OWN_MASS * np.abs(b).max())


def _lagrange(times: Array, t: float) -> list[float]:
    """Weights of the values at some times in the value at t of the polynomial through them.

    Examples
    --------
    >>> _lagrange(np.array([0.0, 1.0, 2.0]), 0.5)
    [0.375, 0.75, -0.125]
    """
    return [float(np.prod([(t - b) / (a - b) for b in times if b != a])) for a in times]


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


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays, each read to its end and its checksum."""
    with zipfile.ZipFile(path) as file:
        members = {name.removesuffix(".npy"): file.read(name) for name in file.namelist()}
    arrays = {
        name: np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
        for name, data in members.items()
    }
    header = json.loads(str(arrays.pop("header")))
    return header, arrays


def _rebuilt(header: dict[str, Any], arrays: dict[str, Any]) -> tuple[SurfaceSpace, list[State]]:
    """Space and states, checked like those of a user."""
    for name, shape in header["shapes"].items():
        found = arrays[name]
        kind = "i" if name == "cells" else "f"
        if found.dtype.kind != kind or list(found.shape) != shape:
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
