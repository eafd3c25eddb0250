"""Locks on numbers, shared through a file: for processes that work on the same results.

A lock ends with the process that holds it, however that ends. Where a file system or an operating
system has no locks, everything can be taken, and a warning says so once.
"""

import errno
import os
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from esfem_core.checks import level_outside

__all__ = ["FileLocks", "StudyWarning"]

fcntl: Any = None
msvcrt: Any = None
if sys.platform == "win32":
    import msvcrt
elif sys.platform != "emscripten":  # no locks in a browser, where there is one process
    import fcntl

BUSY = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
WRITING = 0
"""The number that a process holds while it writes."""

_threads = threading.RLock()  # the system's locks tell processes apart, and not threads


class StudyWarning(UserWarning):
    """A study goes on, but not as it should."""


class FileLocks:
    """Locks on the numbers from 0 to 2**62, as byte ranges of an empty file.

    Parameters
    ----------
    path : Path
        Made when a lock is taken; removed by the last one that closes it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = -1  # opened when it is first asked for a lock

    def take(self, number: int) -> bool:
        """Take a lock if no other process has it; whether that succeeded."""
        if self._file < 0:
            self._file = self._open()
        while self._lock(number):
            if self._is_current():
                return True
            # Another process has removed the file between our opening and our locking it.
            file, self._file = self._file, -1
            os.close(file)
            self._file = self._open()
        return False

    def give_back(self, number: int) -> None:
        """Let others take it."""
        if self._file < 0:  # it could not be opened again
            return
        with suppress(OSError):
            self._set(number, take=False)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Wait until no other process and no other thread writes, and keep them from it."""
        with _threads:
            while not self.take(WRITING):
                time.sleep(0.01)
            try:
                yield
            finally:
                self.give_back(WRITING)

    def close(self) -> None:
        """Give back all locks."""
        if self._file < 0:
            return
        with _threads:  # closing gives back what another thread may hold
            with suppress(OSError):
                if fcntl and self._is_current():
                    fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody holds any
                    self.path.unlink()
            os.close(self._file)
            self._file = -1
        if not fcntl:
            with suppress(OSError):  # another process has it open
                self.path.unlink()

    def _open(self) -> int:
        self.path.parent.mkdir(parents=True, exist_ok=True)  # it may be removed during a study
        return os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)

    def _is_current(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._file), self.path.stat())
        except FileNotFoundError:
            return False

    def _lock(self, number: int) -> bool:
        try:
            self._set(number, take=True)
        except OSError as error:
            if error.errno in BUSY:
                return False
            warnings.warn(
                f"{self.path.parent} is on a file system without locks ({error.strerror}): do not "
                "start a study twice at once",
                StudyWarning,
                stacklevel=level_outside(),
            )
        return True

    def _set(self, number: int, *, take: bool) -> None:
        if fcntl:
            kind = fcntl.LOCK_EX | fcntl.LOCK_NB if take else fcntl.LOCK_UN
            fcntl.lockf(self._file, kind, 1, number)
        elif msvcrt:
            os.lseek(self._file, number, os.SEEK_SET)
            msvcrt.locking(self._file, msvcrt.LK_NBLCK if take else msvcrt.LK_UNLCK, 1)
