"""Files that are whole at any moment."""

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

__all__ = ["FULL", "write_whole"]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors of a full disk, or of what one may have of it."""


def write_whole(path: Path, data: bytes) -> None:
    """Write a file; at any moment, also on a full disk, the old or the new one is there whole.

    The bytes go to a hidden file beside it, are forced to the disk, and take its place in one step.
    Of several processes that write one file at once, the last one's is there. Who could read the
    old one can read the new one, and nobody else.

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


def _permit_as(old: Path, new: Path) -> None:
    """Give a file the permissions of the one whose place it is to take."""
    with suppress(OSError):  # there is none, or the file system knows no permissions
        shutil.copymode(old, new)
