"""Objects that hold a measured quantity, and their scale in drives of known makes, from manuals or from code.

Nothing here is read from the profile. A profile that contradicts the make gives a wrong torque, which the test over all
profiles detects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from sim.cellfile import AxisSpec
from sim.objects import Address

#: Counts of one motor revolution of the simulated encoder.
RESOLUTION = 131072


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


Make = Callable[[AxisSpec, DriveUnits], DriveUnits]


def _permille_of_torque(units: DriveUnits, shown: int, nm_per_bit: float) -> DriveUnits:
    """Return the scaling of a drive whose 0x6077, 0x6071 and 0x60B2 are per mille of its 0x6076."""
    bits = 1000.0 / (shown * nm_per_bit)
    return replace(
        units,
        torque=Word((0x6077, 0), "i16", bits),
        offset_nm_per_bit=1.0 / bits,
        constants={**units.constants, (0x6076, 0): ("u32", shown)},
    )


def epos4(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """maxon EPOS4: 0x6076 [uNm] = nominal current [mA] x torque constant [uNm/A] / 1000; velocity in rpm."""
    nominal_ma = round(1000.0 * units.rated_current_a)
    constant_unm_a = round(1e6 * axis.torque_constant_nm_per_a)
    rated = _permille_of_torque(units, nominal_ma * constant_unm_a // 1000, 1e-6)
    constants = {
        **rated.constants,
        (0x3000, 5): ("u32", RESOLUTION),
        (0x3001, 1): ("u32", nominal_ma),
        (0x3001, 5): ("u32", constant_unm_a),
    }
    return replace(rated, velocity=Word((0x606C, 0), "i32", 60.0 / math.tau), constants=constants)


def elmo(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Elmo: the word is per mille of the current 0x6075 [mA]; 0x6076 [mNm] is the torque at that current."""
    rated_ma = round(1000.0 * units.rated_current_a)
    torque_mnm = round(rated_ma * axis.torque_constant_nm_per_a)
    ampere = Word((0x6077, 0), "i16", 1000.0 / (rated_ma * 1e-3 * axis.torque_constant_nm_per_a))
    constants = {**units.constants, (0x6075, 0): ("u32", rated_ma), (0x6076, 0): ("u32", torque_mnm)}
    return replace(units, torque=ampere, offset_nm_per_bit=1.0 / ampere.bits_per_unit, constants=constants)


def emcl(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Novanta EMCL: torque per mille of 0x6076 [mNm]; current per mille of 0x6075, which is a peak value in mA."""
    rated_rms_a = units.rated_torque_nm / axis.torque_constant_nm_per_a
    peak_ma = round(1000.0 * rated_rms_a * math.sqrt(2.0))
    rated = _permille_of_torque(units, round(1000.0 * units.rated_torque_nm), 1e-3)
    peak_ma_per_nm = 1000.0 * math.sqrt(2.0) / axis.torque_constant_nm_per_a
    current = Word((0x6078, 0), "i16", 1000.0 * peak_ma_per_nm / peak_ma)
    return replace(rated, current=current, constants={**rated.constants, (0x6075, 0): ("u32", peak_ma)})


def kinco_fd123(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Kinco FD123: current DEC = A rms x 1.414 x 2048 / 45; velocity DEC = rpm x 512 x resolution / 1875.

    Accelerations DEC = rps/s x 65536 x resolution / 4000000.
    """
    dec_per_nm = 1.414 * 2048.0 / 45.0 / axis.torque_constant_nm_per_a
    rpm = 60.0 / math.tau
    return replace(
        units,
        torque=Word((0x6078, 0), "i16", dec_per_nm),
        velocity=Word((0x606C, 0), "i32", rpm * 512.0 * RESOLUTION / 1875.0),
        ramp_bits=65536.0 * RESOLUTION / 4e6 / math.tau,
        constants={**units.constants, (0x6410, 3): ("u32", RESOLUTION)},
    )


def akd_x00606(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Kollmorgen AKD-x00606: per mille of the continuous current of the drive, 6 A rms, whatever the motor is."""
    bits = 1000.0 / (6.0 * axis.torque_constant_nm_per_a)
    return replace(units, torque=Word((0x6077, 0), "i16", bits), offset_nm_per_bit=1.0 / bits)


def ipos8010(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Technosoft iPOS8010: 65520 units span from minus to plus the peak current of 20 A."""
    bits = 65520.0 / 40.0 / axis.torque_constant_nm_per_a
    return replace(units, torque=Word((0x6077, 0), "i16", bits))


#: What drives of known makes do not have: objects, by the data sheets that the profiles name.
LACKING: dict[str, frozenset[int]] = {
    "novanta-eve-net-c": frozenset({0x1016}),
    "pilz-prbt": frozenset({0x6007}),
    "schunk-lwa4p": frozenset({0x6007}),
}
#: Modes (0x6502) of those that lack one: the PRBT has 1, 2 and 7.
SUPPORTED_MODES: dict[str, int] = {"pilz-prbt": 0x43}


#: Name of the profile -> how its make counts.
MAKES: dict[str, Make] = {
    "elmo-gold": elmo,
    "kinco-fd123": kinco_fd123,
    "kollmorgen-akd-x00606": akd_x00606,
    "maxon-epos4": epos4,
    "novanta-emcl": emcl,
    "technosoft-ipos8010": ipos8010,
}
