"""Record of what the drives answered while the arm was under power, one run for each time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from drives.cia402 import State, decode_state
from drives.values import DriveReading
from gateway.drivetest.standstill import PositionTrack
from gateway.motion.observer import Observed, Scene
from gateway.motion.opening import OpenArm


@dataclass(slots=True)
class PowerRun:
    """Answers of all drives while they were under power once, by SYNC.

    Attributes
    ----------
    began_s : float
        When power was requested (monotonic).
    sent_s : list of float
        When each SYNC was sent (monotonic).
    time_s : list of float
        The same in the time of the motion, which in lockstep is SYNC index times period.
    rows : list of tuples of DriveReading or None
    """

    began_s: float
    sent_s: list[float] = field(default_factory=list[float])
    time_s: list[float] = field(default_factory=list[float])
    rows: list[tuple[DriveReading | None, ...]] = field(default_factory=list[tuple[DriveReading | None, ...]])

    def at(self, sent_s: float) -> float:
        """Return the time of the motion at a monotonic time."""
        return float(np.interp(sent_s, self.sent_s, self.time_s))

    def track(self, axis: int) -> PositionTrack | None:
        """Return the positions of an axis (from 0); None where it has too few answers."""
        seen = [(at, row[axis]) for at, row in zip(self.time_s, self.rows, strict=True)]
        known = [(at, reading) for at, reading in seen if reading is not None]
        if len(known) < 10:
            return None
        return PositionTrack(
            np.array([at for at, _ in known]),
            np.array([reading.position_count for _, reading in known], dtype=float),
            np.array([decode_state(reading.statusword) is State.OPERATION_ENABLED for _, reading in known]),
        )


class MotionRecord:
    """Observer of the motion loop that keeps the answers of every run under power."""

    def __init__(self, opened: OpenArm) -> None:
        self.runs: list[PowerRun] = []
        self._group = opened.group

    def began(self, _scene: Scene) -> None:
        """Begin a run."""
        self.runs.append(PowerRun(time.monotonic()))

    def sampled(self, observed: Observed) -> None:
        """Keep the answers of one SYNC."""
        run, sample = self.runs[-1], observed.samples[0]
        run.sent_s.append(self._group.sync_sent_s)
        run.time_s.append(sample.time_s)
        run.rows.append(sample.readings)

    def reported(self, _event: object) -> None:
        """Ignore events."""

    def ended(self, _failure: BaseException | None) -> None:
        """The arm is no longer under power."""
