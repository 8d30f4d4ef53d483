"""Lock of a bus between the commands of all users of one computer: one bus has one master.

The lock is an advisory lock on a file (flock), which the kernel releases when the process ends in any way.
"""

from __future__ import annotations

import contextlib
import os
import re
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from drives.bus_spec import BusSpec
from drives.errors import BusError
from drives.files import lock_file

#: Folders that all users of a computer share. The lock is taken in each one that can be used, so that two users who
#: cannot use the same ones still exclude each other by those that they share.
FOLDERS: Final = (Path("/run/lock"), Path("/tmp"))
#: Longest text about the holder that is read.
_HOLDER_BYTES: Final = 200


def lock_name(spec: BusSpec) -> str:
    """Return the name of the lock file of a bus; a `virtual` bus exists in one process only."""
    address = spec.wire + (f",process={os.getpid()}" if spec.interface == "virtual" else "")
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", address)[:80]
    return f"servo-gateway-{readable}-{zlib.crc32(address.encode()):08x}.lock"


@contextmanager
def bus_locked(spec: BusSpec, command: str) -> Generator[None]:
    """Hold the lock of a bus.

    Parameters
    ----------
    spec : BusSpec
    command : str
        Of the holder, for the message of the process that is refused.

    Raises
    ------
    BusError
        Another command holds the lock, or no shared folder can be used.
    """
    if os.name == "nt":  # no flock; commands that move an arm need Linux
        yield
        return
    with contextlib.ExitStack() as stack:
        paths = [folder / lock_name(spec) for folder in FOLDERS]
        files = {path: number for path in paths if (number := _opened(path, stack)) is not None}
        if not files:
            folders = " and ".join(map(str, FOLDERS))
            what = f"bus {spec.name} cannot be locked: no lock file can be opened in {folders}; nothing was sent"
            raise BusError(what, advice="let all users write into one of these folders (mode 1777)")
        for number in files.values():
            try:
                lock_file(number)
            except BlockingIOError:
                holder = os.pread(number, _HOLDER_BYTES, 0).decode(errors="replace").strip() or "another process"
                what = f"bus {spec.name} is in use by {holder}: one bus has one master; nothing was sent"
                advice = "wait until that command has ended, or end it, then start again"
                raise BusError(what, advice=advice) from None
        for path, number in files.items():
            if spec.interface == "virtual":  # no other process looks for its file
                stack.callback(path.unlink, missing_ok=True)
            with contextlib.suppress(OSError):
                os.ftruncate(number, 0)
                os.pwrite(number, f"process {os.getpid()} ({command})".encode(), 0)
        yield


def _opened(path: Path, stack: contextlib.ExitStack) -> int | None:
    """Open a lock file, or create one that all users can open; None where neither is possible.

    Existing files are opened without O_CREAT, which Linux refuses for files of others in a folder with the sticky bit.
    """
    create = os.O_RDWR | os.O_CREAT | os.O_EXCL
    for flags in (os.O_RDWR, os.O_RDONLY, create, os.O_RDWR):  # the last one: another process was faster
        try:
            number = os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError:
            continue
        stack.callback(os.close, number)
        with contextlib.suppress(OSError):  # the umask; of another user's file not allowed and not needed
            os.fchmod(number, 0o666)
        return number
    return None
