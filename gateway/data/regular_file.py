"""Read regular files of bounded size; pipes and devices are rejected, as they have no size and may never end."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from gateway.errors import InputError

#: Largest file that is read into memory [bytes].
MOST_BYTES = 2_000_000_000


def regular_size(path: Path) -> int:
    """Return the size of a regular file [bytes].

    Raises
    ------
    InputError
        The file does not exist, is not a regular file, or is larger than `MOST_BYTES`.
    """
    try:
        return _checked_size(path.stat(), MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}; name a regular file of at most {MOST_BYTES / 1e9:g} GB") from error


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file; a device, a pipe or a socket is never read, and the call does not block.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    ValueError
        It is not a regular file, or is larger than `most_bytes`; the message is the reason.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))  # Windows has no named pipes among its files
    try:
        size = _checked_size(os.fstat(descriptor), most_bytes)
        with open(descriptor, "rb", closefd=False) as stream:
            return stream.read(size)  # a file that grows meanwhile is cut
    finally:
        os.close(descriptor)


def _checked_size(status: os.stat_result, most_bytes: int) -> int:
    if not stat.S_ISREG(status.st_mode):
        what = "a folder" if stat.S_ISDIR(status.st_mode) else "a device, pipe or socket"
        raise ValueError(f"it is {what}")
    if status.st_size > most_bytes:
        raise ValueError(f"it has {status.st_size / 1e6:.3g} MB, the limit is {most_bytes / 1e6:.3g} MB")
    return status.st_size
