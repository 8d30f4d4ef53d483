"""Size of a file that is to be read whole: a pipe or a device has none, and reading it may never end."""

from __future__ import annotations

import stat
from pathlib import Path

from gateway.errors import InputError

#: Largest file that is taken into memory [bytes].
MOST_BYTES = 2_000_000_000


def regular_size(path: Path, most_bytes: int = MOST_BYTES) -> int:
    """Size of a regular file [bytes].

    Raises
    ------
    InputError
        It is not there, is no regular file, or is larger than `most_bytes`.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not stat.S_ISREG(found.st_mode):
        what = "a folder" if stat.S_ISDIR(found.st_mode) else "a device, pipe or socket"
        raise InputError(f"{path}: is {what}; name a regular file")
    if found.st_size > most_bytes:
        raise InputError(f"{path}: has {found.st_size / 1e9:.3g} GB, {most_bytes / 1e9:g} GB are read at most; cut it")
    return found.st_size
