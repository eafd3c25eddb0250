"""Worker processes of which each can die alone, and none outlives the process that started it.

The pool of the standard library is lost as a whole when one of its processes is killed. Here each
worker has a thread that starts it, hands it one call after the other, and starts another one in its
place when it is gone.
"""

import functools
import io
import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from esfem_core.checks import whole_number
from esfem_core.solvers import BLAS_THREADS, processors

try:
    import cloudpickle
except ImportError:  # functions of a notebook then stay where they are
    cloudpickle = None

__all__ = ["Processes", "WorkerLostError", "pickled", "transportable"]

THREADS = ("OMP_NUM_THREADS", *BLAS_THREADS, "NUMEXPR_NUM_THREADS")
"""Variables that the libraries under NumPy and SciPy read when they are loaded."""

CACHED = type(functools.cache(abs))

GROUPS = hasattr(os, "setpgid")
"""Whether processes have groups that can be ended as a whole."""

_starting = threading.Lock()


class WorkerLostError(RuntimeError):
    """The process that computed something ended in the middle of it.

    Attributes
    ----------
    began : bool
        False if it ended before it could compute anything.
    """

    def __init__(self, message: str, began: bool = True) -> None:
        super().__init__(message)
        self.began = began


def pickled(function: Callable[..., Any]) -> bytes:
    """A function as another process can read it.

    Raises
    ------
    ValueError
        If it cannot be sent; with what to do about it.
    """
    text = ""
    try:
        if cloudpickle:
            return _by_value(function)
        main = sys.modules["__main__"]
        if getattr(function, "__module__", None) != "__main__" or hasattr(main, "__file__"):
            return pickle.dumps(function)
    except Exception as error:
        text = f" ({type(error).__name__}: {error})"
    install = "" if cloudpickle else "install cloudpickle (pip install cloudpickle), "
    raise ValueError(
        f"compute must be a function that another process can read, but "
        f"{getattr(function, '__qualname__', function)!r} cannot be sent to one{text}: {install}"
        "put it into a module, or compute in this process with workers=0"
    )


def _by_value(function: Callable[..., Any]) -> bytes:
    """Bytes of a function, with what it reaches in a notebook or a script."""

    class Pickler(cloudpickle.Pickler):  # type: ignore[misc]
        def reducer_override(self, obj: Any) -> Any:
            if isinstance(obj, CACHED) and obj.__module__ == "__main__":  # else sent by name
                return _cached, (obj.__wrapped__, obj.cache_parameters())
            return super().reducer_override(obj)

    file = io.BytesIO()
    Pickler(file).dump(function)
    return file.getvalue()


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    cached: Callable[..., Any] = functools.lru_cache(**options)(function)
    return cached


def transportable(error: BaseException) -> Exception:
    """An exception that arrives in another process as what it is, with the place of its origin."""
    where = "".join(traceback.format_exception(error))
    try:
        text = str(error)
    except Exception:  # a slip in the class of a reader
        text = "<no text>"
    if isinstance(error, SystemExit):
        error = RuntimeError(f"the case ended with sys.exit({error.code!r})")
    elif not isinstance(error, Exception):
        error = RuntimeError(f"the case raised {type(error).__name__}: {text}")
    try:
        found = pickle.loads(pickle.dumps(error))
        if type(found) is not type(error) or str(found) != str(error):
            raise TypeError
        found.add_note(where)
    except Exception:  # one that cannot be sent, or takes no note
        found = RuntimeError(f"{type(error).__name__}: {text}")
        found.add_note(where)
    return found  # type: ignore[no-any-return]


