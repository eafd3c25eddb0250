"""Studies of many cases: in parallel, resumed by content, and none lost.

An experiment is a function of its parameters and a list of chains of parameters. The cases of a
chain run in their order, so that a chain can end early (when a smaller step changes nothing any
more); different chains run side by side. Each finished case is a line of a file, with what is
needed to judge and to repeat it; a second run goes on where the first one stopped, and runs that
are started at the same time, also on several machines with a common folder, share the cases among
them.
"""

import re
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from pickle import loads
from typing import Any, Literal, NamedTuple

from esfem_core.checks import (
    flag,
    function,
    items,
    iterable,
    level_outside,
    mapping,
    object_of,
    one_of,
    path_of,
    shown,
    whole_number,
)
from esfem_core.study.dependencies import is_of_package
from esfem_core.study.environment import environment
from esfem_core.study.locks import StudyWarning
from esfem_core.study.processes import Processes, WorkerLostError, pickled, transportable
from esfem_core.study.rows import (
    Parameters,
    Row,
    Store,
    plain,
    reason_of,
    set_aside,
)
from esfem_core.study.user_code import code_of, imports_of, values_of

__all__ = [
    "Experiment",
    "Failure",
    "Outcome",
    "Stale",
    "case",
    "checked",
    "is_current",
    "outcomes",
]

ATTEMPTS = 2
"""How often a case is begun whose process dies."""

POLL = 0.2
"""Seconds between two looks at what other runs have finished."""

