"""Clocks that schedule SYNC: in real time, and in lockstep a simulated one.

In real time a SYNC is waited for until it is due. Missed SYNCs are skipped and never sent in a burst, and the phase is
kept, because drives synchronise their own clocks to it. The delay of each SYNC is recorded.
"""

from __future__ import annotations

import gc
import math
import time
from collections import deque
from typing import Final

from drives.bus import SYNC_ID, Bus

#: Latenesses that are kept for the quantiles.
KEPT: Final = 10_000
#: Before the deadline the receive path is left this early, the rest is slept and at last spun.
_LEAVE_S: Final = 0.0006
_SPIN_S: Final = 0.00012
#: Lockstep: time for the simulator to process a SYNC that nothing is sent with [s].
_SYNC_PAUSE_S: Final = 0.002


def spare_collections() -> None:
    """Exclude the objects that exist now from garbage collection until `gc.unfreeze`.

    A full garbage collection of a loaded gateway takes 20 to 40 ms, longer than a SYNC period.
    """
    gc.collect()
    gc.freeze()


class SyncClock:
    """SYNC deadlines in real time.

    Parameters
    ----------
    bus : Bus
        Receives and dispatches while waiting.
    period_s : float
        Time between two SYNCs.
    """

    def __init__(self, bus: Bus, period_s: float) -> None:
        self.overruns = 0
        self.lateness_s: deque[float] = deque(maxlen=KEPT)
        self._bus = bus
        self._period_s = period_s
        self._due_s: float | None = None
        self._last_s: float | None = None

    @property
    def paused_s(self) -> float:
        """Return by how much the time since the last SYNC exceeds one period [s]; 0 before the first SYNC."""
        return 0.0 if self._last_s is None else max(0.0, time.monotonic() - self._last_s - self._period_s)

    def sent(self, due_s: float, delay_s: float = 0.0) -> None:
        """Record a SYNC that was due at a monotonic time [s] and was sent later because the transmit queue was full."""
        self._last_s = due_s + delay_s
        if delay_s and self.lateness_s:
            self.lateness_s[-1] += delay_s

    def follow(self, now_s: float) -> None:
        """Adopt the SYNC time [s] of another clock; the following SYNC is scheduled by this clock again."""
        self._due_s = now_s + self._period_s

    def time_s(self, sync_index: int, passed_s: float) -> float:
        """Return the time of a SYNC [s], sent so long after the first one."""
        return passed_s

    def now_s(self) -> float:
        """Return the time that passes for the drives while no cycle runs [s]; only differences have a meaning."""
        return time.monotonic()

    def pause(self, seconds: float) -> None:
        """Let so much time pass for the drives while no cycle runs; frames are received meanwhile."""
        self._bus.listen(seconds)

    def restart(self, at_s: float | None = None) -> None:
        """Restart the schedule: the next SYNC is due now, or at a monotonic time [s] that several clocks share."""
        self._due_s, self._last_s = at_s, None

    def wait(self) -> float:
        """Wait until the next SYNC is due and return the monotonic time [s].

        A deadline that passed more than a period ago, before or while it was waited for, is skipped and counted, not
        made up for.
        """
        now = time.monotonic()
        due = self._due_s
        if due is None:
            self._due_s = now + self._period_s
            return now
        due = self._skipped(due, now)
        while (left := due - time.monotonic()) > _LEAVE_S:
            frame = self._bus.receive(left - _LEAVE_S)
            if frame is not None:
                self._bus.dispatch(frame)
        if left > _SPIN_S:
            time.sleep(left - _SPIN_S)
        while (now := time.monotonic()) < due:
            pass
        self.lateness_s.append(now - due)
        self._due_s = self._skipped(due, now) + self._period_s
        return now

    def _skipped(self, due_s: float, now_s: float) -> float:
        """Return the latest deadline that has passed."""
        missed = int((now_s - due_s) / self._period_s) if now_s > due_s + self._period_s else 0
        self.overruns += missed
        return due_s + missed * self._period_s


class LockstepClock(SyncClock):
    """Simulated time: one period passes with each SYNC, which is due as soon as the last one was answered."""

    _paused_s = 0.0

    @property
    def paused_s(self) -> float:
        """Return 0: no time passes between two SYNCs."""
        return 0.0

    def time_s(self, sync_index: int, passed_s: float) -> float:
        """Return the time of a SYNC [s]: its index times the period."""
        return sync_index * self._period_s

    def now_s(self) -> float:
        """Return the simulated time of all pauses [s]."""
        return self._paused_s

    def pause(self, seconds: float) -> None:
        """Send SYNCs without commands for so much simulated time."""
        for _ in range(math.ceil(seconds / self._period_s)):
            self._bus.send(SYNC_ID, b"")
            self._bus.listen(_SYNC_PAUSE_S)
            self._paused_s += self._period_s

    def wait(self) -> float:
        """Return the monotonic time [s]."""
        return time.monotonic()
