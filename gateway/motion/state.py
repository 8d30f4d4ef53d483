"""State of an arm in the master: phase, time of the change, and the cause after a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum


class Phase(Enum):
    """Phase of an arm; `IN_BRAKES` and `STOPPED` only where every drive was read as disabled."""

    IN_BRAKES = "in its brakes"
    HOLDING = "under power, holding"
    MOVING = "moving"
    SETTLING = "settling"
    SAMPLING = "being sampled"
    STOPPING = "being stopped"
    STOPPED = "stopped, in its brakes"
    UNKNOWN = "in an unknown state"

    def __str__(self) -> str:
        return self.value


#: Phases in which the master has not enabled any axis.
SAFE = frozenset({Phase.IN_BRAKES, Phase.STOPPED})


@dataclass(frozen=True, slots=True)
class CellState:
    """State of an arm at one time.

    Attributes
    ----------
    arm : str
    phase : Phase
    since : datetime
        UTC.
    sync_index : int
        Last SYNC before the change; 0 = none yet.
    reason : str
        After a stop: the event, the axis and the action to take.
    """

    arm: str
    phase: Phase
    since: datetime
    sync_index: int = 0
    reason: str = ""

    def __str__(self) -> str:
        when = f"since {self.since:%Y-%m-%d %H:%M:%S} UTC" + (f", SYNC {self.sync_index}" if self.sync_index else "")
        return f"arm '{self.arm}' is {self.phase} {when}" + (f": {self.reason}" if self.reason else "")


class StateTracker:
    """State of one arm; every change is reported.

    Parameters
    ----------
    arm : str
    report : callable
        Called with every new state.
    """

    def __init__(self, arm: str, report: Callable[[CellState], None]) -> None:
        self.state = CellState(arm, Phase.IN_BRAKES, datetime.now(UTC))
        self._report = report

    def enter(self, phase: Phase, sync_index: int = 0, reason: str = "") -> None:
        """Enter a phase; no effect if the arm is already in it."""
        if phase is not self.state.phase:
            self.state = CellState(self.state.arm, phase, datetime.now(UTC), sync_index, reason)
            self._report(self.state)
