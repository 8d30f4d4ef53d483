"""A bare real-time sleeper: what this computer does to a process that only wants to be woken every millisecond."""

from __future__ import annotations

import bisect
import functools
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TypeVar

from benchmarks.chaos.processes import FORK

SLEEP_S = 0.001
#: Above the motion loop's.
PRIORITY = 60

Seen = TypeVar("Seen")


@dataclass(frozen=True, slots=True)
class Sleepers:
    """What sleepers on several cores saw.

    Attributes
    ----------
    stalls : (begin, end) of each time without waking that was longer than asked for, monotonic, in order [s]
    real_time : all of them ran under SCHED_FIFO
    """

    stalls: tuple[tuple[float, float], ...]
    real_time: bool

    def near(self, at_s: float, within_s: float) -> bool:
        """Whether a stall overlaps a time, give or take."""
        behind = bisect.bisect_right(self.stalls, (at_s + within_s, float("inf")))
        return any(end >= at_s - within_s for _, end in self.stalls[max(0, behind - 50) : behind])

    @property
    def longest_s(self) -> float:
        """Longest stall [s]."""
        return max((end - begin for begin, end in self.stalls), default=0.0)


class Sleeper:
    """A process that sleeps on one core and writes down when it was not woken.

    Parameters
    ----------
    core : int
    stall_s : float
        What is longer between two wakings is a stall.
    """

    def __init__(self, core: int, stall_s: float) -> None:
        self._pipe, theirs = FORK.Pipe()
        self._process = FORK.Process(target=_sleep, args=(core, stall_s, theirs))
        self._process.start()
        theirs.close()

    def end(self) -> Sleepers:
        """Wake it for good; what it saw."""
        self._pipe.send("quit")
        stalls, real_time = self._pipe.recv() if self._pipe.poll(10.0) else ([], False)
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        return Sleepers(tuple(stalls), real_time)


def joined(first: Sleepers, second: Sleepers) -> Sleepers:
    """What either saw."""
    return Sleepers(tuple(sorted(first.stalls + second.stalls)), first.real_time and second.real_time)


def watched(run: Callable[[], Seen], stall_s: float) -> tuple[Seen, Sleepers]:
    """What a function returns, and what a sleeper on each core of this process saw meanwhile."""
    sleepers = [Sleeper(core, stall_s) for core in os.sched_getaffinity(0)]
    try:
        seen = run()
    finally:
        both = functools.reduce(joined, [sleeper.end() for sleeper in sleepers])
    return seen, both


def _sleep(core: int, stall_s: float, pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.sched_setaffinity(0, {core})
    real_time = True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        real_time = False
    stalls: list[tuple[float, float]] = []
    before_s = time.monotonic()
    looks = 0
    while looks % 100 or not pipe.poll(0.0):
        looks += 1
        time.sleep(SLEEP_S)
        now_s = time.monotonic()
        if now_s - before_s > SLEEP_S + stall_s:
            stalls.append((before_s, now_s))
        before_s = now_s
    pipe.send((stalls, real_time))
    pipe.close()
