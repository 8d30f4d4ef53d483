"""Limits that are written to the drives of an arm (motor side), computed from joint limits, gears and coupling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig
from gateway.cell.conversion import AxisConversion
from gateway.preflight.coasting import quick_stop_ramp
from gateway.preflight.rules import Readings, counts_per_revolution

#: Margin beyond a joint limit [rad, joint] within which the drive accepts a target that was rounded to counts.
ROUNDING_RAD: Final = 1e-4

Range = tuple[float, float]


def motor_ranges_rad(arm: ArmConfig) -> tuple[Range | None, ...]:
    """Return the motor angles [rad] at the limits of each joint; None for an axis whose motor also turns other joints.

    Parameters
    ----------
    arm : ArmConfig
    """
    axes = AxisConversion.from_arm(arm)
    limits = np.array([axis.position_limit_rad for axis in arm.axis]).T + ROUNDING_RAD * np.array([[-1.0], [1.0]])
    ends = np.sort(axes.motor_position(limits), axis=0)
    coupled = np.count_nonzero(axes.coupling, axis=1) > 1
    return tuple(None if mixed else (float(low), float(high)) for mixed, low, high in zip(coupled, *ends, strict=True))


def motor_torques_nm(axes: AxisConversion, joint_nm: np.ndarray | None) -> tuple[float | None, ...]:
    """Return the motor torque [Nm] of each drive for joint torques (N,) [Nm] of either sign; None = not known.

    Parameters
    ----------
    axes : AxisConversion
    joint_nm : array of shape (N,) or None
        Largest torque of each joint, gear losses included.
    """
    if joint_nm is None:
        return (None,) * len(axes.ratio)
    return tuple((np.abs(np.linalg.inv(axes.coupling)).T @ joint_nm / np.abs(axes.ratio)).tolist())


def quick_stop_rad_s2(
    arm: ArmConfig, profiles: Sequence[DriveProfile], readings: Sequence[Readings]
) -> np.ndarray | None:
    """Return the joint decelerations (N,) [rad/s2] of the drives' quick stop ramps; None if one is not known.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
    readings : sequence of Readings, one per axis
        Objects of each drive.
    """
    motor: list[float] = []
    for profile, objects in zip(profiles, readings, strict=True):
        raw, velocity = quick_stop_ramp(objects)[1], profile.velocity
        unit_rad_s2 = None if velocity is None else velocity.ramp_rad_s2(counts_per_revolution(profile, objects))
        if not raw or unit_rad_s2 is None:
            return None
        motor.append(raw * unit_rad_s2)
    return AxisConversion.from_arm(arm).joint_bound(np.array(motor))
