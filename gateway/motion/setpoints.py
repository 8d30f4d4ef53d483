"""Sources of setpoints for the motion loop: setpoints of all arms as a function of the position along a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from gateway.data.sample import ArmSample
from gateway.motion.trajectory import Motion

#: One array of shape (N,) per arm.
PerArm = tuple[np.ndarray, ...]


class SetpointSource(Protocol):
    """Setpoints of all arms along a trajectory of `count` samples, one sample per SYNC at full rate."""

    @property
    def count(self) -> int:
        """Number of samples."""
        ...

    def rates(self, at: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the speeds [rad/s] and accelerations [rad/s2] of all joints of all arms at full rate."""
        ...

    def targets(self, at: float, rate: float) -> PerArm:
        """Return the setpoints at a position between -1 (the start) and count - 1; called once per SYNC."""
        ...

    def ahead(self, at: float, rate: float) -> PerArm | None:
        """Return the setpoints of the next SYNC; None where they are not known yet."""
        ...

    def offsets(self) -> PerArm | None:
        """Return joint torques [Nm] for the setpoints that `targets` returned last; None = no offsets."""
        ...

    def modelled(self, at: float) -> PerArm | None:
        """Return the modelled torque [Nm] without contact; None = gravity of the unloaded arm."""
        ...

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """Accept the measurement at the SYNC of these setpoints."""
        ...


class MotionSetpoints:
    """Prepared motions of all arms, interpolated between their samples.

    Parameters
    ----------
    start_rad : arrays of shape (N,)
        Last setpoints of the arms.
    motions : sequence of Motion
        One per arm, all of the same length, each beginning at rest at its start and ending at rest.
    """

    def __init__(self, start_rad: Sequence[np.ndarray], motions: Sequence[Motion]) -> None:
        self.count = len(motions[0])
        if any(len(motion) != self.count for motion in motions):
            raise ValueError("arms that move together need motions of equal length")
        self._period_s = motions[0].period_s
        still = np.zeros((1, sum(motion.q_rad.shape[1] for motion in motions)))
        self._q = np.vstack([np.concatenate(list(start_rad)), np.hstack([motion.q_rad for motion in motions])])
        self._qd = np.vstack([still, np.hstack([motion.qd_rad_s for motion in motions])])
        self._qdd = np.vstack([still, np.hstack([motion.qdd_rad_s2 for motion in motions])])
        self._ends = np.cumsum([motion.q_rad.shape[1] for motion in motions])[:-1]

    def rates(self, at: float) -> tuple[np.ndarray, np.ndarray]:
        """Return speeds and accelerations; see `SetpointSource.rates`."""
        row, share = self._place(at)
        after = min(row + 1, self.count)
        return (
            self._qd[row] + share * (self._qd[after] - self._qd[row]),
            self._qdd[row] + share * (self._qdd[after] - self._qdd[row]),
        )

    def targets(self, at: float, rate: float) -> PerArm:
        """Return the setpoints; see `SetpointSource.targets`."""
        row, share = self._place(at)
        if share == 0.0:
            return tuple(np.split(self._q[row], self._ends))
        # cubic Hermite between two rows: position and speed go on smoothly whatever the rate
        step = self._q[row + 1] - self._q[row]
        begin, end = self._period_s * self._qd[row], self._period_s * self._qd[row + 1]
        bend = (1.0 - share) * ((1.0 - share) * (begin - step) - share * (end - step))
        return tuple(np.split(self._q[row] + share * (step + bend), self._ends))

    def ahead(self, at: float, rate: float) -> PerArm | None:
        """Return the setpoints of the next SYNC."""
        return self.targets(min(at + rate, self.count - 1.0), rate)

    def offsets(self) -> PerArm | None:
        """Return None: prepared motions have no torque offsets."""
        return None

    def modelled(self, at: float) -> PerArm | None:
        """Return None: the monitor itself models gravity."""
        return None

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """Ignore the measurement."""

    def _place(self, at: float) -> tuple[int, float]:
        """Return the sample index before a position and the fraction beyond it; index 0 is the start."""
        place = min(max(at + 1.0, 0.0), float(self.count))
        row = min(int(place), self.count)
        return row, place - row
