"""Source of every constant between raw values and joint torque, for result and report."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

from drives.profile import Constant, DriveProfile, Rated, Signal, current_factor
from drives.scaling import Constants
from gateway.cell.config import ArmConfig, AxisConfig

Entry = dict[str, Any]


def provenance(
    arm: ArmConfig,
    profiles: Sequence[DriveProfile],
    constants: Sequence[Constants] = (),
    currents: Container[int] = (),
) -> dict[str, dict[str, Entry]]:
    """Constants of every axis with value, unit and source.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
        In the order of the axes.
    constants : sequence of Constants, one per axis
        What was read from the drives; empty if no drive was asked.
    currents : container of int
        Joints whose torque is computed from the motor current of a table.

    Returns
    -------
    dict
        "J1" to "JN" -> name -> {"value", "unit", "source"}.
    """
    read = list(constants) or [None] * len(arm.axis)
    return {
        f"J{joint}": _axis(*axis, joint in currents)
        for joint, axis in enumerate(zip(arm.axis, profiles, read, strict=True), start=1)
    }


def _axis(axis: AxisConfig, profile: DriveProfile, read: Constants | None, of_current: bool) -> dict[str, Entry]:
    entries = {
        "gear_ratio": _entry(axis.gear_ratio.value, "-", axis.gear_ratio.source),
        "gear_efficiency": _entry(axis.gear_efficiency.value, "-", axis.gear_efficiency.source),
    }
    constant = axis.torque_constant_nm_per_a
    used = of_current or profile.needs_torque_constant
    source = constant.source if used else f"{constant.source}; not used, the drive reports torque"
    entries["torque_constant"] = _entry(constant.value, "Nm/A", source)
    signs = f"{axis.position_sign:+d} / {axis.torque_sign:+d}"
    entries["position_sign / torque_sign"] = _entry(signs, "-", "cell file")
    entries["zero_offset"] = _entry(axis.zero_offset_rad, "rad", "cell file")
    entries["torque_object"] = _entry(_object(profile.torque), "", f"profile {profile.name}: {profile.torque.source}")
    if profile.torque.rated is not None:
        unit = "A" if profile.torque.is_current else "Nm"
        entries["rated_value"] = _rated(profile.torque.rated, unit, read)
    if profile.torque.internal_unit_a is not None:
        entries["ampere_per_unit"] = _constant(profile.torque.internal_unit_a, "A")
    if profile.torque.is_current:
        factor = f"profile {profile.name}: drive {profile.torque.current_reference}, constant per "
        entries["current_factor"] = _entry(
            current_factor(profile.torque), "-", f"{factor}{profile.torque.torque_constant_per}"
        )
    counts = profile.position.counts_per_revolution
    if isinstance(counts, Constant):
        entries["counts_per_revolution"] = _constant(counts, "1/rev")
    else:
        where = f"read from drive, 0x{counts.object.index:04X}:{counts.object.subindex:02X}"
        entries["counts_per_revolution"] = _entry(read and read.counts_per_revolution, "1/rev", where)
    return entries


def _entry(value: Any, unit: str, source: str) -> Entry:
    return {"value": value, "unit": unit, "source": source}


def _constant(constant: Constant, unit: str) -> Entry:
    return _entry(constant.value, unit, constant.source)


def _rated(rated: Rated, unit: str, read: Constants | None) -> Entry:
    if rated.object is None:
        return _entry(rated.value, unit, rated.source)
    where = f"read from drive, 0x{rated.object.index:04X}:{rated.object.subindex:02X}, {rated.unit:g} {unit} per bit"
    return _entry(read and read.torque_rated, unit, f"{where}; {rated.source}")


def _object(signal: Signal) -> str:
    return f"0x{signal.object.index:04X}:{signal.object.subindex:02X}, {signal.kind.replace('_', ' ')}"
