"""Objects of a simulated drive that hold a measured quantity, and their scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Address = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Word:
    """An object that holds a measured quantity: raw = quantity x `bits_per_unit`."""

    address: Address
    type: str
    bits_per_unit: float


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """Scales of one drive, motor side.

    Attributes
    ----------
    rated_torque_nm : of the motor [Nm]
    rated_current_a : of the motor, in the ampere the torque constant refers to [A]
    torque, current : objects that the profile names for them; bits per Nm of reported torque
    velocity : object and bits per rad/s
    counts_per_rad : of the motor
    offset_nm_per_bit : what one bit of 0x60B2 and 0x6071 demands [Nm]
    constants : objects the drive shows for its ratings and resolution, raw
    ramp_bits : bits of accelerations per rad/s2, where they are not those of the velocity
    """

    rated_torque_nm: float
    rated_current_a: float
    torque: Word
    current: Word | None
    velocity: Word
    counts_per_rad: float
    offset_nm_per_bit: float
    constants: Mapping[Address, tuple[str, int]]
    ramp_bits: float | None = None
