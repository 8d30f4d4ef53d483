"""Jerk-limited motions of six joints, sampled once per SYNC (ruckig).

From rest to rest all joints share one time law (phase synchronisation): the motion is a straight line in joint space,
what was checked as a line is what is driven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ruckig

from gateway.errors import PlanRefused

AXES = 6
#: Speed [rad/s] or acceleration [rad/s2] that counts as none.
STILL = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class MotionLimits:
    """Limits (6,) of a motion: speed [rad/s], acceleration [rad/s2], jerk [rad/s3]."""

    speed_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray
    jerk_rad_s3: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Set points, one row per SYNC, the first one period after the start.

    Attributes
    ----------
    q_rad, qd_rad_s, qdd_rad_s2 : arrays of shape (n, 6)
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
    """Motion from rest to rest along a straight line in joint space.

    Parameters
    ----------
    start_rad, target_rad : arrays of shape (6,)
    limits : MotionLimits
    period_s : float
        SYNC period.

    Raises
    ------
    PlanRefused
        A limit or position that no motion fits (not finite, not positive).
    """
    request = ruckig.InputParameter(AXES)
    request.current_position = [float(value) for value in start_rad]
    request.target_position = [float(value) for value in target_rad]
    request.max_velocity = [float(value) for value in limits.speed_rad_s]
    request.max_acceleration = [float(value) for value in limits.acceleration_rad_s2]
    request.max_jerk = [float(value) for value in limits.jerk_rad_s3]
    request.synchronization = ruckig.Synchronization.Phase
    motion = _sample(request, period_s)
    if len(motion):
        motion.q_rad[-1] = target_rad
        motion.qd_rad_s[-1] = motion.qdd_rad_s2[-1] = 0.0
    return motion


def stop(state: tuple[np.ndarray, np.ndarray, np.ndarray], limits: MotionLimits, period_s: float) -> Motion:
    """Jerk-limited motion to rest, on the straight line the arm moves along.

    Parameters
    ----------
    state : arrays of shape (6,)
        Position, and velocity and acceleration along one line in joint space.
    limits : MotionLimits
    period_s : float

    Raises
    ------
    PlanRefused
        The state is outside what the limits allow.
    """
    q_rad, qd_rad_s, qdd_rad_s2 = state
    line = qd_rad_s if np.abs(qd_rad_s).max() > STILL else qdd_rad_s2
    largest = np.abs(line).max()
    if largest <= STILL:
        return Motion(np.empty((0, AXES)), np.empty((0, AXES)), np.empty((0, AXES)), period_s)
    line = line / largest
    moving = np.abs(line) > STILL
    request = ruckig.InputParameter(1)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.current_velocity = [float(qd_rad_s @ line / (line @ line))]
    request.current_acceleration = [float(qdd_rad_s2 @ line / (line @ line))]
    request.target_velocity = [0.0]
    request.max_acceleration = [float((limits.acceleration_rad_s2[moving] / np.abs(line[moving])).min())]
    request.max_jerk = [float((limits.jerk_rad_s3[moving] / np.abs(line[moving])).min())]
    along = _sample(request, period_s)
    return Motion(q_rad + along.q_rad * line, along.qd_rad_s * line, along.qdd_rad_s2 * line, period_s)


def _sample(request: ruckig.InputParameter, period_s: float) -> Motion:
    axes = request.degrees_of_freedom
    trajectory = ruckig.Trajectory(axes)
    try:
        result = ruckig.Ruckig(axes).calculate(request, trajectory)
    except RuntimeError as error:
        raise PlanRefused(f"no motion fits the limits: {error}") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise PlanRefused(f"no motion fits the limits ({result.name}): every limit must be positive and finite")
    count = int(np.ceil(trajectory.duration / period_s - 1e-9))
    rows = [trajectory.at_time(min(step * period_s, trajectory.duration)) for step in range(1, count + 1)]
    q, qd, qdd = (np.array([row[part] for row in rows]).reshape(-1, axes) for part in range(3))
    return Motion(q, qd, qdd, period_s)
