"""Long runs that may be interrupted: cases in parallel, one line of a file for each finished case.

An experiment is a function of its parameters and a list of chains of parameters. The cases of a
chain run in their order, so that a chain can end early (when a smaller step changes nothing any
more); different chains run side by side. Each finished case is appended to a file of JSON lines,
with what is needed to judge and to repeat it; a second run goes on where the first one stopped.
A row knows the code that made it: :func:`renew` computes again those that other code has made.
:func:`stored` reads the rows that the book shows.
"""

import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    as_completed,
    wait,
)
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from esfem_core.checks import number, whole_number
from esfem_core.companion.environment import code_of, environment

__all__ = [
    "DATA",
    "Experiment",
    "Row",
    "case",
    "changes",
    "is_current",
    "performance",
    "provenance",
    "read",
    "renew",
    "run",
    "select",
    "stored",
]

Parameters = Mapping[str, Any]
Results = Mapping[str, Any]

DATA = Path(__file__).parent / "data"
"""Folder of the book's stored results, a part of the package."""


@dataclass(frozen=True)
class Experiment:
    """What to compute, and for which parameters.

    Attributes
    ----------
    name : str
        Also the name of the file of results, without ".jsonl".
    title : str
        One line: what it reproduces.
    compute : callable
        ``compute(**parameters)`` returns a dict of JSON values. It is called in another process,
        so it must be a function of a module.
    chains : sequence of sequences of dict
        Parameters of the cases, JSON values only. Those of a chain are computed in order.
    enough : callable, optional
        ``enough(previous, current)`` looks at two neighbouring results of a chain; if it says True,
        the rest of the chain is left out.
    """

    name: str
    title: str
    compute: Callable[..., Results]
    chains: Sequence[Sequence[Parameters]]
    enough: Callable[[Results, Results], bool] | None = None


@dataclass(frozen=True)
class Row:
    """One finished case.

    Attributes
    ----------
    parameters, results : dict
    provenance : dict
        "seconds", and what :func:`esfem_core.companion.environment.environment` says of the
        experiment's function.
    """

    parameters: Parameters
    results: Results
    provenance: Mapping[str, Any]


def read(path: str | Path) -> list[Row]:
    """The finished cases in a file; none if there is no such file yet.

    Raises
    ------
    ValueError
        If a line other than the last is not a row. (A last line without its end is what an
        interrupted run leaves; it is not read.)
    """
    path = Path(path)
    if not path.exists():
        return []
    *lines, _ = path.read_text("utf8").split("\n")
    try:
        return [Row(**json.loads(line)) for line in lines]
    except (json.JSONDecodeError, TypeError) as error:
        raise ValueError(f"{path} is not a file of results: {error}") from error


def select(rows: Iterable[Row], **parameters: Any) -> list[Row]:
    """Rows with these parameters.

    Examples
    --------
    >>> rows = [Row({"order": p, "step": s}, {}, {}) for p in (1, 2) for s in (0.1, 0.05)]
    >>> [row.parameters["step"] for row in select(rows, order=2)]
    [0.1, 0.05]
    """
    wanted = parameters.items()
    return [row for row in rows if all(row.parameters.get(k) == value for k, value in wanted)]


def stored(name: str, /, **parameters: Any) -> list[Row]:
    """Rows with these parameters among the stored results of an experiment.

    They are data of the package, found wherever it is installed. (:func:`read` reads those that
    a run has put into another folder.)

    Parameters
    ----------
    name : str
        Of the experiment.
    **parameters
        As for :func:`select`.

    Returns
    -------
    list of Row
        In the order in which they were computed; never empty.

    Raises
    ------
    LookupError
        If there is no such row.

    Examples
    --------
    >>> [row] = stored("nick_theorem", order=3, refinements=1, step=1 / 40)
    >>> print(f"{row.results['x']:.1e}")
    2.3e-02
    """
    rows = select(read(DATA / f"{name}.jsonl"), **parameters)
    if not rows:
        given = ", ".join(f"{key} = {value!r}" for key, value in parameters.items())
        raise LookupError(
            f"no results of {name}{f' with {given}' if given else ''} are stored; the book's "
            f"cases are computed by: python -m esfem_core.companion.experiments {name}"
        )
    return rows


