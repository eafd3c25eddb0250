"""Files that are whole at any moment, and that one run writes and no other."""

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

__all__ = ["FULL", "OwnFile", "write_whole"]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors of a full disk, or of what one may have of it."""


def write_whole(path: Path, data: bytes) -> None:
    """Write a file; at any moment, also on a full disk, the old or the new one is there whole.

    The bytes go to a hidden file beside it, are forced to the disk, and take its place in one step.
    Of several processes that write one file at once, the last one's is there. The new one has the
    permissions of the old one, and its group where the system lets it. One that is write-protected
    stays, also if it was protected in the middle of a run.

    Parameters
    ----------
    path : Path
    data : bytes

    Raises
    ------
    OSError
        If it cannot be written, with the name of the file; an older one is untouched.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     write_whole(Path(folder, "run.txt"), b"done")
    ...     [file.name for file in Path(folder).iterdir()]
    ['run.txt']
    """
    path = path.resolve()  # a link stays a link
    # A name that no other writer takes, and that is not too long where that of the file is not.
    # Unlike tempfile, open gives it the permissions of any new file.
    beside = path.with_name(f".{uuid4().hex}.part")
    try:
        _require_unprotected(path)
        with beside.open("xb") as file:
            _permit_as(path, beside)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException as error:
        with suppress(OSError):
            beside.unlink()
        if not isinstance(error, OSError):
            raise
        advice = "make room, or choose" if error.errno in FULL else "choose"
        reason = f"{error.strerror}; the file is as it was: {advice} another place"
        raise OSError(error.errno, reason, str(path)) from error


def _require_unprotected(path: Path) -> None:
    """Refuse to replace what may not be written to, though its directory would do."""
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "It is write-protected")


def _permit_as(old: Path, new: Path) -> None:
    """Give a file the group and the permissions of the one whose place it is to take."""
    with suppress(OSError):  # there is none, or who writes is not in that group
        if hasattr(os, "chown"):  # not on Windows
            os.chown(new, -1, old.stat().st_gid)
    with suppress(OSError):  # there is none, or the file system knows no permissions
        shutil.copymode(old, new)


class OwnFile:
    """A file that one run writes again and again, which it leaves alone when another one has.

    Examples
    --------
    >>> path = getfixture("tmp_path") / "run.csv"
    >>> own = OwnFile(path)
    >>> size = path.write_text("t,u")
    >>> own.written()
    >>> own.check()
    >>> size = path.write_text("the line of another")
    >>> own.check()
    Traceback (most recent call last):
        ...
    FileExistsError: [Errno 17] something else, such as another run, writes to it...run.csv'
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.written()

    def written(self) -> None:
        """Take the file that is there for that of this run, after each of its own writes."""
        self._found = _identity(self._path)

    def is_another(self) -> bool:
        """Whether the file is another than it was; one that was removed may be written anew."""
        return _identity(self._path) not in (self._found, None)

    def check(self) -> None:
        """Refuse a file that is another than it was."""
        if self.is_another():
            reason = "something else, such as another run, writes to it, too: choose another path"
            raise FileExistsError(errno.EEXIST, reason, str(self._path))


def _identity(path: Path) -> tuple[int, int, int] | None:
    """What tells the file that is there from any that takes its place; None if there is none."""
    try:
        file = path.stat()
    except OSError:
        return None
    return file.st_ino, file.st_mtime_ns, file.st_size