class Processes(Executor):
    """An executor whose processes are started afresh when they die.

    Parameters
    ----------
    workers : int, optional
        Number of processes; one for each core if None.
    threads : int, optional
        Number of threads of the numerical libraries in each; what the environment says if None.

    Raises
    ------
    TypeError, ValueError
        If a number is no positive integer.
    RuntimeError
        If this is itself a process that begins, see :func:`esfem_core.study.run`.
    """

    def __init__(self, workers: int | None = None, threads: int | None = 1) -> None:
        self.workers = whole_number("workers", processors() if workers is None else workers, 1)
        self._threads = None if threads is None else whole_number("threads", threads, 1)
        if getattr(multiprocessing.process.current_process(), "_inheriting", False):
            raise RuntimeError(GUARD)
        self._calls: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._hands: list[threading.Thread] = []
        self._living: set[multiprocessing.process.BaseProcess] = set()
        self._lock = threading.Lock()
        self._closed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Call a function in one of the processes."""
        if self._closed:
            raise RuntimeError("cannot schedule new futures after shutdown")
        future: Future[Any] = Future()
        self._calls.put((future, (cloudpickle or pickle).dumps((fn, args, kwargs))))
        if len(self._hands) < self.workers:
            self._hands.append(threading.Thread(target=self._serve, daemon=True))
            self._hands[-1].start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when they have computed what was submitted."""
        self._closed = True
        if cancel_futures:
            with suppress(queue.Empty):
                while call := self._calls.get_nowait():
                    call[0].cancel()
        for _ in self._hands:
            self._calls.put(None)
        if wait:
            for hand in self._hands:
                hand.join()

    def kill(self) -> None:
        """End the processes at once, whatever they compute."""
        with self._lock:
            self._closed = True
            living = list(self._living)
        for process in living:
            _kill(process)
        self.shutdown(cancel_futures=True)

    def _serve(self) -> None:
        """Hand calls to one process, and to the next one when it is gone."""
        worker: _Worker | None = None
        while call := self._calls.get():
            future, payload = call
            if not future.set_running_or_notify_cancel():
                continue
            try:
                if worker is None:
                    worker = self._start()
                answer = worker.call(payload)
            except BaseException as error:
                if worker:
                    self._let_go(worker)
                    worker = None
                future.set_exception(error)
            else:
                good, value = answer
                if good:
                    future.set_result(value)
                else:
                    future.set_exception(value)
        if worker:
            self._let_go(worker)

    def _start(self) -> "_Worker":
        with self._lock:
            if self._closed:
                raise WorkerLostError("the study has been ended")
            worker = _Worker(self._threads)
            self._living.add(worker.process)
        try:
            worker.greet()
        except BaseException:
            self._living.discard(worker.process)
            raise
        return worker

    def _let_go(self, worker: "_Worker") -> None:
        worker.end()
        self._living.discard(worker.process)


class _Worker:
    """A process, seen from the one that started it."""

    def __init__(self, threads: int | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other,), daemon=True)
        with _environment(threads):
            self.process.start()
        other.close()

    def greet(self) -> None:
        """Wait until it is ready."""
        try:
            self.pipe.recv_bytes()
        except (EOFError, OSError):
            raise WorkerLostError(
                f"a process {self._how_it_ended()} before it began. {GUARD}", False
            ) from None

    def call(self, payload: bytes) -> tuple[bool, Any]:
        """Let it call a function: whether that succeeded, and the result or the error."""
        try:
            self.pipe.send_bytes(payload)
            answer = self.pipe.recv_bytes()
        except (EOFError, OSError):
            raise WorkerLostError(f"the process that computed it {self._how_it_ended()}") from None
        found: tuple[bool, Any] = pickle.loads(answer)
        return found

    def end(self) -> None:
        """Let it go."""
        self.pipe.close()
        self.process.join(5)
        _kill(self.process)
        self.process.join()

    def _how_it_ended(self) -> str:
        self.pipe.close()
        self.process.join(5)
        code = self.process.exitcode
        if code is not None and code < 0:
            with suppress(ValueError):
                name = signal.Signals(-code).name
                return f"was killed by {name}{' (for want of memory?)' * (name == 'SIGKILL')}"
        return f"ended with exit code {code}"


GUARD = (
    'In a script, what starts a study must stand under `if __name__ == "__main__":`, since each '
    "worker process reads the script; one that comes from the standard input cannot be read again: "
    "make it a file, or compute with workers=0"
)


@contextmanager
def _environment(threads: int | None) -> Iterator[None]:
    """Have processes that are started here use so many threads."""
    with _starting:
        before = {name: os.environ.get(name) for name in THREADS}
        if threads is not None:
            os.environ.update(dict.fromkeys(THREADS, str(threads)))
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


def _kill(process: multiprocessing.process.BaseProcess) -> None:
    """End a process, and where there are groups of them, those that it has started."""
    if GROUPS and process.pid:
        with suppress(OSError):  # it has ended, or not begun
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def _work(pipe: Connection) -> None:
    """Compute what comes through a pipe, until nothing more can come."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who starts us also ends us
    multiprocessing.current_process().daemon = False  # which could have no processes of its own
    if GROUPS:
        os.setpgid(0, 0)  # with all that a case starts
    threading.Thread(target=_end_with_parent, daemon=True).start()
    own = os.getpid()
    with suppress(EOFError, OSError):
        pipe.send_bytes(b"")
        while True:
            payload = pipe.recv_bytes()
            try:
                function, args, kwargs = pickle.loads(payload)
                answer = (cloudpickle or pickle).dumps((True, function(*args, **kwargs)))
            except BaseException as error:
                answer = pickle.dumps((False, transportable(error)))
            if os.getpid() != own:  # of a case that has forked: one process answers, once
                os._exit(0)
            pipe.send_bytes(answer)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent:
        parent.join()
        if GROUPS:
            os.killpg(0, signal.SIGKILL)
        os._exit(1)