def performance() -> dict[str, Any]:
    """The stored measurements of ``benchmarks/run.py``.

    Raises
    ------
    LookupError
        If there are none.

    Examples
    --------
    >>> sorted(performance()["machine"])[:3]
    ['BLAS', 'date', 'esfem_core']
    """
    path = DATA / "performance.json"
    if not path.exists():
        raise LookupError("no measurements are stored; make them with: python benchmarks/run.py")
    found: dict[str, Any] = json.loads(path.read_text("utf8"))
    return found


def provenance(rows: Sequence[Row]) -> str:
    """Say in two lines where rows come from, to stand beside a figure.

    Examples
    --------
    >>> where = {"machine": "Abacus", "date": "2026-01-31"}
    >>> where = [where | {"esfem_core": f"0.1.0, source {code}"} for code in ("0123", "4567")]
    >>> print(provenance([Row({}, {}, {"seconds": 90.0, **there}) for there in where]))
    2 runs, 3.0 min in all, on Abacus,
    2026-01-31, esfem_core 0.1.0, source 0123 and 4567

    Raises
    ------
    ValueError
        If there are no rows.
    """
    if not rows:
        raise ValueError("there are no rows: the experiment has not been run yet")
    seconds = sum(row.provenance["seconds"] for row in rows)
    versions: dict[str, set[str]] = {}
    for row in rows:
        version, source = _source(row)
        versions.setdefault(version, set()).add(source)
    code = (f"{name}, source {_enumerated(versions[name])}" for name in sorted(versions))

    def values(name: str) -> str:
        return _enumerated({row.provenance[name] for row in rows})

    return (
        f"{len(rows)} run{'s' * (len(rows) > 1)}, {_duration(seconds)} in all, "
        f"on {values('machine')},\n{values('date')}, esfem_core {'; '.join(code)}"
    )


def _source(row: Row) -> tuple[str, str]:
    """Version of the package that made a row, and hash of its code."""
    version, _, source = row.provenance["esfem_core"].partition(", source ")
    return version, source


def _enumerated(names: Iterable[str]) -> str:
    *most, last = sorted(names)
    return f"{', '.join(most)} and {last}" if most else last


def _duration(seconds: float) -> str:
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def case(experiment: Experiment, parameters: Parameters) -> Row:
    """Compute one case here and now."""
    where = environment(experiment.compute)  # first: files may be edited in the meantime
    start = time.perf_counter()
    results = experiment.compute(**parameters)
    return Row(parameters, results, {"seconds": round(time.perf_counter() - start, 3), **where})


def is_current(experiment: Experiment, row: Row) -> bool:
    """Whether a row was made by the code as it is now, as far as its experiment reaches it.

    Docstrings, comments and parts of the package that the experiment does not use do not count.
    """
    return _source(row)[1] == code_of(experiment.compute)


def run(
    experiments: Sequence[Experiment], folder: str | Path, jobs: int | None = None
) -> Iterator[tuple[Experiment, Row | Exception | None, int]]:
    """Compute all cases that are not yet in the files of a folder.

    Parameters
    ----------
    experiments : sequence of Experiment
    folder : path
        Is made if missing; ``<name>.jsonl`` in it receives the rows of each experiment.
    jobs : int, optional
        Number of processes; one for each core if None.

    Yields
    ------
    experiment : Experiment
    outcome : Row, exception or None
        The case just finished, or what ended its chain, or None for a case found in the file.
    cases : int
        How many cases this settles.

    Raises
    ------
    TypeError, ValueError
        If jobs is no positive integer; at once, not when the first outcome is asked for.
    OSError
        If the folder cannot be made.
    """
    jobs = os.cpu_count() if jobs is None else whole_number("jobs", jobs, 1)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return _run(experiments, folder, jobs)


def _run(
    experiments: Sequence[Experiment], folder: Path, jobs: int | None
) -> Iterator[tuple[Experiment, Row | Exception | None, int]]:
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
    running: dict[Future[Row], _Chain] = {}

    def go_on(chain: "_Chain") -> None:
        if chain.waiting:
            running[pool.submit(case, chain.experiment, chain.waiting[0])] = chain

    try:
        for experiment in experiments:
            known = read(_path(folder, experiment))
            _truncate(_path(folder, experiment))
            for cases in experiment.chains:
                chain = _Chain(experiment, list(cases))
                for parameters in cases:
                    found = [row for row in known if row.parameters == parameters]
                    if not found or not chain.waiting:
                        break
                    yield experiment, None, chain.settle(found[-1])
                go_on(chain)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                chain = running.pop(future)
                error = future.exception()
                if isinstance(error, Exception):
                    yield chain.experiment, error, len(chain.waiting)
                    continue
                row = future.result()
                with _path(folder, chain.experiment).open("a", encoding="utf8") as file:
                    file.write(json.dumps(vars(row)) + "\n")
                yield chain.experiment, row, chain.settle(row)
                go_on(chain)
    finally:
        pool.shutdown(cancel_futures=True)


