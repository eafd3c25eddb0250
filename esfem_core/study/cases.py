"""Many cases of one function: the tool for a reader's own studies."""

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from html import escape
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from esfem_core.checks import iterable, level_outside, shown
from esfem_core.study.locks import StudyWarning
from esfem_core.study.rows import Parameters, Row, case_key
from esfem_core.study.scheduling import (
    Experiment,
    Failure,
    Outcome,
    Stale,
    checked,
    outcomes,
)
from esfem_core.tables import html_table, text_table

__all__ = ["Results", "grid", "run"]


@dataclass(frozen=True)
class Results:
    """What a study has given; displays as a table in a notebook.

    Attributes
    ----------
    rows : list of Row
        In the order of the cases. Those that failed or were left out are not among them.
    failures : list of Failure

    Examples
    --------
    A table for other programs has a row for each case:

    >>> import tempfile
    >>> import esfem_core as ec
    >>> def sums(n):
    ...     return {"sum": n * (n + 1) // 2, "parts": [n, 1.0]}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run(grid(n=(2, 3)), sums, folder, workers=0, progress=False)
    ...     ec.save_table(f"{folder}/sums.csv", results.table())
    ...     print(Path(folder, "sums.csv").read_text())
    n,sum,parts_0,parts_1
    2,3,2,1.0
    3,6,3,1.0
    """

    rows: list[Row]
    failures: list[Failure]

    def table(self) -> list[dict[str, Any]]:
        """Parameters and results of each case, under names that differ.

        Returns
        -------
        list of dict
            In the order of the rows. A result that has the name of a parameter, such as "h", is
            called "h (result)".
        """
        return [_together(row) for row in self.rows]

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        """Parameters, and those results that are single values."""
        rows = self.table()
        names = dict.fromkeys(
            name for row in rows for name in row if not isinstance(row[name], list | dict)
        )
        cells = [[_text(row.get(name, "")) for name in names] for row in rows]
        return list(names), cells

    def __str__(self) -> str:
        return "\n".join([text_table(*self._cells()), *self._notes()])

    def _notes(self) -> list[str]:
        return [f"failed: {_named(f.parameters)}: {_named_error(f.error)}" for f in self.failures]

    def _repr_html_(self) -> str:
        header, cells = self._cells()
        table = html_table(header, cells).text
        return table + "".join(f"<p>{escape(note)}</p>" for note in self._notes())


def _together(row: Row) -> dict[str, Any]:
    """Parameters, and results with other names than theirs."""
    found = dict(row.parameters)
    for name, value in row.results.items():
        while name in found:
            name += " (result)"
        found[name] = value
    return found


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def grid(**values: Iterable[Any]) -> list[dict[str, Any]]:
    """All combinations of values of some parameters; the last one changes first.

    Raises
    ------
    TypeError
        If a parameter is given one value and not a sequence; strings and dicts are values.

    Examples
    --------
    >>> grid(order=(1, 2), step=(0.1, 0.05))[:3]
    [{'order': 1, 'step': 0.1}, {'order': 1, 'step': 0.05}, {'order': 2, 'step': 0.1}]
    """
    for name, given in values.items():
        single = isinstance(given, str | bytes | Mapping) or (
            isinstance(given, np.ndarray) and not given.ndim
        )
        if single or not isinstance(given, Iterable):
            raise TypeError(
                f"{name} must be a sequence of values, got {shown(given)}; a tuple holds a single "
                f"one: {name}=({shown(given)},)"
            )
    return [dict(zip(values, case, strict=True)) for case in product(*values.values())]


def _named(parameters: Parameters) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in parameters.items())


