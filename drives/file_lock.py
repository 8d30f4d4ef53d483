"""Locks between processes on a file; the file may be opened and read on systems that have none."""

from __future__ import annotations

import errno


def lock_file(descriptor: int, *, wait: bool = False) -> None:
    """Lock a file for this process until its descriptor is closed.

    Parameters
    ----------
    descriptor : int
        Of the open file.
    wait : bool
        Wait for another holder; else it is refused at once.

    Raises
    ------
    BlockingIOError
        Another process holds it.
    OSError
        This system has no such locks: what writes a recording or drives needs Linux or macOS.
    """
    try:
        import fcntl  # Windows has none; reading data needs none
    except ImportError as error:
        what = "this system has no file locks: what moves an arm or writes a recording needs Linux"
        raise OSError(errno.ENOTSUP, what) from error
    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
