"""Time scaling along a path: position and rate of the next setpoint.

Setpoints of a trajectory are rows, one SYNC apart at full rate. The position advances by the rate at every SYNC: 1 = as
planned, 0.1 = a speed override of 10 %, decreasing to 0 = a stop along the path. With the position s and its rate r, a
joint has the speed q' r and the acceleration q'' r^2 + q' r', so the rate decreases as fast as the acceleration limits
of all joints allow. The jerk limits bound the start and the end of the decrease (path-velocity decomposition: Kant and
Zucker 1986).
"""

from __future__ import annotations

import math

import numpy as np

#: A trajectory at its limits has no reserve of acceleration for braking: after the first time [s] it is brought to
#: rest within the second time, beyond the limits if necessary.
PATIENCE_S, LONGEST_S = 1.5, 1.0
#: A slower joint does not limit the rate [rad/s].
STILL_RAD_S = 1e-9


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
