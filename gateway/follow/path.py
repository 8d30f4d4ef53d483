"""The path to follow, from a file: joint waypoints or a timed joint path.

TOML, straight from waypoint to waypoint with rest at each:

    name = "swing"                      # optional
    waypoints_rad = [[q1, .., q6], ..]  # at least two
    speed_share = 1.0                   # optional, of the cell's speed, acceleration and jerk limits
    dwell_s = 0.4                       # optional, rest at each waypoint
    repeat = 1                          # optional

CSV with the columns q1_rad .. q6_rad alone: the same waypoints. With time_s as well: a timed path, a spline
of fifth order through the points that starts and ends at rest. It has to keep the limits between the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.interpolate import make_interp_spline

from drives.validation import Strict, Unfit, read_strict
from gateway.cell.config import ArmConfig
from gateway.data.csv_text import read_path_columns
from gateway.errors import ConfigError, InputError, PlanRefused
from gateway.motion.joint_path import angles
from gateway.motion.trajectory import Motion, MotionLimits, straight
from gateway.motion.workspace import Workspace

COLUMNS = tuple(f"q{axis}_rad" for axis in range(1, 7))
SAME_RAD = 1e-9
LEAST_TIMED = 4
#: Largest file and longest path that are accepted.
MOST_BYTES = 4_000_000
LONGEST_S = 600.0
MOST_WAYPOINTS = 1000
#: Smallest time between two rows of a timed path [s].
LEAST_STEP_S = 1e-4
#: Largest joint angle [rad].
FARTHEST_RAD = 1e4
#: Tolerance of limits for rounding, relative.
ROUNDING = 1e-6

Six = tuple[float, float, float, float, float, float]
Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]


class _Waypoints(Strict):
    name: str | None = None
    waypoints_rad: tuple[Six, ...] = Field(
        min_length=2, max_length=MOST_WAYPOINTS, description="waypoints of the arm, six joint angles each"
    )
    speed_share: Share = 1.0
    dwell_s: float = Field(default=0.4, ge=0, le=10)
    repeat: int = Field(default=1, ge=1, le=100)


@dataclass(frozen=True, slots=True, eq=False)
class FollowPath:
    """Path as setpoints.

    Attributes
    ----------
    name : str
    start_rad : array of shape (6,)
    motions : tuple of Motion
        Each begins at the end of the previous one, and ends at rest.
    dwell_s : float
        Rest after each motion.
    period_s : float
        SYNC period.
    limits : MotionLimits or None
        Limits of straight motions; None = the file contains the times.
    """

    name: str
    start_rad: np.ndarray
    motions: tuple[Motion, ...]
    dwell_s: float
    period_s: float
    limits: MotionLimits | None = None

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return sum(motion.duration_s + self.dwell_s for motion in self.motions)

    @property
    def end_rad(self) -> np.ndarray:
        """Last setpoint (6,)."""
        return self.motions[-1].q_rad[-1]


def refuse_other_axes(arm: ArmConfig, command: str) -> None:
    """Raise ConfigError for an arm whose number of axes a command that follows a path does not support."""
    if len(arm.axis) != len(COLUMNS):
        raise ConfigError(f"arm '{arm.name}' has {len(arm.axis)} axes; {command} supports {len(COLUMNS)} axes only")


def read_path(file: Path, workspace: Workspace, period_s: float) -> FollowPath:
    """Read a path and convert it to setpoints; only its rates are checked.

    Raises
    ------
    InputError
        The file cannot be read or is not a path; file and line are named.
    PlanRefused
        A timed path that exceeds a limit of speed, acceleration or jerk.
    """
    try:
        if file.stat().st_size > MOST_BYTES:
            raise InputError(f"{file}: is too large for a path file")
        text = "" if file.suffix.lower() == ".csv" else file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
    if file.suffix.lower() == ".csv":
        times, points = _read_csv(file)
        _refuse_far(points, str(file))
        if times is not None:
            return _timed(file.stem, times, points, workspace, period_s)
        if len(points) > MOST_WAYPOINTS:
            raise InputError(f"{file}: holds {len(points)} waypoints, the limit is {MOST_WAYPOINTS}")
        waypoints = _Waypoints(waypoints_rad=tuple(tuple(row) for row in points.tolist()))
    else:
        try:
            waypoints = read_strict(text, _Waypoints)
        except Unfit as error:
            raise InputError.of(error.messages(str(file))) from error
        _refuse_far(np.array(waypoints.waypoints_rad), str(file))
    return _waypoints(waypoints.name or file.stem, waypoints, workspace, period_s, str(file))


def _refuse_far(points: np.ndarray, where: str) -> None:
    if np.abs(points).max() > FARTHEST_RAD:
        raise InputError(f"{where}: an angle beyond {FARTHEST_RAD:g} rad; a path has joint angles in rad")


def _read_csv(file: Path) -> tuple[np.ndarray | None, np.ndarray]:
    columns = read_path_columns(file, COLUMNS, ("time_s",))
    points = np.column_stack([columns.values[name] for name in COLUMNS])
    if len(points) < 2:
        raise InputError(f"{file}: at least two rows are needed")
    times = columns.values.get("time_s")
    if times is None:
        return None, points
    steps_s = np.diff(times)
    if len(times) < LEAST_TIMED or times[0] != 0 or not (steps_s >= LEAST_STEP_S).all() or times[-1] > LONGEST_S:
        raise InputError(
            f"{file}: time_s must start at 0 and increase, by {1e3 * LEAST_STEP_S:g} ms at least and to {LONGEST_S:g} s"
            f" at most, over {LEAST_TIMED} rows at least"
        )
    return times, points


def _waypoints(name: str, read: _Waypoints, workspace: Workspace, period_s: float, where: str) -> FollowPath:
    points = np.array(read.waypoints_rad)
    share = read.speed_share
    limits = MotionLimits(
        share * workspace.speed_rad_s, share * workspace.acceleration_rad_s2, share * workspace.jerk_rad_s3
    )
    pairs = _distinct(points)
    back = _distinct(np.vstack([points[-1:], points[:1]])) if read.repeat > 1 else []
    if not pairs:
        raise InputError(f"{where}: all waypoints are the same posture")
    rests_s = read.dwell_s * (read.repeat * len(pairs) + (read.repeat - 1) * len(back))
    least_s = read.repeat * _least_s(pairs, limits, period_s) + (read.repeat - 1) * _least_s(back, limits, period_s)
    if not rests_s + least_s <= LONGEST_S:
        raise InputError(f"{where}: the path takes {rests_s + least_s:.3g} s at least, the limit is {LONGEST_S:g} s")
    once, again = ([straight(start, end, limits, period_s) for start, end in each] for each in (pairs, back))
    motions = (*once, *(again + once) * (read.repeat - 1))
    path = FollowPath(name, points[0], motions, read.dwell_s, period_s, limits)
    if path.duration_s > LONGEST_S:
        raise InputError(f"{where}: the path takes {path.duration_s:.0f} s, the limit is {LONGEST_S:g} s")
    return path


def _distinct(points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the waypoints (n, 6) [rad] without successive duplicates."""
    pairs = zip(points[:-1], points[1:], strict=True)
    return [(start, end) for start, end in pairs if np.abs(end - start).max() > SAME_RAD]