def _named_error(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def run(
    cases: Iterable[Parameters | Sequence[Parameters]],
    compute: Callable[..., Mapping[str, Any]],
    folder: str | Path,
    executor: Executor | None = None,
    *,
    name: str | None = None,
    workers: int | None = None,
    threads: int | None = 1,
    enough: Callable[[Mapping[str, Any], Mapping[str, Any]], bool] | None = None,
    stale: Stale = "renew",
    progress: bool | Callable[[str], object] = True,
) -> Results:
    """Compute many cases, each once, and keep each as soon as it is finished.

    What is in the file already is not computed again: a study that was interrupted, killed or made
    larger goes on. A case is what its parameters are, in whatever order; a row is out of date when
    the code that its case reaches has changed, and what it uses besides its parameters: numbers,
    arrays, spaces, triangulations, attributes of its own objects (see
    :func:`esfem_core.study.user_code.code_of`), but not contents of files (see Notes). A case
    that fails, or whose process dies twice, is reported, and the others go on.

    Parameters
    ----------
    cases : iterable of dict, or of sequences of dict
        Parameters, of numbers, strings, booleans, None, and lists and dicts of them (no arrays:
        `compute` makes them of lists; tuples arrive as lists). A sequence is a chain, whose cases
        are computed one after the other until one fails or `enough` is true.
    compute : callable
        ``compute(**parameters)`` returns a dict of numbers, strings, arrays, lists, dicts.
    folder : path
        Made if missing; ``<name>.jsonl`` in it has a line of JSON for each row, see
        :func:`esfem_core.study.read`.
    executor : concurrent.futures.Executor, optional
        What computes: a pool, or ``client.get_executor()`` of Dask. Processes of its own if None.
        It is not shut down; if it breaks, processes of our own go on.
    name : str, optional
        Of the file; that of `compute` if None.
    workers : int, optional
        Without an executor, the number of processes: one for each core if None, and with 0 all is
        computed in this process. With an executor, how many cases it is given at a time: all if
        None.
    threads : int, optional
        Threads of the numerical libraries in each of our own processes; None leaves it to them.
    enough : callable, optional
        ``enough(previous, current)``, of copies of two neighbouring results of a chain: True leaves
        out the rest of it. If it fails, so does the next case.
    stale : {"renew", "keep"}
        Whether rows of other code are computed again, and replaced then, or taken as they are.
    progress : bool or callable
        True shows a bar of tqdm, or lines where it is not installed, on the standard error; a
        function such as ``print`` is given a line for each case.

    Returns
    -------
    Results

    Raises
    ------
    TypeError, ValueError
        If an argument is none of these, before anything is computed.
    OSError
        If nothing can be written into the folder.
    UnsavedRowsError
        If finished rows could not be written to the end, such as to a full disk; it says where they
        are instead.
    WorkerLostError
        If processes cannot be started.

    Warns
    -----
    StudyWarning
        If a case failed, a row cannot be written for the time being, or an executor broke.

    Notes
    -----
    In a script, a call stands under ``if __name__ == "__main__":``, since worker processes read the
    script. Functions of a notebook or a shell are sent to them by cloudpickle (extra ``cluster``);
    without it they must stand in a module, or be computed with ``workers=0``. Modules are read by
    each process when it begins: a case fails where a process has read another text of one than the
    process that calls this. Reload a module that was edited (or start anew), and start pools anew.
    Values that are set in a module after it was imported do not reach processes: in our own, a case
    that uses them fails. Set them at the top of the module, hand them over as parameters, or
    compute with ``workers=0``.

    What `compute` uses besides its parameters must stay what it is: a dict in which it keeps meshes
    makes its rows out of date, and ``functools.cache``, on a function that makes them, does not.
    Objects of other packages that cannot be pickled, such as a factorisation of CHOLMOD, make them
    so in every run: make these in `compute`.

    Functions that are reached only by a text, as by ``globals()[name]`` or ``eval``, do not count:
    a row stays as it was when they change. A dict of functions does, ``{"law": law}[name]``.

    Contents of files do not count: a case that reads a file whose contents have changed is found as
    it was. A checksum among its parameters makes it a case anew.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.mkdtemp()
    >>> def square(side):
    ...     return {"area": side**2}
    >>> print(run(grid(side=(1, 2)), square, folder, workers=0, progress=print))
    1/2 square: side=1: ...
    2/2 square: side=2: ...
    side  area
       1     1
       2     4
    >>> _ = run(grid(side=(2, 3)), square, folder, workers=0, progress=print)
    1/2 square: side=2: found
    2/2 square: side=3: ...

    Cases of a mesh in a file, which are others when the file is another:

    >>> import hashlib
    >>> import esfem_core as ec
    >>> path = Path(folder, "ball.ply")
    >>> def area(path, checksum):
    ...     return {"area": ec.read_mesh(path, report=None).area}
    >>> for radius in (1, 2):
    ...     ball = ec.sphere("icosahedron", 2)
    ...     _ = ball.apply_scale(radius).export(path)
    ...     checksum = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    ...     cases = [{"path": str(path), "checksum": checksum}]
    ...     [row] = run(cases, area, folder, workers=0, progress=False).rows
    ...     print(f"{row.results['area']:.1f}")
    12.3
    49.3
    """
    if not (callable(progress) or isinstance(progress, bool)):
        raise TypeError(
            f"progress must be True, False or a function of a line, got {shown(progress)}"
        )
    name = getattr(compute, "__name__", None) if name is None else name
    each = iterable("cases", cases, "dicts of parameters")
    chains = [[c] if isinstance(c, Mapping) else c for c in each]
    study = checked(Experiment(name or "", "", compute, chains, enough))
    coming = outcomes([study], folder, executor, workers=workers, threads=threads, stale=stale)
    rows: dict[str, Row] = {}
    failures = []
    # Closed also when progress raises: its traceback, which a notebook keeps, would hold processes.
    with closing(coming), _reporting(progress, sum(map(len, study.chains))) as report:
        for outcome in coming:
            report(outcome)
            if outcome.row:
                rows[case_key(outcome.parameters)] = outcome.row
            elif outcome.error:
                failures.append(Failure(outcome.parameters, outcome.error))
    if failures:
        first = f"{_named(failures[0].parameters)}: {_named_error(failures[0].error)}"
        warnings.warn(
            f"{len(failures)} of the cases failed, the first one with {first}",
            StudyWarning,
            stacklevel=level_outside(),
        )
    keys = dict.fromkeys(case_key(case) for chain in study.chains for case in chain)
    return Results([rows[key] for key in keys if key in rows], failures)


@contextmanager
def _reporting(
    progress: bool | Callable[[str], object], total: int
) -> Iterator[Callable[[Outcome], None]]:
    """A function that tells of outcomes."""
    done = 0

    def line(outcome: Outcome) -> str:
        nonlocal done
        done += outcome.cases
        if outcome.error:
            news = _named_error(outcome.error)
        elif outcome.found or not outcome.row:
            news = "found"
        else:
            news = f"{outcome.row.provenance['seconds']:.1f} s"
        return f"{done}/{total} {outcome.experiment.name}: {_named(outcome.parameters)}: {news}"

    def tell(outcome: Outcome) -> None:
        if callable(progress):
            progress(line(outcome))
        elif progress:
            print(line(outcome), file=sys.stderr, flush=True)

    try:
        from tqdm import tqdm
    except ImportError:
        tqdm = None
    if progress is not True or tqdm is None:
        yield tell
        return
    with tqdm(total=total, unit="case") as bar:

        def advance(outcome: Outcome) -> None:
            if outcome.error:
                bar.write(line(outcome), file=sys.stderr)
            bar.set_description(outcome.experiment.name)
            bar.update(outcome.cases)

        yield advance