Stale = Literal["renew", "keep"]


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
        ``compute(**parameters)`` returns a dict of what :func:`esfem_core.study.rows.plain` takes:
        numbers, strings, arrays, lists and dicts.
    chains : sequence of sequences of dict
        Parameters of the cases. Those of a chain are computed in order.
    enough : callable, optional
        ``enough(previous, current)`` looks at copies of two neighbouring results of a chain; if it
        returns True, the rest of the chain is left out.
    """

    name: str
    title: str
    compute: Callable[..., Mapping[str, Any]]
    chains: Sequence[Sequence[Parameters]]
    enough: Callable[[Mapping[str, Any], Mapping[str, Any]], bool] | None = None

    def path(self, folder: str | Path) -> Path:
        """The file of results in a folder."""
        return path_of("folder", folder, "a folder") / f"{self.name}.jsonl"


class Outcome(NamedTuple):
    """What became of a case.

    Attributes
    ----------
    experiment : Experiment
    parameters : dict
    row : Row or None
    error : Exception or None
        Why there is no row.
    found : bool
        Whether the row was in the file already, or came from another run.
    cases : int
        How many cases this settles: more than one where a chain ends early.
    """

    experiment: Experiment
    parameters: Parameters
    row: Row | None
    error: Exception | None
    found: bool
    cases: int


class Failure(NamedTuple):
    """A case without a result, and why.

    Where it happened shows ``traceback.print_exception(failure.error)``: the traceback of the
    process that computed the case is a note of the error.
    """

    parameters: Parameters
    error: Exception


def case(experiment: Experiment, parameters: Parameters) -> Row:
    """Compute one case here and now, without a file.

    Raises
    ------
    TypeError
        If an argument is none of these.
    Exception
        What the experiment's function raises.
    """
    object_of("experiment", experiment, Experiment)
    mapping("parameters", parameters, "values")
    return _computed(experiment.compute, parameters, code_of(experiment.compute))


def is_current(experiment: Experiment, row: Row) -> bool:
    """Whether a row was made by the code as it is now, as far as its experiment reaches it.

    Docstrings, comments and code that the experiment does not use do not count.
    """
    object_of("experiment", experiment, Experiment)
    object_of("row", row, Row)
    return row.code == code_of(experiment.compute)


def outcomes(
    experiments: Sequence[Experiment],
    folder: str | Path,
    executor: Executor | None = None,
    *,
    workers: int | None = None,
    threads: int | None = 1,
    stale: Stale = "keep",
) -> Generator[Outcome, None, None]:
    """Compute the cases of experiments that are not yet in their files, and show them as they come.

    The loop may be left at any time: what is finished is kept, what runs in processes of our own is
    ended, at once if the generator is closed (``contextlib.closing``).

    Parameters
    ----------
    experiments : sequence of Experiment
    folder, executor, workers, threads, stale
        As for :func:`esfem_core.study.cases.run`; what it raises is raised here, at once or in the
        loop.

    Yields
    ------
    Outcome

    Examples
    --------
    >>> folder = getfixture("tmp_path")
    >>> def square(side):
    ...     return {"area": side**2}
    >>> study = Experiment("squares", "Areas of squares", square, [[{"side": 2}, {"side": 3}]])
    >>> for outcome in outcomes([study], folder, workers=0):
    ...     print(outcome.parameters, outcome.row.results)
    {'side': 2} {'area': 4}
    {'side': 3} {'area': 9}
    """
    one_of("stale", stale, Stale)
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor must be a concurrent.futures.Executor or None, got {shown(executor)}"
        )
    workers = None if workers is None else whole_number("workers", workers, 0)
    limit: float = float("inf") if workers is None else max(workers, 1)
    threads = None if threads is None else whole_number("threads", threads, 1)
    place = path_of("folder", folder, "a folder")
    if place.exists() and not place.is_dir():
        raise NotADirectoryError(f"folder must be a folder, but {str(place)!r} is a file")
    studies = [checked(e) for e in items("experiments", experiments, Experiment, 0)]
    own = None
    if executor is None and workers != 0:
        executor = own = Processes(workers, threads)
        limit = own.workers
    place.mkdir(parents=True, exist_ok=True)
    schedule = _Schedule(executor or _Here(), own, 1 if executor is None else limit, threads)
    for experiment in studies:
        schedule.add(experiment, place, stale, _sent(experiment.compute, executor))
    return schedule.outcomes()


def checked(experiment: Experiment) -> Experiment:
    """An experiment with parameters as a file can hold them.

    Raises
    ------
    TypeError, ValueError
        If something in it is not what it must be.
    """
    if not callable(experiment.compute):
        raise TypeError(f"compute must be a function, got {shown(experiment.compute)}")
    name = experiment.name
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]*", name):
        raise ValueError(
            f"name must be made of letters, digits, '_', '-' and '.', got {name!r}; where compute "
            "has no such name, name= gives one"
        )
    if experiment.enough is not None:
        function("enough", experiment.enough, "of two results, or None")
    chains = [
        list(iterable("a chain of cases", chain, "dicts of parameters"))
        for chain in experiment.chains
    ]
    for parameters in (case for chain in chains for case in chain):
        if not isinstance(parameters, Mapping):
            raise TypeError(f"a case must be a dict of parameters, got {shown(parameters)}")
    # An array would arrive as a list, of which the double is no vector twice as long.
    chains = [[plain("a case", c, arrays=False) for c in chain] for chain in chains]
    return replace(experiment, chains=chains)


class _Sent(NamedTuple):
    """What an executor is given of a function.

    Attributes
    ----------
    function : bytes or callable
        Bytes where it goes to another process; executors of other kinds, such as those of Dask,
        have ways of their own.
    code : str
        Its hash.
    imports : dict
        What another process imports of it, see :func:`esfem_core.study.user_code.imports_of`.
    values : str
        What a process of our own must find, see :func:`esfem_core.study.user_code.values_of`;
        empty if that is not known.
    """

    function: Any
    code: str
    imports: dict[str, str]
    values: str = ""


def _sent(compute: Callable[..., Any], executor: Executor | None) -> _Sent:
    code = code_of(compute)
    if executor is None:
        return _Sent(compute, code, {})
    if not isinstance(executor, Processes | ProcessPoolExecutor):
        return _Sent(compute, code, imports_of(compute))
    sent = pickled(compute)
    values = _values(sent) if isinstance(executor, Processes) else ""
    return _Sent(sent, code, imports_of(compute), values)


def _values(sent: bytes) -> str:
    """What a process finds in a function that was sent to it; empty if it is other each time."""
    compute = loads(sent)
    if is_of_package(compute):
        return ""
    return first if (first := values_of(compute)) == values_of(loads(sent)) else ""


def _attempt(sent: _Sent, parameters: Parameters) -> Row | Failure:
    """Compute a case, on whatever machine: its row, or what went wrong, as something to send."""
    try:
        compute = _read(sent.function) if isinstance(sent.function, bytes) else sent.function
        _require_same_code(compute, sent.imports)
        _require_same_values(sent)
        return _computed(compute, parameters, sent.code)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # CancelledError and SystemExit, too
        return Failure(parameters, transportable(error))


@lru_cache(1)  # functools.cache in a notebook has something to keep then
def _read(function: bytes) -> Any:
    return loads(function)


_compared: set[tuple[tuple[str, str], ...]] = set()  # once for each study: cases may be many


def _require_same_code(compute: Callable[..., Any], wanted: Mapping[str, str]) -> None:
    """Refuse to compute with other code than that under which the row would be kept."""
    key = tuple(wanted.items())
    if key in _compared:
        return
    here = imports_of(compute) if wanted else {}
    for name, code in wanted.items():
        if here.get(name, code) != code:
            raise RuntimeError(
                f"{name.partition(' ')[0]}, or a number or a string that it uses, is not the same "
                "in the process that computes and in the one that has started the study: a module "
                "was changed after one of them had read it; start both anew"
            )
    _compared.add(key)


_same: dict[str, bool] = {}  # by values: starting a process to find out takes long


def _require_same_values(sent: _Sent) -> None:
    """Refuse to compute with other values than those of the process that began the study."""
    if sent.values not in _same:
        # Where cases were computed they may have changed what others use.
        _same[sent.values] = any(_same.values()) or not _differs(sent)
    if not _same[sent.values]:
        raise RuntimeError(
            "compute uses values that are not the same in the process that computes and in the one "
            "that has started the study: something was set or filled in a module after it was "
            "imported, which worker processes do not see, or is read from the environment; set it "
            "at the top of the module, hand it over as a parameter, or compute with workers=0"
        )


def _differs(sent: _Sent) -> bool:
    """Whether worker processes find other values, the same in each: not such as are drawn."""
    here = _values(sent.function) if sent.values else ""
    if here in ("", sent.values):
        return False
    with Processes(1) as other:
        return bool(other.submit(_values, sent.function).result() == here)


def _computed(compute: Callable[..., Any], parameters: Parameters, code: str) -> Row:
    # Code and date first: files may be edited in the meantime. A process that has read the package
    # later than the one that began the study tells what it has read.
    where = environment(code_of(compute) if is_of_package(compute) else code)
    start = time.perf_counter()
    results = plain("results", compute(**deepcopy(dict(parameters))))  # which it may change
    if not isinstance(results, dict):
        raise TypeError(f"results must be a dict, got {shown(results)}")
    return Row(parameters, results, {"seconds": round(time.perf_counter() - start, 3), **where})


class _Here(Executor):
    """Computes in this process, one after the other."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class _Chain:
    """What is left of a chain."""

    def __init__(
        self,
        experiment: Experiment,
        store: Store,
        sent: _Sent,
        wanted: str | None,
        waiting: list[Parameters],
    ) -> None:
        self.experiment, self.store, self.sent = experiment, store, sent
        self.wanted, self.waiting = wanted, waiting
        self.attempts = 0
        self._last: Row | None = None

    def find(self) -> Row | None:
        """The row of the next case, if there is one that counts."""
        row = self.store.find(self.waiting[0])
        return row if row and self.wanted in (None, row.code) else None

    def settled(self, row: Row, *, found: bool) -> list[Outcome]:
        """Take the row of the next case; where `enough` fails, the chain ends with its error."""
        parameters, *self.waiting = self.waiting
        before, self._last, self.attempts = self._last, row, 0
        outcome = Outcome(self.experiment, parameters, row, None, found, 1)
        if before is None or not self.waiting:
            return [outcome]
        try:
            stop = self._enough(before, row)
        except Exception as error:
            return [outcome, self.failed(error)]
        if stop:
            outcome = outcome._replace(cases=1 + len(self.waiting))
            self.waiting = []
        return [outcome]

    def _enough(self, before: Row, row: Row) -> bool:
        """What the experiment's function says; of copies, since rows are kept."""
        if self.experiment.enough is None:
            return False
        what = "not begun: enough(previous, current), of the two cases before,"
        try:
            stop = self.experiment.enough(deepcopy(before.results), deepcopy(row.results))
        except Exception as error:
            text = f"{what} raised {type(error).__name__}: {error}"
            raise RuntimeError(text) from error
        return flag(what, stop)

    def failed(self, error: Exception) -> Outcome:
        """End here."""
        parameters, cases = self.waiting[0], len(self.waiting)
        self.waiting = []
        return Outcome(self.experiment, parameters, None, error, False, cases)


