"""Several threads at work on one thing, with the same bits for every number of them.

The work is divided into pieces that do not depend on the number of threads. Each piece writes to a
place of its own, and what has to be summed over pieces is summed afterwards, in their order. NumPy
and SciPy let other threads go on while they compute, so that pieces of a tenth of a millisecond or
more are worth it; shorter ones should not be made. Meanwhile BLAS works on one thread: its threads
and these would be in each other's way.
"""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache, lru_cache
from importlib import import_module
from multiprocessing import parent_process
from threading import Lock, current_thread, main_thread
from typing import Any, TypeVar

from esfem_core.checks import whole_number

__all__ = [
    "BLAS_THREADS",
    "MOST_THREADS",
    "pieces",
    "processors",
    "side_by_side",
    "thread_count",
    "using_threads",
]

MOST_THREADS = 256
"""Most threads that may be asked for."""

BLAS_THREADS = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment variables that say how many threads NumPy's linear algebra takes."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_chosen: ContextVar[int | None] = ContextVar("chosen", default=None)


def thread_count() -> int:
    """How many threads share the work.

    In browsers 1; elsewhere as many as :func:`using_threads` says; else as the environment variable
    ``OMP_NUM_THREADS`` says; else 1 in worker processes and in threads other than the main one,
    where the processors are taken; else one for each processor that this process may use, if BLAS
    can be held to one thread, by the package threadpoolctl (extra ``fast``) or an environment
    variable such as ``OPENBLAS_NUM_THREADS=1``; else 1.

    Examples
    --------
    >>> with using_threads(3):
    ...     thread_count()
    3
    """
    if sys.platform == "emscripten":
        return 1
    chosen = _chosen.get()
    if chosen is not None:
        return chosen
    said = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    if said.isdecimal() and int(said) > 0:
        return min(int(said), MOST_THREADS)
    if parent_process() is not None or current_thread() is not main_thread():
        return 1
    if _blas_pools() is None and not any(os.environ.get(name) == "1" for name in BLAS_THREADS):
        return 1
    return min(processors(), MOST_THREADS)


def processors() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def using_threads(number: int | None) -> Iterator[None]:
    """Let so many threads share the work inside a ``with``, and BLAS work on one.

    Parameters
    ----------
    number : int or None
        1 to 256; None for as many as outside.

    Raises
    ------
    TypeError, ValueError
        If it is another.
    """
    if number is not None:
        number = whole_number("threads", number, 1, MOST_THREADS)
    token = _chosen.set(thread_count() if number is None else number)
    _blas.hold()
    try:
        yield
    finally:
        _blas.release()
        _chosen.reset(token)


def side_by_side(
    function: Callable[[Item], Result], items: Iterable[Item], worth: bool = True
) -> list[Result]:
    """Call a function for each item, on as many threads as :func:`thread_count` says.

    Parameters
    ----------
    function : callable
        Its calls must not depend on each other. Inside it all goes on one thread.
    items : iterable
    worth : bool
        False if all of it is too short to be shared.

    Returns
    -------
    list
        The results in the order of the items.

    Raises
    ------
    Exception
        What the first item that fails raises.

    Examples
    --------
    >>> with using_threads(2):
    ...     side_by_side(lambda piece: sum(range(10)[piece]), pieces(10, 4))
    [6, 22, 17]
    """
    if not worth or thread_count() == 1:
        return [function(item) for item in items]
    if _chosen.get() is None:
        with using_threads(None):
            return side_by_side(function, items)
    todo = deque(enumerate(items))
    number = min(thread_count(), len(todo))
    results: dict[int, Result] = {}
    failures: dict[int, BaseException] = {}

    def work() -> None:
        _chosen.set(1)
        while todo:
            try:
                i, item = todo.popleft()
            except IndexError:  # another thread was faster
                return
            try:
                results[i] = function(item)
            except BaseException as error:
                failures[i] = error
                todo.clear()

    others = [_pool(number - 1).submit(copy_context().run, work) for _ in range(number - 1)]
    copy_context().run(work)
    for other in others:
        if not other.cancel():  # it has begun
            other.result()
    if failures:
        raise failures[min(failures)]
    return [results[i] for i in sorted(results)]


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="esfem_core")


class _Blas:
    """Holds the threads of BLAS back while any of ours, of whatever caller, are at work."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._holders = 0
        self._before: Any = None

    def hold(self) -> None:
        with self._lock:
            self._holders += 1
            pools = _blas_pools()
            if self._holders == 1 and pools is not None:
                self._before = pools.limit(limits=1)

    def release(self) -> None:
        with self._lock:
            self._holders -= 1
            if self._holders == 0 and self._before is not None:
                self._before.restore_original_limits()
                self._before = None


_blas = _Blas()


def _blas_pools() -> Any:
    """What can hold BLAS back; None where threadpoolctl is not installed."""
    return _blas_pools_with(len(sys.modules))


@lru_cache(maxsize=1)
def _blas_pools_with(_: int) -> Any:
    """The same, looked for again with every number of modules: one may have loaded another BLAS."""
    try:
        return import_module("threadpoolctl").ThreadpoolController().select(user_api="blas")
    except ImportError:
        return None


if hasattr(os, "register_at_fork"):  # a forked process has none of these threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def pieces(length: int, size: int) -> list[slice]:
    """Slices of at most `size` numbers that cover 0 to `length`.

    Examples
    --------
    >>> pieces(10, 4)
    [slice(0, 4, None), slice(4, 8, None), slice(8, 10, None)]
    """
    return [slice(i, min(i + size, length)) for i in range(0, length, size)]
