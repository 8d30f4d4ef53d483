"""What the operating system gives, in a system of its own: no test runs under a real-time scheduler."""

from __future__ import annotations

import ctypes
import os
import resource
from pathlib import Path

import pytest

from drives.realtime import RealTime, available, leave_real_time


class System:
    """The calls that are made, and what is permitted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, permitted: bool) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.permitted = permitted
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_OTHER)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(0))
        monkeypatch.setattr(os, "sched_setscheduler", self._set)
        monkeypatch.setattr(Path, "read_text", lambda path: f"CapEff:\t{0xFFFFFFFF * permitted:016x}")
        monkeypatch.setattr(resource, "getrlimit", lambda number: (0, 0))
        monkeypatch.setattr(ctypes, "CDLL", lambda name, use_errno: self)

    def _set(self, pid: int, policy: int, parameter: os.sched_param) -> None:
        if not self.permitted:
            raise PermissionError(1, "Operation not permitted")
        self.calls.append(("scheduler", policy, parameter.sched_priority))

    def mlockall(self, flags: int) -> int:
        self.calls.append(("mlockall", flags))
        return 0

    def munlockall(self) -> int:
        self.calls.append(("munlockall",))
        return 0


def test_what_was_given_is_given_back(monkeypatch):
    system = System(monkeypatch, permitted=True)
    with RealTime() as status:
        assert (status.fifo, status.locked, status.why) == (True, True, "")
        assert system.calls == [("scheduler", os.SCHED_FIFO, 40), ("mlockall", 3)]
    assert system.calls[2:] == [("scheduler", os.SCHED_OTHER, 0), ("munlockall",)]


def test_where_nothing_is_permitted_nothing_happens_and_the_reason_is_reported(monkeypatch):
    system = System(monkeypatch, permitted=False)
    with RealTime() as status:
        assert (status.fifo, status.locked) == (False, False)
    assert "rtprio 40" in status.why
    assert "memlock" in status.why
    assert system.calls == []


def test_it_is_given_back_after_an_error_too(monkeypatch):
    system = System(monkeypatch, permitted=True)
    with pytest.raises(ZeroDivisionError), RealTime():
        raise ZeroDivisionError
    assert ("munlockall",) in system.calls


@pytest.mark.parametrize("permitted", [True, False])
def test_asking_changes_nothing_and_says_what_would_be_given(monkeypatch, permitted):
    system = System(monkeypatch, permitted)
    status = available()
    assert (status.fifo, status.locked, bool(status.why)) == (permitted, permitted, not permitted)
    assert system.calls == []


def test_a_scheduler_that_cannot_be_set_back_is_reported(monkeypatch):
    system = System(monkeypatch, permitted=True)
    asked = RealTime()
    with asked:
        system.permitted = False
    assert asked.status.fifo
    assert "cannot be set back" in asked.status.why


@pytest.mark.parametrize("permitted", [True, False])
def test_a_thread_may_leave_what_it_inherited(monkeypatch, permitted):
    system = System(monkeypatch, permitted)
    leave_real_time()
    assert system.calls == ([("scheduler", os.SCHED_OTHER, 0)] if permitted else [])


def test_memory_that_cannot_be_locked_is_reported_and_not_unlocked(monkeypatch):
    system = System(monkeypatch, permitted=True)
    system.mlockall = lambda flags: -1  # type: ignore[method-assign]
    with RealTime() as status:
        assert (status.fifo, status.locked) == (True, False)
        assert "memory is not locked" in status.why
    assert ("munlockall",) not in system.calls


#: Bits 14 (CAP_IPC_LOCK) and 23 (CAP_SYS_NICE) of linux/capability.h.
LOCK, NICE = 1 << 14, 1 << 23
GIB = 1 << 30


@pytest.mark.parametrize(
    ("effective", "rtprio", "memlock", "fifo", "locked"),
    [
        (0, 0, 0, False, False),
        (NICE, 0, 0, True, False),
        (LOCK, 0, 0, False, True),
        (~(LOCK | NICE) & (1 << 40) - 1, 0, 0, False, False),
        (0, 39, 4 * GIB - 1, False, False),
        (0, 40, 4 * GIB, True, True),
        (0, resource.RLIM_INFINITY, resource.RLIM_INFINITY, True, True),
    ],
)
def test_what_is_permitted_is_read_from_capabilities_and_limits(monkeypatch, effective, rtprio, memlock, fifo, locked):
    soft = {resource.RLIMIT_RTPRIO: rtprio, resource.RLIMIT_MEMLOCK: memlock}
    monkeypatch.setattr(resource, "getrlimit", lambda number: (soft[number], resource.RLIM_INFINITY))
    monkeypatch.setattr(Path, "read_text", lambda _: f"Name:\tx\nCapPrm:\t{'f' * 16}\nCapEff:\t{effective:016x}\n")
    status = available()
    assert (status.fifo, status.locked) == (fifo, locked)
    assert ("rtprio" in status.why, "memlock" in status.why) == (not fifo, not locked)


def test_a_system_without_capabilities_and_limits_gives_nothing(monkeypatch):
    def unreadable(_: Path) -> str:
        raise FileNotFoundError

    monkeypatch.setattr(Path, "read_text", unreadable)
    monkeypatch.delattr(resource, "RLIMIT_RTPRIO")
    monkeypatch.delattr(resource, "RLIMIT_MEMLOCK")
    status = available()
    assert (status.fifo, status.locked) == (False, False)
