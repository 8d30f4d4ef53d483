"""What the operating system gives, in a system of its own: no test runs under a real-time scheduler."""

from __future__ import annotations

import ctypes
import os

import pytest

from drives import realtime
from drives.realtime import RealTime, available


class System:
    """The calls that are made, and what is permitted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, permitted: bool) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.permitted = permitted
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_OTHER)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(0))
        monkeypatch.setattr(os, "sched_setscheduler", self._set)
        monkeypatch.setattr(realtime, "_capable", lambda number: permitted)
        monkeypatch.setattr(realtime, "_limit", lambda name: 0.0)
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


def test_where_nothing_is_permitted_nothing_happens_and_the_reason_is_told(monkeypatch):
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