class _Schedule:
    """Chains that wait, and chains that are being computed here or by another run."""

    def __init__(
        self, executor: Executor, own: Processes | None, limit: float, threads: int | None
    ) -> None:
        self.waiting: deque[_Chain] = deque()
        self._running: dict[Future[Any], _Chain] = {}
        self._executor, self._limit, self._threads = executor, limit, threads
        self._own = own  # processes that end with it
        self._stores: list[Store] = []
        self._unsaved: list[tuple[Store, Row]] = []
        self._reason: Exception = OSError()

    def add(self, experiment: Experiment, folder: Path, stale: Stale, sent: _Sent) -> None:
        """Take in the chains of an experiment."""
        store = Store(experiment.path(folder))
        self._stores.append(store)
        wanted = sent.code if stale == "renew" else None
        for chain in experiment.chains:
            self.waiting.append(_Chain(experiment, store, sent, wanted, list(chain)))

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Find, compute and keep."""
        try:
            for chain in self.waiting:
                yield from self._found(chain)
            self.waiting = deque(chain for chain in self.waiting if chain.waiting)
            while self.waiting or self._running:
                yield from self._begin()
                yield from self._finish()
        except BaseException:  # GeneratorExit, too: the loop is left
            self._stop()
            if self._unsaved:
                text = str(set_aside(self._unsaved, self._reason))
                warnings.warn(text, StudyWarning, stacklevel=level_outside())
            raise
        self._stop()
        if self._unsaved:
            raise set_aside(self._unsaved, self._reason)

    def _found(self, chain: _Chain) -> Iterator[Outcome]:
        while chain.waiting and (row := chain.find()):
            yield from chain.settled(row, found=True)

    def _begin(self) -> Iterator[Outcome]:
        """Give the executor what it can take, and nobody else has begun."""
        for _ in range(len(self.waiting)):
            if len(self._running) >= self._limit:
                break
            chain = self.waiting.popleft()
            yield from self._found(chain)
            if not chain.waiting:
                continue
            if not chain.store.claim(chain.waiting[0]):
                self.waiting.append(chain)
            elif chain.find():  # finished since we looked
                chain.store.release(chain.waiting[0])
                self.waiting.appendleft(chain)
            else:
                self._submit(chain)

    def _submit(self, chain: _Chain) -> None:
        arguments = chain.sent, chain.waiting[0]
        try:
            future = self._executor.submit(_attempt, *arguments)
        except BrokenExecutor as error:
            self._replace(error)
            future = self._executor.submit(_attempt, *arguments)
        self._running[future] = chain

    def _replace(self, reason: BaseException) -> None:
        """Go on in processes of our own when somebody else's executor is broken."""
        if self._own:  # already replaced
            return
        warnings.warn(
            f"the executor is broken ({type(reason).__name__}: {reason}): new processes go on",
            StudyWarning,
            stacklevel=level_outside(),
        )
        self._executor = self._own = Processes(None, self._threads)
        self._limit = min(self._limit, self._own.workers)

    def _finish(self) -> Iterator[Outcome]:
        """Wait until a case is finished, here or elsewhere."""
        if not self._running:
            if self.waiting:
                time.sleep(POLL)
            return
        others = self.waiting and len(self._running) < self._limit
        done = wait(self._running, POLL if others else None, FIRST_COMPLETED).done
        for future in done:
            yield from self._take(future)

    def _take(self, future: "Future[Any]") -> Iterator[Outcome]:
        """What has become of a case."""
        chain = self._running.pop(future)
        parameters = chain.waiting[0]
        try:
            outcome = future.result()
        except (Exception, CancelledError) as error:
            chain.store.release(parameters)
            yield from self._lost(chain, error)
            return
        if isinstance(outcome, Failure):
            chain.store.release(parameters)
            yield chain.failed(outcome.error)
            return
        kept = self._keep(chain.store, outcome)
        chain.store.release(parameters)
        settled = chain.settled(kept, found=kept is not outcome)
        if chain.waiting:
            self.waiting.append(chain)
        yield from settled

    def _lost(self, chain: _Chain, error: Exception) -> Iterator[Outcome]:
        """Begin a case again, which has come to nothing by no fault of its function, or give up."""
        if isinstance(error, BrokenExecutor):  # with many cases at once, of which one is to blame
            self._replace(error)
            self.waiting.append(chain)
        elif isinstance(error, WorkerLostError) and chain.attempts + 1 < ATTEMPTS:
            chain.attempts += 1
            self.waiting.append(chain)
        elif isinstance(error, WorkerLostError) and not error.began:
            raise error
        else:
            yield chain.failed(error)

    def _keep(self, store: Store, row: Row) -> Row:
        """Write a row, and those that could not be written before."""
        try:
            row = store.put(row)
        except (OSError, ValueError) as error:  # no room, or someone has spoilt the file
            if not self._unsaved:
                warnings.warn(
                    f"{store.path} cannot be written ({reason_of(error)}): finished rows are kept "
                    "in memory until it can",
                    StudyWarning,
                    stacklevel=level_outside(),
                )
            self._unsaved.append((store, row))
            self._reason = error
        else:
            self._retry()
        return row

    def _retry(self) -> None:
        while self._unsaved:
            store, row = self._unsaved[0]
            try:
                store.put(row)
            except (OSError, ValueError) as error:
                self._reason = error
                return
            self._unsaved.pop(0)

    def _stop(self) -> None:
        """Leave nothing behind: keep what is finished, end what runs."""
        for future in self._running:
            future.cancel()
        if self._own:
            self._own.kill()
        for future, chain in self._running.items():
            good = future.done() and not future.cancelled() and not future.exception()
            if good and isinstance(row := future.result(), Row):
                self._keep(chain.store, row)
        self._retry()
        for store in self._stores:
            store.close()
