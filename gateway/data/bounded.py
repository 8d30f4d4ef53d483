"""Files of others, read as bytes: regular files alone, no larger than a stated bound."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Content of a regular file; a device, a pipe or a socket is not opened for reading, and nothing blocks.

    Raises
    ------
    OSError
        It cannot be opened or read.
    ValueError
        It is no regular file, or larger than `most_bytes`; the message is the reason, in a few words.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))  # Windows has no named pipes among its files
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("it is a folder, a device, a pipe or a socket, a regular file is needed")
        if status.st_size > most_bytes:
            raise ValueError(f"it has {status.st_size / 1e6:.3g} MB, the limit is {most_bytes / 1e6:.3g} MB")
        with open(descriptor, "rb", closefd=False) as stream:
            return stream.read(status.st_size)  # what it grows by meanwhile is left out
    finally:
        os.close(descriptor)
