"""Compare joint position and drive ranges with the limits of the cell: pure rules."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from drives.objects import OBJECTS
from drives.profile import Constant
from drives.profile_file import find_profile
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.errors import PlanRefused
from gateway.preflight.rules import Axis, Readings, counts_per_revolution, value_of
from gateway.result.result import Finding

#: Following error windows beyond this multiple of the cell's limit are too wide to protect.
WIDE: Final = 4.0
_I32_MAX: Final = 0x7FFFFFFF
_NARROW: Final = "narrow position_limit_rad to that, or lower the resolution of positions in the drive (0x608F)"
#: Ranges of the drive, and what to do where they are narrower than the joint limits.
_RANGES: Final = {
    "position_limit": "the drive stops before the cell's limit: narrow position_limit_rad",
    "position_range": "the position wraps around at the end of this range: widen it, or narrow position_limit_rad",
}
#: Command that moves a joint into its range; CELL is replaced by the file name where it is known.
MOVE_HOME: Final = "servo-gateway move CELL --to home"


def judge_place(axis: Axis, arm: ArmConfig, readings: Readings) -> list[Finding]:
    """Check the joint position, which is checked again before each motion.

    Parameters
    ----------
    axis : Axis
    arm : ArmConfig
        For the conversion from motor to joint; coupled joints need all motors and are checked during the run.
    readings : mapping
        (index, subindex) -> value.
    """
    turn, position = counts_per_revolution(axis.profile, readings), value_of(readings, "position")
    if turn is None or position is None or arm.coupling is not None:
        return []
    low, high = axis.config.position_limit_rad
    q_rad = _joint_rad(arm, axis.joint, position / turn)
    inside = low <= q_rad <= high
    what = f"is at {q_rad:.3f} rad, limits {low:g} to {high:g} rad"
    remedy = f"bring the joint inside its limits ({MOVE_HOME}), or correct zero_offset_rad and position_sign"
    advice = "" if inside else remedy
    return [axis.item("ok" if inside else "fail", OBJECTS["position"].address, what, advice)]


def judge_ranges(axis: Axis, arm: ArmConfig, readings: Readings) -> Iterator[Finding]:
    """Check software limits, position range and following error window; parameters as `judge_place`."""
    turn = counts_per_revolution(axis.profile, readings)
    if turn is None:
        return
    yield from _following(axis, readings, turn)
    beyond = beyond_counts(arm, axis.joint, turn)
    if beyond is not None:
        yield axis.item("fail", OBJECTS["target_position"].address, beyond, _NARROW)
    low, high = axis.config.position_limit_rad
    for name, advice in _RANGES.items() if arm.coupling is None else ():
        drive, address = drive_range_rad(axis, arm, readings, name), OBJECTS[f"{name}_min"].address
        if drive is not None:
            what = f"drive {drive[0]:.3f} to {drive[1]:.3f} rad, cell {low:g} to {high:g} rad"
            covers = drive[0] <= low and drive[1] >= high
            yield axis.item("ok" if covers else "fail", address, what, "" if covers else advice)
        elif name == "position_limit":
            what = "no software limits in the drive; the gateway applies those of the cell file"
            yield axis.item("info", address, what)


def drive_range_rad(
    axis: Axis, arm: ArmConfig, readings: Readings, name: str = "position_limit"
) -> tuple[float, float] | None:
    """Return a joint range of the drive [rad]; None if it has none or the joint is coupled."""
    turn = counts_per_revolution(axis.profile, readings)
    first, second = (value_of(readings, f"{name}_{end}") for end in ("min", "max"))
    if turn is None or arm.coupling is not None or first is None or second is None or first == second:
        return None
    ends = [_joint_rad(arm, axis.joint, end / turn) for end in (first, second)]
    return min(ends), max(ends)


def beyond_counts(arm: ArmConfig, joint: int, turn: float) -> str | None:
    """Return why positions within the joint limits do not fit into 32 bits; None if they fit.

    Parameters
    ----------
    arm : ArmConfig
    joint : int
        From 1; for a coupled arm the number of the motor.
    turn : float
        Position counts of one motor revolution.
    """
    axes = AxisConversion.from_arm(arm)
    low, high = np.array([axis.position_limit_rad for axis in arm.axis]).T
    middle = axes.motor_position(0.5 * (low + high))
    half = np.abs(axes.ratio) * (np.abs(axes.coupling) @ (0.5 * (high - low)))
    ends = (middle + np.outer((-1.0, 1.0), half))[:, joint - 1] * turn / (2 * math.pi)
    most = max(ends, key=abs)
    if abs(most) <= _I32_MAX:
        return None
    beyond = f"{most:.0f} counts, a position has 32 bits: -{_I32_MAX} to {_I32_MAX} counts"
    if arm.coupling is not None:
        return f"the limits of the coupled joints let this motor go to {beyond}"
    at_rad, *fitting = (_joint_rad(arm, joint, counts / turn) for counts in (most, -_I32_MAX, _I32_MAX))
    return f"J{joint} at {at_rad:.3f} rad is at {beyond}, {min(fitting):.3f} to {max(fitting):.3f} rad"


def refuse_beyond_counts(loaded: LoadedCell, arm: ArmConfig) -> None:
    """Check that positions within the joint limits fit into 32 bits, if the profile gives the resolution.

    Raises
    ------
    PlanRefused
    ProfileError
        A profile cannot be read.
    """
    for joint, axis in enumerate(arm.axis, start=1):
        counts = find_profile(axis.profile, loaded.folder).position.counts_per_revolution
        said = beyond_counts(arm, joint, counts.value) if isinstance(counts, Constant) else None
        if said is not None:
            raise PlanRefused(f"arm '{arm.name}', J{joint} node {axis.node_id}: {said}; {_NARROW}")


def _following(axis: Axis, readings: Readings, turn: float) -> Iterator[Finding]:
    window = value_of(readings, "following_error_window")
    if window is None:
        return
    config, address = axis.config, OBJECTS["following_error_window"].address
    error_rad = 2.0 * math.pi * window / turn / abs(config.gear_ratio.value)
    limit = f"following_error_limit_rad of the cell is {config.following_error_limit_rad:g}"
    if window == 0:
        what = "0: the drive does not monitor its following error, or faults at once"
        yield axis.item("warn", address, what, f"set the window in the drive; {limit}")
    elif error_rad > WIDE * config.following_error_limit_rad:
        what = f"{error_rad:.3g} rad at the joint: too wide for the drive to detect a collision without the master"
        yield axis.item("warn", address, what, f"narrow the window in the drive; {limit}")
    else:
        yield axis.item("ok", address, f"{error_rad:.3g} rad at the joint; {limit}")


def _joint_rad(arm: ArmConfig, joint: int, revolutions: float) -> float:
    motor = np.zeros(len(arm.axis))
    motor[joint - 1] = 2 * math.pi * revolutions
    return float(AxisConversion.from_arm(arm).joint_position(motor)[joint - 1])
