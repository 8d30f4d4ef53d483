"""Sources of setpoints for the motion loop, and the time scaling along them (`PathClock`).

Setpoints of a trajectory are rows, one SYNC apart at full rate. The position advances by the rate at every SYNC: 1 = as
planned, 0.1 = a speed override of 10 %, decreasing to 0 = a stop along the path. With the position s and its rate r, a
joint has the speed q' r and the acceleration q'' r^2 + q' r', so the rate decreases as fast as the acceleration limits
of all joints allow. The jerk limits bound the start and the end of the decrease (path-velocity decomposition: Kant and
Zucker 1986).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from gateway.data.visit import ArmSample
from gateway.motion.trajectory import Motion

#: One array of shape (N,) per arm.
PerArm = tuple[np.ndarray, ...]
#: A trajectory at its limits has no reserve of acceleration for braking: after the first time [s] it is brought to
#: rest within the second time, beyond the limits if necessary.
PATIENCE_S, LONGEST_S = 1.5, 1.0
#: A slower joint does not limit the rate [rad/s].
STILL_RAD_S = 1e-9


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


class PathClock:
    """Position of the next setpoint along a trajectory.

    Parameters
    ----------
    count : int
        Number of samples of the trajectory; sample 0 is due one SYNC after the start, which is sample -1.
    period_s : float
        SYNC period.
    acceleration_rad_s2, jerk_rad_s3 : arrays of shape (n,)
        Limits of all joints of all arms.
    most : float
        Rate without a stop request, in (0, 1].

    Attributes
    ----------
    at : float
        Sample index of the next setpoint, -1 to count - 1.
    rate : float
        Samples per SYNC.
    """

    def __init__(
        self, count: int, period_s: float, acceleration_rad_s2: np.ndarray, jerk_rad_s3: np.ndarray, most: float = 1.0
    ) -> None:
        self.at = -1.0
        self.rate = most
        self._last = count - 1
        self._period_s = period_s
        self._acceleration, self._jerk = acceleration_rad_s2, jerk_rad_s3
        self._fall = self._stopping_s = 0.0
        self.stopping = False

    @property
    def arrived(self) -> bool:
        """Return True if the last sample was reached."""
        return self.at >= self._last

    @property
    def done(self) -> bool:
        """Return True if the end of the trajectory is reached, or the stop has come to rest."""
        return self.arrived or (self.stopping and self.rate == 0.0)

    def stop(self) -> None:
        """Begin to decelerate to rest."""
        self.stopping = True

    def advance(self, speed_rad_s: np.ndarray, acceleration_rad_s2: np.ndarray) -> float:
        """Return the sample index of the next setpoint.

        Parameters
        ----------
        speed_rad_s, acceleration_rad_s2 : arrays of shape (n,)
            Speed and acceleration of the trajectory at full rate, at the present position.
        """
        if self.stopping:
            self._slow_down(speed_rad_s, acceleration_rad_s2)
        self.at = min(self.at + self.rate, float(self._last))
        return self.at

    def _slow_down(self, speed_rad_s: np.ndarray, acceleration_rad_s2: np.ndarray) -> None:
        speed = np.abs(speed_rad_s)
        moving = speed > STILL_RAD_S
        if not moving.any():
            self.rate = self._fall = 0.0
            return
        speed, along = speed[moving], (acceleration_rad_s2 * np.sign(speed_rad_s))[moving] * self.rate**2
        steepest = float(((self._acceleration[moving] + along) / speed).min())
        self._stopping_s += self._period_s
        steepest = max(steepest, 0.0 if self._stopping_s < PATIENCE_S else 1.0 / LONGEST_S)
        onset = float((self._jerk[moving] / speed).min())
        self._fall = min(self._fall + onset * self._period_s, steepest, math.sqrt(2.0 * onset * self.rate))
        self.rate -= self._fall * self._period_s
        if self.rate <= onset * self._period_s**2:
            self.rate = self._fall = 0.0
