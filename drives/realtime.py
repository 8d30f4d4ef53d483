"""Request real-time scheduling and locked memory from the operating system for the motion loop.

Both are optional. They are requested while arms move and released afterwards: a loop that spins under a real-time
scheduler can starve everything else on its processor.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

#: Priority under SCHED_FIFO: above normal threads, below the interrupt threads (50) that bring the frames in.
_PRIORITY: Final = 40
#: Of mlockall (sys/mman.h): pages that are there, pages that will be.
_MCL_CURRENT: Final = 1
_MCL_FUTURE: Final = 2
#: Memory that is locked at least; with less allowed, locking what is to come would make the program fail later.
_LEAST_BYTES: Final = 4 << 30
#: Numbers of capabilities (linux/capability.h).
_CAP_IPC_LOCK: Final = 14
_CAP_SYS_NICE: Final = 23


@dataclass(frozen=True, slots=True)
class RealTimeStatus:
    """Real-time rights granted by the operating system.

    Attributes
    ----------
    fifo : bool
        SCHED_FIFO for the calling thread.
    locked : bool
        Memory is not swapped out.
    why : str
        What is missing and how to permit it; empty where nothing is missing.
    """

    fifo: bool
    locked: bool
    why: str = ""


class RealTime:
    """SCHED_FIFO for the calling thread and locked memory, as far as permitted, until `__exit__`.

    To be left by the thread that entered it. Never raises where something is not permitted.

    Attributes
    ----------
    status : RealTimeStatus
        Granted rights; none before the context is entered.
    """

    def __init__(self) -> None:
        self.status = RealTimeStatus(fifo=False, locked=False, why="not requested yet")
        self._before: tuple[int, os.sched_param] | None = None

    def __enter__(self) -> RealTimeStatus:
        missing: list[str] = []
        fifo = self._schedule(missing)
        locked = _lock_memory(missing)
        self.status = RealTimeStatus(fifo, locked, "; ".join(missing))
        return self.status

    def _schedule(self, missing: list[str]) -> bool:
        try:
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        except (OSError, AttributeError) as error:
            missing.append(_no_fifo(error))
            return False
        self._before = before
        return True

    def __exit__(self, *exception: object) -> None:
        if self._before is not None:
            policy, parameter = self._before
            self._before = None
            try:
                os.sched_setscheduler(0, policy, parameter)
            except OSError as error:
                self.status = RealTimeStatus(True, False, f"the scheduler cannot be set back: {error}")
        if self.status.locked:
            _libc_call("munlockall")


def leave_real_time() -> None:
    """Set default scheduling for the calling thread, because threads and processes inherit their parent's."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def available() -> RealTimeStatus:
    """Return the rights that `RealTime` would obtain by the limits of this process; nothing is changed."""
    missing: list[str] = []
    fifo = hasattr(os, "SCHED_FIFO") and (_capable(_CAP_SYS_NICE) or _limit("RLIMIT_RTPRIO") >= _PRIORITY)
    if not fifo:
        missing.append(_no_fifo("not permitted"))
    locked = _libc_has("mlockall") and _may_lock()
    if not locked:
        missing.append(_no_lock("not permitted"))
    return RealTimeStatus(fifo, locked, "; ".join(missing))


def _no_fifo(error: object) -> str:
    return f"no real-time scheduler ({error}): permit it with rtprio {_PRIORITY} in /etc/security/limits.conf"


def _no_lock(error: object) -> str:
    return f"memory is not locked ({error}): permit it with memlock unlimited in /etc/security/limits.conf"


def _limit(name: str) -> float:
    """Soft limit of this process; infinite where there is none, 0 where the system does not support it."""
    try:
        import resource  # Windows has none
    except ImportError:
        return 0.0
    number = getattr(resource, name, None)
    if number is None:
        return 0.0
    soft, _ = resource.getrlimit(number)
    return float("inf") if soft == resource.RLIM_INFINITY else float(soft)


def _capable(number: int) -> bool:
    """Return whether this process has a Linux capability; root in a container may lack it."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return False
    return any(line.startswith("CapEff:") and int(line.split()[1], 16) >> number & 1 for line in lines)


def _may_lock() -> bool:
    return _capable(_CAP_IPC_LOCK) or _limit("RLIMIT_MEMLOCK") >= _LEAST_BYTES


def _lock_memory(missing: list[str]) -> bool:
    if not _may_lock():
        missing.append(_no_lock("the limit is too low"))
        return False
    error = _libc_call("mlockall", _MCL_CURRENT | _MCL_FUTURE)
    if error:
        missing.append(_no_lock(error))
    return not error


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _libc_has(name: str) -> bool:
    try:
        return hasattr(_libc(), name)
    except (OSError, TypeError):
        return False


def _libc_call(name: str, *arguments: int) -> str:
    """Call a C library function; return "" on success, else the error text."""
    if not _libc_has(name):
        return "not supported by this system"
    ctypes.set_errno(0)
    return "" if getattr(_libc(), name)(*arguments) == 0 else os.strerror(ctypes.get_errno())
