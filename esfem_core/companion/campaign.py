"""The book's long runs and what they have given.

They are experiments of :mod:`esfem_core.study.scheduling`, whose rows are data of the package.
:func:`stored` reads the rows that the book shows; :func:`renew` computes again those that other
code has made.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from esfem_core.checks import items, iterable, number, whole_number
from esfem_core.study import (
    ConvergenceTable,
    Experiment,
    Row,
    case,
    is_current,
    outcomes,
    read,
    select,
)

__all__ = [
    "DATA",
    "Experiment",
    "Row",
    "case",
    "changes",
    "convergence",
    "is_current",
    "origin",
    "performance",
    "provenance",
    "read",
    "renew",
    "select",
    "stored",
]

DATA = Path(__file__).parent / "data"
"""Folder of the book's stored results, a part of the package."""


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
    known = sorted(path.stem for path in DATA.glob("*.jsonl"))
    if name not in known:
        raise LookupError(
            f"no results of {name!r} are stored, only those of {', '.join(known)}; the book's "
            "cases are computed by: python -m esfem_core.companion.experiments"
        )
    rows = select(read(DATA / f"{name}.jsonl"), **parameters)
    if not rows:
        given = ", ".join(f"{key} = {value!r}" for key, value in parameters.items())
        raise LookupError(
            f"no results of {name}{f' with {given}' if given else ''} are stored; the book's "
            f"cases are computed by: python -m esfem_core.companion.experiments {name}"
        )
    return rows


