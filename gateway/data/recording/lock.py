"""Lock file of a recording: one writer at a time, as the writer of a killed run may still be active at the next run."""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from drives.file_lock import lock_file
from gateway.errors import InputError

_LOOK_S = 0.02


@contextmanager
def sole_writer(path: Path, patience_s: float) -> Generator[None]:
    """Hold the lock of a recording; a lock file whose process has ended is ignored.

    Parameters
    ----------
    path : Path
        The recording.
    patience_s : float
        Time to wait for another writer to end.

    Raises
    ------
    InputError
        Another process still writes it, or the folder is not writable.
    """
    mark = path.with_name(path.name + ".lock")
    until_s = time.monotonic() + patience_s
    try:
        while (descriptor := _taken(mark)) is None:
            if time.monotonic() >= until_s:
                raise InputError(f"{path}: another run is writing it; wait for its end, or choose another name")
            time.sleep(_LOOK_S)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    try:
        yield
    finally:
        mark.unlink(missing_ok=True)
        os.close(descriptor)


def _taken(mark: Path) -> int | None:
    """Return the locked file; None if another process holds it or has just deleted it."""
    descriptor = os.open(mark, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        lock_file(descriptor)
        if os.path.samestat(os.fstat(descriptor), os.stat(mark)):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None
