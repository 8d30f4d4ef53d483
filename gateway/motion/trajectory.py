"""Jerk-limited motions of an arm's joints, sampled once per SYNC (ruckig).

All joints share one time law along a straight line in joint space, so that the checked line is the driven path, also
while `PathClock` brakes on it. (Phase synchronisation of separate time laws leaves the line where the joints' limits
differ.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig

from gateway.errors import PlanRefused

#: Speed [rad/s] or acceleration [rad/s2] below which a joint counts as not moving.
STILL = 1e-9
#: Share of the jerk limit used if ruckig finds no profile at the full limit because of rounding.
_LESS_JERK = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class MotionLimits:
    """Limits (N,) of a motion: speed [rad/s], acceleration [rad/s2], jerk [rad/s3].

    `deceleration_rad_s2` limits slowing down; None = as the acceleration.
    """

    speed_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray
    jerk_rad_s3: np.ndarray
    deceleration_rad_s2: np.ndarray | None = None

    def at_rate(self, rate: float) -> MotionLimits:
        """Return the limits of the same motions in which time passes at a rate in (0, 1]."""
        fall = None if self.deceleration_rad_s2 is None else rate**2 * self.deceleration_rad_s2
        rise, jerk = rate**2 * self.acceleration_rad_s2, rate**3 * self.jerk_rad_s3
        return MotionLimits(rate * self.speed_rad_s, rise, jerk, fall)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Setpoints, one row per SYNC, the first one period after the start.

    Attributes
    ----------
    q_rad, qd_rad_s, qdd_rad_s2 : arrays of shape (n, N)
    period_s : float
    """

    q_rad: np.ndarray
    qd_rad_s: np.ndarray
    qdd_rad_s2: np.ndarray
    period_s: float

    def __len__(self) -> int:
        """Number of SYNCs."""
        return len(self.q_rad)

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return len(self) * self.period_s


def straight(start_rad: np.ndarray, target_rad: np.ndarray, limits: MotionLimits, period_s: float) -> Motion:
    """Return the fastest motion from rest to rest along a straight line in joint space.

    Parameters
    ----------
    start_rad, target_rad : arrays of shape (N,)
    limits : MotionLimits
    period_s : float
        SYNC period.

    Raises
    ------
    PlanRefused
        A limit is not positive and finite, or a position is not finite.
    """
    displacement = target_rad - start_rad
    length = float(np.abs(displacement).max())
    if not np.isfinite(length):
        raise PlanRefused("a motion needs finite joint angles at both ends")
    if length <= STILL:
        nothing = np.empty((0, len(displacement)))
        return Motion(nothing, nothing, nothing, period_s)
    line = displacement / length
    request = _along(line, limits)
    request.target_position = [length]
    trajectory = _calculated(request)
    count = max(1, int(np.ceil(trajectory.duration / period_s - 1e-9)))
    rows = [trajectory.at_time(min(step * period_s, trajectory.duration)) for step in range(1, count + 1)]
    moved, speed, acceleration = (np.array([row[part][0] for row in rows])[:, None] for part in range(3))
    motion = Motion(start_rad + moved * line, speed * line, acceleration * line, period_s)
    motion.q_rad[-1] = target_rad
    motion.qd_rad_s[-1] = motion.qdd_rad_s2[-1] = 0.0
    return motion


def _along(line: np.ndarray, limits: MotionLimits) -> Any:
    """Return the ruckig input for a line (N,): the limits of every joint hold for its share of it."""
    request = ruckig.InputParameter(1)
    request.current_position = [0.0]
    share = np.abs(line)
    moving = share > STILL
    rates = []
    for values in (limits.speed_rad_s, limits.acceleration_rad_s2, limits.jerk_rad_s3):
        rate = float((np.asarray(values)[moving] / share[moving]).min())
        if not (np.isfinite(rate) and rate > 0):
            raise PlanRefused("no motion fits the limits: speed, acceleration and jerk must be positive and finite")
        rates.append([rate])
    request.max_velocity, request.max_acceleration, request.max_jerk = rates
    if limits.deceleration_rad_s2 is not None:
        request.min_acceleration = [-float((limits.deceleration_rad_s2[moving] / share[moving]).min())]
    return request


def straight_duration_s(start_rad: np.ndarray, target_rad: np.ndarray, limits: MotionLimits) -> float:
    """Return the duration of the fastest motion between two different postures, not rounded to SYNCs."""
    displacement = target_rad - start_rad
    length = float(np.abs(displacement).max())
    request = _along(displacement / length, limits)
    request.target_position = [length]
    return float(_calculated(request).duration)


def _calculated(request: Any) -> Any:
    trajectory = ruckig.Trajectory(1)
    try:
        result = ruckig.Ruckig(1).calculate(request, trajectory)
    except ruckig.RuckigError:
        # rounding: ruckig finds no profile where a motion just reaches its largest acceleration
        request.max_jerk = [_LESS_JERK * jerk for jerk in request.max_jerk]
        try:
            result = ruckig.Ruckig(1).calculate(request, trajectory)
        except ruckig.RuckigError as error:
            raise PlanRefused(f"no motion fits the limits: {error}") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise PlanRefused(f"no motion fits the limits ({result.name})")
    return trajectory