def performance(name: str = "performance") -> dict[str, Any]:
    """The stored measurements of ``benchmarks/run.py``.

    Parameters
    ----------
    name
        ``"performance"``, or ``"performance_xeon"`` for those of a second machine.

    Raises
    ------
    LookupError
        If there are none.

    Examples
    --------
    >>> sorted(performance()["machine"])[:3]
    ['BLAS', 'date', 'esfem_core']
    """
    path = DATA / f"{name}.json"
    if not path.exists():
        raise LookupError(
            f"no measurements {path.name} are stored; make them with: python benchmarks/run.py"
        )
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
    TypeError, ValueError
        If there are no rows, or they are none.
    KeyError
        If one does not say where it comes from.
    """
    rows = items("rows", rows, Row, least=0)
    if not rows:
        raise ValueError("there are no rows: the experiment has not been run yet")
    for i, row in enumerate(rows):
        for name in ("seconds", "machine", "date", "esfem_core"):
            _entry(i, name, row.provenance)
    seconds = sum(row.provenance["seconds"] for row in rows)
    versions: dict[str, set[str]] = {}
    for row in rows:
        version = row.provenance["esfem_core"].partition(", source ")[0]
        versions.setdefault(version, set()).add(row.code)
    code = (f"{name}, source {_enumerated(versions[name])}" for name in sorted(versions))

    def values(name: str) -> str:
        return _enumerated({row.provenance[name] for row in rows})

    return (
        f"{len(rows)} run{'s' * (len(rows) > 1)}, {_duration(seconds)} in all, "
        f"on {values('machine')},\n{values('date')}, esfem_core {'; '.join(code)}"
    )


def origin(mode: str, rows: Sequence[Row]) -> str:
    """Say in which mode, on how many nodes at most and where the rows of a figure were computed.

    Examples
    --------
    >>> [row] = stored("nick_theorem", order=3, refinements=1, step=1 / 40)
    >>> rows = [Row(row.parameters, row.results | {"nodes": 1026}, row.provenance)]
    >>> print(origin("full", rows).split(":")[0])
    full mode, up to 1,026 nodes
    """
    said = provenance(rows)
    nodes = max(_entry(i, "nodes", row.results) for i, row in enumerate(rows))
    return f"{mode} mode, up to {nodes:,} nodes: {said}"


def convergence(rows: Sequence[Row], size: str, *names: str) -> ConvergenceTable:
    """Put results of rows into a table of errors over a step or mesh size.

    Parameters
    ----------
    rows : sequence of Row
        In the order of the table; at least one.
    size : str
        A parameter or a result of the rows: "step" or "h".
    *names : str
        Results to show; all that the first row has if none is named.

    Returns
    -------
    ConvergenceTable

    Raises
    ------
    ValueError
        If there are no rows.
    KeyError
        If a row has no such size or result.

    Examples
    --------
    >>> rows = [Row({"step": t}, {"u": t**2}, {}) for t in (0.2, 0.1)]
    >>> print(convergence(rows, "step"))
         step          u      order
          0.2   4.00e-02
          0.1   1.00e-02       2.00
    """
    rows = list(iterable("rows", rows, "Rows"))
    if not rows:
        raise ValueError("rows must hold at least one row, got none")
    items("rows", rows, Row)
    sizes = [_entry(i, size, {**row.results, **row.parameters}) for i, row in enumerate(rows)]
    names = names or tuple(rows[0].results)
    results = [{n: _entry(i, n, row.results) for n in names} for i, row in enumerate(rows)]
    return ConvergenceTable.of(size, sizes, results)


def _entry(i: int, name: str, entries: Mapping[str, Any]) -> Any:
    """An entry of row i."""
    if name not in entries:
        known = ", ".join(map(repr, entries)) or "none"
        raise KeyError(f"rows[{i}] has no {name!r}, only {known}")
    return entries[name]


def _enumerated(names: Iterable[str]) -> str:
    *most, last = sorted(names)
    return f"{', '.join(most)} and {last}" if most else last


def _duration(seconds: float) -> str:
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


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
    jobs = None if jobs is None else whole_number("jobs", jobs, 1)
    old = {
        (experiment.name, json.dumps(row.parameters)): row
        for experiment in experiments
        for row in read(experiment.path(folder))
        if not is_current(experiment, row)
    }
    stale = [
        replace(e, chains=[[r.parameters] for (name, _), r in old.items() if name == e.name])
        for e in experiments
    ]
    coming = outcomes(stale, folder, workers=jobs, stale="renew")
    return (
        (o.experiment, old[o.experiment.name, json.dumps(o.parameters)], found)
        for o in coming
        if (found := o.row or o.error)
    )


def changes(old: Any, new: Any, share: float = 0.01) -> list[tuple[str, Any, Any]]:
    """Numbers of two results that differ by more than a share, and whatever else is not the same.

    Parameters
    ----------
    old, new : JSON values
        Numbers that differ by less than 1e-12 are the same, and so are two NaN.
    share : float
        Of the larger one, 0 or more and below 1.

    Returns
    -------
    list of tuple
        Where, the old value and the new one; None for what is not there.

    Examples
    --------
    >>> changes({"x": 1.0, "u": [1.0, 2.0]}, {"x": 1.001, "u": [1.0, 2.1]})
    [('u[1]', 2.0, 2.1)]
    """
    number("share", share, least=0, below=1)
    before, after = (dict(_leaves("", value)) for value in (old, new))
    return [
        (where.lstrip("."), before.get(where), after.get(where))
        for where in dict.fromkeys([*before, *after])
        if (where in before) != (where in after)
        or not _alike(before.get(where), after.get(where), share)
    ]


def _leaves(where: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The single values in a JSON value, each with its place; what is empty is one, too."""
    if where and value in ({}, []):
        yield where, value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _leaves(f"{where}.{key}", entry)
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from _leaves(f"{where}[{i}]", entry)
    else:
        yield where, value


def _alike(a: Any, b: Any, share: float) -> bool:
    if isinstance(a, bool) != isinstance(b, bool):
        return False
    if isinstance(a, float | int) and isinstance(b, float | int):
        both_nan = math.isnan(a) and math.isnan(b)
        return both_nan or math.isclose(a, b, rel_tol=share, abs_tol=1e-12)
    return bool(a == b)