def _least_s(pairs: Sequence[tuple[np.ndarray, np.ndarray]], limits: MotionLimits, period_s: float) -> float:
    """Return a lower bound of the time of motions from rest to rest, before any is sampled.

    For a distance d: d / v, 2 sqrt(d / a), (32 d / j)^(1/3), each with the other two limits left out.
    """
    total_s = 0.0
    for start, end in pairs:
        distance = np.abs(end - start)
        by_speed = (distance / limits.speed_rad_s).max()
        by_acceleration = 2 * np.sqrt((distance / limits.acceleration_rad_s2).max())
        by_jerk = np.cbrt(32 * (distance / limits.jerk_rad_s3).max())
        total_s += max(by_speed, by_acceleration, by_jerk, period_s)
    return float(total_s)


def _timed(name: str, times: np.ndarray, points: np.ndarray, workspace: Workspace, period_s: float) -> FollowPath:
    still = [(1, np.zeros(6)), (2, np.zeros(6))]
    spline = make_interp_spline(times, points, k=5, bc_type=(still, still))
    count = max(1, int(np.ceil(times[-1] / period_s - 1e-9)))
    at = np.minimum(np.arange(1, count + 1) * period_s, times[-1])
    rates = [np.asarray(spline(at, derivative)) for derivative in range(4)]
    for values, limit, what in (
        (rates[1], workspace.speed_rad_s, "rad/s"),
        (rates[2], workspace.acceleration_rad_s2, "rad/s2"),
        (rates[3], workspace.jerk_rad_s3, "rad/s3"),
    ):
        over = np.abs(values) > limit * (1 + ROUNDING)
        if over.any():
            row, joint = np.argwhere(over)[0]
            raise PlanRefused(
                f"path '{name}': joint {joint + 1} reaches {abs(values[row, joint]):.3g} {what} at {at[row]:.2f} s, "
                f"its limit is {limit[joint]:g}; stretch the path in time, or give its points closer together"
            )
    motion = Motion(rates[0], rates[1], rates[2], period_s)
    motion.q_rad[-1], motion.qd_rad_s[-1], motion.qdd_rad_s2[-1] = points[-1], 0.0, 0.0
    return FollowPath(name, points[0], (motion,), 0.0, period_s)


def check_path(path: FollowPath, workspace: Workspace) -> None:
    """Refuse a path that leaves the workspace.

    Raises
    ------
    PlanRefused
        A joint limit, a keep-out box or the holding torque is violated; the first position is named.
    """
    begun_s, before = 0.0, path.start_rad
    for motion in path.motions:
        refusal = workspace.refused_on(np.vstack([before, motion.q_rad]))
        if refusal is not None:
            raise PlanRefused(
                f"path '{path.name}' at {begun_s + refusal.row * path.period_s:.2f} s, {angles(refusal.q_rad)}: "
                f"{refusal.reason}"
            )
        begun_s, before = begun_s + motion.duration_s + path.dwell_s, motion.q_rad[-1]
