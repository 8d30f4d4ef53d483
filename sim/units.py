"""Scaling of a simulated drive's objects: factors from SI on the motor side to raw values.

Written from the drive's point of view: the drive owns a rated torque and a rated current and scales what it measures
by them. The master must find the same numbers back through its profile; no formula is shared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim.cellfile import AxisSpec, CellFileError
from sim.makes import MAKES, RESOLUTION, DriveUnits, Word
from sim.objects import Address

Table = Mapping[str, Any]

#: Peak over rated torque of the simulated motors.
OVERLOAD = 3.0
#: Power-on value of 0x6072 and 0x6073: a quarter above the peak that the cell allows.
MAX_TORQUE_PER_MILLE = 3750


def drive_units(axis: AxisSpec) -> DriveUnits:
    """Return the scaling of the drive of one axis.

    Raises
    ------
    CellFileError : the profile lacks a key that its kind of torque needs
    """
    profile = axis.profile
    try:
        units = _units(axis, profile)
        make = MAKES.get(str(profile.get("name")))
        return units if make is None else make(axis, units)
    except (KeyError, TypeError) as error:
        raise CellFileError(
            f"drive profile '{profile.get('name')}': {error} is missing or of the wrong kind."
        ) from error


def _units(axis: AxisSpec, profile: Table) -> DriveUnits:
    kt = axis.torque_constant_nm_per_a
    torque_nm = axis.torque_limit_nm / (abs(axis.gear_ratio) * axis.gear_efficiency) / OVERLOAD
    constants: dict[Address, tuple[str, int]] = {
        (0x6075, 0): ("u32", round(1000.0 * torque_nm / kt)),
        (0x6076, 0): ("u32", round(1000.0 * torque_nm)),
    }
    standard_nm = constants[(0x6076, 0)][1] * 1e-3
    torque = _signal(profile["torque"], kt, torque_nm, constants)
    current = _signal(profile["current"], kt, torque_nm, constants) if "current" in profile else None
    offset = profile.get("torque_offset")
    if offset is not None:
        offset_bits = _bits_per_nm(offset, kt, torque_nm, constants)
    elif str(profile["torque"]["kind"]).startswith("permille"):
        offset_bits = torque.bits_per_unit
    else:
        offset_bits = 1000.0 / standard_nm
    counts = _counts(profile["position"]["counts_per_revolution"], constants)
    return DriveUnits(
        rated_torque_nm=torque_nm,
        rated_current_a=torque_nm / kt,
        torque=torque,
        current=current,
        velocity=_velocity(profile, counts),
        counts_per_rad=counts / (2.0 * math.pi),
        offset_nm_per_bit=1.0 / offset_bits,
        constants=constants,
    )


def named_object(target: Table) -> tuple[Address, str]:
    """Return address and data type of an object that a profile names."""
    return (int(target["index"]), int(target.get("subindex", 0))), str(target["type"])


def _signal(signal: Table, kt: float, torque_nm: float, constants: dict[Address, tuple[str, int]]) -> Word:
    return Word(*named_object(signal["object"]), _bits_per_nm(signal, kt, torque_nm, constants))


def _bits_per_nm(signal: Table, kt: float, torque_nm: float, constants: dict[Address, tuple[str, int]]) -> float:
    """Return the bits of a torque or current object per Nm of motor torque."""
    kind = str(signal["kind"])
    if "rated" not in signal and kind.startswith("permille"):
        return 1000.0 / torque_nm  # the drive has the data of its motor, the profile does not state the object
    if kind == "permille_rated_torque":
        return 1000.0 / _rated(signal["rated"], torque_nm, constants)
    ampere = drive_ampere_per_nm(signal, kt)
    if kind == "permille_rated_current":
        return 1000.0 * ampere / _rated(signal["rated"], torque_nm * ampere, constants)
    if kind == "milliampere":
        return 1000.0 * ampere
    if kind == "internal_unit":
        return ampere / float(signal["internal_unit_a"]["value"])
    raise CellFileError(f"a torque of kind '{kind}' is not known to the simulator.")


def drive_ampere_per_nm(signal: Table, kt: float) -> float:
    """Ampere, as the drive counts it, per Nm of motor torque; sine currents, peak = sqrt(2) rms."""
    drive, motor = (str(signal.get(key)) for key in ("current_reference", "torque_constant_per"))
    factor = {("peak", "rms"): math.sqrt(2.0), ("rms", "peak"): 1.0 / math.sqrt(2.0)}.get((drive, motor), 1.0)
    return factor / kt


def _rated(entry: Table, natural: float, constants: dict[Address, tuple[str, int]]) -> float:
    """Rated value in Nm or in the drive's ampere: the profile's own, else the motor's, shown in the object it names."""
    if "value" in entry:
        return float(entry["value"])
    unit = float(entry["unit"])
    raw = max(1, round(natural / unit))
    address, type_ = named_object(entry["object"])
    constants[address] = (type_, raw)
    return raw * unit


def _counts(entry: Table, constants: dict[Address, tuple[str, int]]) -> float:
    if "value" in entry:
        counts = float(entry["value"])
        constants[(0x608F, 1)] = ("u32", round(counts))
        constants[(0x608F, 2)] = ("u32", 1)
        return counts
    for key, raw in (("object", RESOLUTION), ("per", 1)):
        if key in entry:
            address, type_ = named_object(entry[key])
            constants[address] = (type_, raw)
    return float(RESOLUTION)


def _velocity(profile: Table, counts: float) -> Word:
    entry = profile.get("velocity")
    if entry is None:
        return Word((0x606C, 0), "i32", counts / (2.0 * math.pi))
    if "unit_counts_s" in entry:
        bits = counts / (2.0 * math.pi * float(entry["unit_counts_s"]["value"]))
    else:
        bits = 1.0 / float(entry["unit_rad_s"]["value"])
    return Word(*named_object(entry["object"]), bits)
