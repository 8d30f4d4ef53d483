"""Convert a recording with the constants of the cell that it is evaluated for: same drives, same axes.

Raw drive words are kept. Values that depend on a constant corrected since the recording are recomputed. A changed
constant that makes the recorded posture wrong (ratio, sign, zero, coupling) is an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drives.errors import ProfileError
from drives.scaling import Constants, motor_scale
from gateway.cell.config import ArmConfig, AxisConfig, Cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Measured
from gateway.data.recording.recorded import Recording, arm_config, parsed_profiles
from gateway.errors import InputError


@dataclass(frozen=True, slots=True)
class Correction:
    """A constant of the cell that differs from the one in the recording.

    Attributes
    ----------
    joint : counts from 1
    name : key of the cell file
    recorded, used : values
    """

    joint: int
    name: str
    recorded: float
    used: float

    @property
    def what(self) -> str:
        """Text of the correction, without the joint."""
        return f"{self.name} {self.used:g}, recorded with {self.recorded:g}"

    def __str__(self) -> str:
        return f"J{self.joint} {self.what}"


def bind(recording: Recording, cell: Cell, arm: ArmConfig) -> tuple[Recording, tuple[Correction, ...]]:
    """Return the recording of an arm, converted with the constants of a cell, and what was corrected.

    Parameters
    ----------
    recording : Recording
    cell : Cell
        Whose constants hold.
    arm : ArmConfig
        Of that cell.

    Raises
    ------
    InputError
        The recording was made with another cell, lacks the arm, or has other drives or axes; or the torque cannot be
        recomputed because the file lacks the constants read from the drives.
    """
    part = recording.arm(arm.name)
    if part is None:
        held = ", ".join(f"'{each.name}'" for each in recording.arms) or "none"
        raise InputError(
            f"{recording.path}: contains no arm '{arm.name}' but {held}; name the cell and arm that it was made with"
        )
    before = arm_config(recording.cell, arm.name, str(recording.path))
    if len(before.axis) != len(arm.axis):
        raise InputError(
            f"{recording.path}: was recorded with an arm of {len(before.axis)} axes, the cell's '{arm.name}' has"
            f" {len(arm.axis)}; name the cell that it was made with"
        )
    if recording.cell.name != cell.name:
        raise InputError(
            f"{recording.path}: was recorded with cell '{recording.cell.name}', this is cell '{cell.name}'; name the"
            " cell that it was made with, or none: the recording carries its own"
        )
    _refuse_wired_otherwise(recording, before, arm)
    corrections = tuple(_corrections(before, arm))
    if not corrections:
        return replace(recording, arms=(part,), cell=cell), ()
    changed = [f"J{each.joint}" for each in corrections if each.name == "torque_constant_nm_per_a"]
    if changed and not part.constants:
        raise InputError(
            f"{recording.path}: lacks the constants read from the drives, so the torque of"
            f" {', '.join(changed)} cannot be recomputed with another torque constant; measure again"
        )
    scale = np.ones(len(arm.axis))
    if part.constants:
        was_nm, is_nm = (
            torque_units(config, recording.profiles, part.constants, str(recording.path)) for config in (before, arm)
        )
        scale = is_nm / was_nm
    old, new = AxisConversion.from_arm(before), AxisConversion.from_arm(arm)
    visits = tuple(_converted(visit, scale, old, new) for visit in part.visits)
    periods = tuple(_converted(period, scale, old, new) for period in part.periods)
    bound = replace(part, visits=visits, periods=periods)
    return replace(recording, arms=(bound,), cell=cell), corrections


def _refuse_wired_otherwise(recording: Recording, before: ArmConfig, after: ArmConfig) -> None:
    for joint, (old, new) in enumerate(zip(before.axis, after.axis, strict=True), start=1):
        for name, was, now in (
            ("node_id", old.node_id, new.node_id),
            ("profile", old.profile, new.profile),
            ("position_sign", old.position_sign, new.position_sign),
            ("a gear_ratio of sign", np.sign(old.gear_ratio.value), np.sign(new.gear_ratio.value)),
        ):
            if was != now:
                raise InputError(
                    f"{recording.path}: J{joint} was recorded with {name} {was}, the cell says {now}; name the cell"
                    " that it was made with, or measure again"
                )
    if not np.array_equal(AxisConversion.from_arm(before).coupling, AxisConversion.from_arm(after).coupling):
        raise InputError(
            f"{recording.path}: was recorded with another coupling of the axes: its postures differ from those of"
            " this cell; name the cell that it was made with, or measure again"
        )


def _corrections(before: ArmConfig, after: ArmConfig) -> Iterator[Correction]:
    for joint, (old, new) in enumerate(zip(before.axis, after.axis, strict=True), start=1):
        used = _constants(new)
        for name, was in _constants(old).items():
            if was != used[name]:
                yield Correction(joint, name, was, used[name])


def _constants(axis: AxisConfig) -> dict[str, float]:
    """Return the constants that may be corrected, by key of the cell file."""
    return {
        "torque_constant_nm_per_a": axis.torque_constant_nm_per_a.value,
        "gear_ratio": axis.gear_ratio.value,
        "gear_efficiency": axis.gear_efficiency.value,
        "torque_sign": float(axis.torque_sign),
        "zero_offset_rad": axis.zero_offset_rad,
    }


def torque_units(
    config: ArmConfig, profiles: Mapping[str, Any], constants: Sequence[Constants], where: str
) -> np.ndarray:
    """Return the motor torque (N,) [Nm] per bit of each torque word.

    Parameters
    ----------
    config : ArmConfig
    profiles : mapping of str to str
        Texts by name.
    constants : sequence of Constants, one per axis
        Read from the drives.
    where : str
        File, for messages.

    Raises
    ------
    InputError
        A profile is missing or cannot be used.
    """
    parsed = parsed_profiles(config, profiles, where)
    try:
        return np.array(
            [
                motor_scale(profile, read_from_drive, axis.torque_constant_nm_per_a.value).torque_nm
                for axis, profile, read_from_drive in zip(config.axis, parsed, constants, strict=True)
            ]
        )
    except ProfileError as error:
        raise InputError(f"{where}: {error}") from error


def _converted(visit: Measured, scale: np.ndarray, old: AxisConversion, new: AxisConversion) -> Measured:
    motor_nm = visit.motor_torque_nm * scale
    return replace(
        visit,
        motor_torque_nm=motor_nm,
        joint_torque_nm=new.joint_torque(motor_nm),
        q_rad=new.joint_position(old.motor_position(visit.q_rad)),
        target_rad=new.joint_position(old.motor_position(visit.target_rad)),
    )


def refuse_other_drives(recordings: Sequence[Recording], arm: str) -> None:
    """Raise an error if recordings of one arm have different drive serial numbers; missing serial numbers are
    ignored.

    Raises
    ------
    InputError
    """
    first: dict[int, tuple[int, Recording]] = {}
    for recording in recordings:
        part = recording.arm(arm)
        for joint, identity in enumerate(() if part is None else part.identities, start=1):
            serial = identity.get("serial_number") if isinstance(identity, Mapping) else None
            if not isinstance(serial, int) or not serial:
                continue
            known, other = first.setdefault(joint, (serial, recording))
            if known != serial:
                raise InputError(
                    f"{recording.path}: J{joint} has the drive with serial number {serial}, in {other.path.name} it was"
                    f" {known}; its constants may differ: analyse what was measured with one set of drives"
                )
