"""What the system allows a loop that has to be on time: a real-time priority, and memory that is never swapped out."""

from __future__ import annotations

import os
import resource
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RealTimeStatus:
    """Whether this process may be scheduled in real time.

    Attributes
    ----------
    fifo : bool
        SCHED_FIFO is allowed.
    locked : bool
        All memory may be locked.
    why : str
        What stands against it; empty where nothing does.
    """

    fifo: bool
    locked: bool
    why: str


def available() -> RealTimeStatus:
    """What the limits of this process allow; nothing is changed."""
    root = os.geteuid() == 0
    fifo = root or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] > 0
    locked = root or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    missing = [name for name, allowed in (("rtprio", fifo), ("memlock", locked)) if not allowed]
    return RealTimeStatus(fifo, locked, f"limits {' and '.join(missing)} of this user" if missing else "")