def renew(
    experiments: Sequence[Experiment], folder: str | Path, jobs: int | None = None
) -> Iterator[tuple[Experiment, Row, Row | Exception]]:
    """Compute again the rows that other code has made, each in its place.

    Parameters
    ----------
    experiments : sequence of Experiment
    folder : path
        With the files of results, ``<name>.jsonl``.
    jobs : int, optional
        Number of processes; one for each core if None.

    Yields
    ------
    experiment : Experiment
    old : Row
    outcome : Row or exception
        What takes the place of `old`, or why it stays.

    Raises
    ------
    TypeError, ValueError
        If jobs is no positive integer; at once, not when the first outcome is asked for.
    """
    jobs = os.cpu_count() if jobs is None else whole_number("jobs", jobs, 1)
    return _renew(experiments, Path(folder), jobs)


def _renew(
    experiments: Sequence[Experiment], folder: Path, jobs: int | None
) -> Iterator[tuple[Experiment, Row, Row | Exception]]:
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
    try:
        running = {
            pool.submit(case, experiment, row.parameters): (experiment, row)
            for experiment in experiments
            for row in read(_path(folder, experiment))
            if not is_current(experiment, row)
        }
        for future in as_completed(running):
            experiment, old = running[future]
            error = future.exception()
            if isinstance(error, Exception):
                yield experiment, old, error
                continue
            new = future.result()
            _replace(_path(folder, experiment), old, new)
            yield experiment, old, new
    finally:
        pool.shutdown(cancel_futures=True)


def _replace(path: Path, old: Row, new: Row) -> None:
    """Put a row in the place of another; an interruption leaves the file as it was."""
    rows = [new if row == old else row for row in read(path)]
    other = path.with_suffix(".new")
    other.write_text("".join(json.dumps(vars(row)) + "\n" for row in rows), "utf8")
    other.replace(path)


def changes(old: Any, new: Any, share: float = 0.01) -> list[tuple[str, Any, Any]]:
    """Numbers of two results that differ by more than a share, and whatever else is not the same.

    Parameters
    ----------
    old, new : JSON values
        Numbers that differ by less than 1e-12 are the same, and so are two NaN.
    share : float
        Of the larger one.

    Returns
    -------
    list of tuple
        Where, the old value and the new one; None for what is not there.

    Examples
    --------
    >>> changes({"x": 1.0, "u": [1.0, 2.0]}, {"x": 1.001, "u": [1.0, 2.1]})
    [('u[1]', 2.0, 2.1)]
    """
    number("share", share, least=0)
    before, after = (dict(_leaves("", value)) for value in (old, new))
    return [
        (where.lstrip("."), before.get(where), after.get(where))
        for where in dict.fromkeys([*before, *after])
        if not _alike(before.get(where), after.get(where), share)
    ]


def _leaves(where: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The single values in a JSON value, each with its place."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _leaves(f"{where}.{key}", entry)
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from _leaves(f"{where}[{i}]", entry)
    else:
        yield where, value


def _alike(a: Any, b: Any, share: float) -> bool:
    if isinstance(a, float | int) and isinstance(b, float | int):
        both_nan = math.isnan(a) and math.isnan(b)
        return both_nan or math.isclose(a, b, rel_tol=share, abs_tol=1e-12)
    return bool(a == b)


class _Chain:
    """What is left of a chain."""

    def __init__(self, experiment: Experiment, waiting: list[Parameters]) -> None:
        self.experiment, self.waiting = experiment, waiting
        self.last: Row | None = None

    def settle(self, row: Row) -> int:
        """Take the result of the first case that waits; the number of cases which that settles."""
        enough = self.experiment.enough
        before = len(self.waiting)
        stop = self.last and enough and enough(self.last.results, row.results)
        self.waiting = [] if stop else self.waiting[1:]
        self.last = row
        return before - len(self.waiting)


def _path(folder: Path, experiment: Experiment) -> Path:
    return folder / f"{experiment.name}.jsonl"


def _truncate(path: Path) -> None:
    """Drop a last line that an interruption has cut off."""
    text = path.read_text("utf8") if path.exists() else ""
    if not text.endswith("\n") and text:
        path.write_text(text[: text.rfind("\n") + 1], "utf8")
