"""Processes that this one has started, and waiting for what they do."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path


def wait_until(met: Callable[[], object], limit_s: float = 30.0) -> None:
    """Wait; fails after a time."""
    end_s = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie without a waiting parent has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def children() -> list[str]:
    """Numbers of the processes, in the order of their start."""
    return [pid for task in Path("/proc/self/task").iterdir() for pid in (task / "children").read_text().split()]


def pid_of(program: str) -> int:
    """Number of the process that runs a module; the last one started."""
    # between fork and exec it has no arguments
    while not (found := [pid for pid in children() if program.encode() in Path(f"/proc/{pid}/cmdline").read_bytes()]):
        time.sleep(0.001)
    return int(found[-1])
