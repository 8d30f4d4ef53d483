"""How drives of known makes count and in what they differ from the standard drive, from manuals or from code.

Nothing here is read from the profile. A profile that contradicts the make gives a wrong torque, which the test over all
profiles detects.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from sim.cellfile import AxisSpec
from sim.fault import Fault
from sim.objects import NO_OBJECT, Address

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


#: Speed of a drive that counts in increments per second.
_INCREMENTS_PER_S = Word((0x606C, 0), "i32", RESOLUTION / math.tau)

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
    """Elmo: per mille of the current 0x6075 [mA]; 0x6076 [mNm] is the torque at it; velocity in increments/s."""
    rated_ma = round(1000.0 * units.rated_current_a)
    torque_mnm = round(rated_ma * axis.torque_constant_nm_per_a)
    ampere = Word((0x6077, 0), "i16", 1000.0 / (rated_ma * 1e-3 * axis.torque_constant_nm_per_a))
    constants = {**units.constants, (0x6075, 0): ("u32", rated_ma), (0x6076, 0): ("u32", torque_mnm)}
    nm_per_bit = 1.0 / ampere.bits_per_unit
    return replace(units, torque=ampere, velocity=_INCREMENTS_PER_S, offset_nm_per_bit=nm_per_bit, constants=constants)


def emcl(axis: AxisSpec, units: DriveUnits) -> DriveUnits:
    """Novanta EMCL: torque per mille of 0x6076 [mNm], current of 0x6075 [mA, peak]; velocity in increments/s."""
    rated_rms_a = units.rated_torque_nm / axis.torque_constant_nm_per_a
    peak_ma = round(1000.0 * rated_rms_a * math.sqrt(2.0))
    rated = _permille_of_torque(units, round(1000.0 * units.rated_torque_nm), 1e-3)
    peak_ma_per_nm = 1000.0 * math.sqrt(2.0) / axis.torque_constant_nm_per_a
    current = Word((0x6078, 0), "i16", 1000.0 * peak_ma_per_nm / peak_ma)
    constants = {**rated.constants, (0x6075, 0): ("u32", peak_ma)}
    return replace(rated, current=current, velocity=_INCREMENTS_PER_S, constants=constants)


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


#: Name of the profile -> how its make counts.
MAKES: dict[str, Make] = {
    "elmo-gold": elmo,
    "kinco-fd123": kinco_fd123,
    "kollmorgen-akd-x00606": akd_x00606,
    "maxon-epos4": epos4,
    "novanta-emcl": emcl,
    "technosoft-ipos8010": ipos8010,
}


def _absent(*indices: int, code: int = NO_OBJECT) -> tuple[Fault, ...]:
    return tuple(Fault("object_absent", index=index, code=code) for index in indices)


def _value(index: int, subindex: int, value: int) -> Fault:
    return Fault("object_value", index=index, subindex=subindex, code=value & 0xFFFFFFFF)


def _read_only(*indices: int, subindex: int = 0) -> tuple[Fault, ...]:
    return tuple(Fault("object_read_only", index=index, subindex=subindex) for index in indices)


def _inhibit(time_100us: int) -> tuple[Fault, ...]:
    return tuple(_value(0x1800 + number, 3, time_100us) for number in range(1, 4))


RPDOS = range(0x1400, 0x1404)
#: Without 0x6007 a drive makes a quick stop when its master is lost.
_NO_REACTION_CODE = (_value(0x6007, 0, 3), *_absent(0x6007))
_PERIOD_TO_20_MS = Fault("object_range", index=0x60C2, subindex=1, low=1, high=20)
_INDEX_FIXED = Fault("object_range", index=0x60C2, subindex=2, low=-3, high=-3)

_SCHUNK = (
    *_NO_REACTION_CODE,
    *_absent(0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6076),
    Fault("modes_supported", code=0x43),
    _value(0x60C2, 1, 8),
)

#: Name of the profile -> how drives of the make differ from the standard one: rows of `sim.faults.KINDS`.
QUIRKS: dict[str, tuple[Fault, ...]] = {
    # ipa320/cob_robots: Elmo.dcf; statusword: ros_canopen issue 67; 0x6502: SOEM issue 245
    "elmo-gold": (
        *_absent(0x100C, 0x100D),
        Fault("modes_supported", code=0x3ED),
        Fault("object_range", index=0x60C2, subindex=1, low=1, high=255),
        Fault("object_range", index=0x60C2, subindex=2, low=-6, high=-2),
        *(Fault("object_not_mappable", index=0x60C2, subindex=sub) for sub in (1, 2)),
        Fault("status_bits_on", code=1 << 9 | 1 << 10),
    ),
    # ipa320/cob_robots: ElmoSimplIQ.dcf; interpolation: MAN-CAN402IG p. 92
    "elmo-simpliq": (
        Fault("modes_supported", code=0x6D),
        _value(0x60C2, 1, 0),
        *_absent(0x60B1, 0x60B2),
        *_read_only(*RPDOS, subindex=1),
    ),
    # YamamotoSoya/maxon_epos4compact50-5can_ros2: maxon_epos4_0x1018.eds; Gowoon12/maxon_epos4_ros1_csp: CAN_M1.dcf
    "maxon-epos4": (
        Fault("modes_supported", code=0x3A5),
        *_absent(0x1006, 0x1007, 0x1019, 0x100C, 0x100D, 0x60C0, 0x60C1, 0x605D, 0x6091),
        *_read_only(0x1005),
        _value(0x60C2, 1, 0),
        _value(0x6007, 0, 3),
        _value(0x605A, 0, 6),
        _value(0x605C, 0, 1),
        *(Fault("record_short", index=0x1800 + number, code=3) for number in range(4)),
        *_inhibit(10),
    ),
    # Copley Controls 95-00271 p. 209; CML Amp.cpp in Linkeway/BIRL_modular_robot: first drive may produce SYNC
    "copley": (*_absent(0x1006, 0x1019), Fault("status_bits_on", code=1 << 14)),
    # Shaevitzaiden/UnderwaterTestbed-ROS-CANopen: C5-E-1-09.eds; index of the period: PD4-E manual
    "nanotec": (
        *_NO_REACTION_CODE,
        *_absent(0x60C0),
        _INDEX_FIXED,
        *(Fault("object_not_mappable", index=0x60C2, subindex=sub) for sub in (1, 2)),
        _value(0x607A, 0, 4000),
        _value(0x6072, 0, 100),
        *_inhibit(100),
        Fault("status_bits_on", code=1 << 9),
    ),
    # roboticslab-uc3m/yarp-devices: TechnosoftIpos, issues 215 (controlwords) and 245 (modes)
    "technosoft-ipos8010": (*_absent(0x1006, 0x1007), Fault("modes_supported", code=0xE5), _INDEX_FIXED),
    # Kollmorgen AKD CANopen manual p. 105 (0x60C2), webhelp 6502h; warnings are EMCYs and bit 11; memory: abort code
    "kollmorgen-akd-x00606": (
        *_absent(0x1019),
        Fault("modes_supported", code=0xE5),
        _INDEX_FIXED,
        Fault("period_pair"),
        Fault("status_bits_off", code=1 << 9),
        Fault("warning_emcy", count=50, code=0x4390),
        *(Fault("record_short", index=0x1800 + number, code=3) for number in range(4)),
    ),
    # jishuzhan.net on Leadshine csp: 0x60C2 in 1 to 20 ms; iSV2-CAN manual p. 58
    "leadshine": (*_absent(0x6078), _PERIOD_TO_20_MS, _INDEX_FIXED),
    # Delta ASDA-A2-E manual p. 55
    "delta-asda": (_PERIOD_TO_20_MS, _INDEX_FIXED),
    # UniMelbHumanRoboticsLab/CANOpenRobotController: KincoDrive.cpp; bits: FD5 manual; RPDO: canopen-python issue 400
    "kinco-fd123": (Fault("status_bits_on", code=1 << 14 | 1 << 15), Fault("rpdo_at_once")),
    # drives.novantamotion.com; ingeniamc/ingenialink-python: den-net-e_2.8.0_v3.xdf
    "novanta-emcl": (
        Fault("modes_supported", code=0xF03E5),
        *_absent(0x60C1, 0x605B, 0x605C, 0x605E, 0x6091),
        _value(0x605A, 0, 5),
    ),
    # ingeniamc/ingenialink-python: eve-net-c_1.8.1.eds
    "novanta-eve-net-c": (*_absent(0x1016), *_inhibit(1000)),
    # delmic/odemis: TMCM-1240_CANopen_V322.dcf
    "trinamic": (
        *_NO_REACTION_CODE,
        *_absent(0x1003, 0x1006, 0x1007, 0x60B2, 0x60C0, 0x60C1, *range(0x6071, 0x6079)),
        Fault("modes_supported", code=0x1A5),
        *(Fault("object_not_mappable", index=0x60C2, subindex=sub) for sub in (1, 2)),
        Fault("object_not_mappable", index=0x60B1),
        *_read_only(*RPDOS, subindex=2),
        *_read_only(0x605B, 0x605C, 0x605D, 0x605E),
    ),
    # Lexium32A_canopen.cpp: bits 14 and 15; ros2_canopen issue 357: mode 7; memory: abort code
    "schneider-lexium32": (*_absent(0x1006, 0x1019), Fault("status_bits_on", code=1 << 15)),
    # freezeLUO/ZeroErr_Motor_CanOpen: EDS
    "zeroerr-erob": (
        *_NO_REACTION_CODE,
        *_absent(0x605A, 0x6072, 0x6073),
        Fault("modes_supported", code=0x38D),
        Fault("object_size", index=0x60C1, subindex=1, code=2),
        Fault("object_range", index=0x60B2, low=-3000, high=3000),
    ),
    # ipa320/cob_robots: Schunk_0_63.dcf
    "schunk-lwa4p": _SCHUNK,
    # ros2_canopen: prbt_0_1.dcf, of drives by Schunk
    "pilz-prbt": _SCHUNK,
}


#: Behaviours of drives that can be moved, of which a drawn make has some; the rows of one group exclude each other.
_DRAWN: tuple[tuple[tuple[Fault, ...], ...], ...] = (
    *(
        (_absent(index, code=code),)
        for index, code in ((0x1006, 0x06020000), (0x1019, 0x06010000), (0x6502, 0x08000000))
    ),
    (_absent(0x60B2, code=0x06040043), (Fault("object_size", index=0x60B2, code=4),)),
    (_absent(0x6075, code=0x060A0023), _absent(0x6078, code=0x08000020)),
    (_NO_REACTION_CODE, (_value(0x6007, 0, 3),)),
    ((Fault("modes_supported", code=0x43),), (Fault("modes_supported", code=0x3A5),)),
    ((_value(0x60C2, 1, 0),), (_value(0x60C2, 1, 8),)),
    ((_INDEX_FIXED,), (Fault("period_pair"),)),
    ((_value(0x607A, 0, 4000),),),
    (_inhibit(10), _inhibit(100), _inhibit(1000)),
    ((Fault("status_bits_off", code=1 << 9),), (Fault("status_bits_on", code=1 << 9 | 1 << 14 | 1 << 15),)),
    ((Fault("status_bits_on", code=1 << 11),), (Fault("warning_emcy", count=50, code=0x4310),)),
    ((Fault("mode_display_late"),),),
    ((Fault("mapping_locked"),),),
    ((Fault("slow_enable", delay_s=0.05),), (Fault("slow_enable", delay_s=0.3),)),
    (_read_only(*RPDOS, subindex=1), _read_only(*RPDOS, subindex=2), (_value(0x1401, 1, 0x800003F5),)),
    (tuple(Fault("record_short", index=0x1800 + number, code=2) for number in range(4)),),
)
#: Objects that a motion needs; a drive that lacks one must not be moved.
_NEEDED = (0x6040, 0x6041, 0x6060, 0x6064)


def draw_make(seed: int) -> tuple[tuple[Fault, ...], bool]:
    """Return rows of a make drawn from the behaviours of known ones, and whether every object is there to move it.

    One make in five lacks an object that a motion needs. `sim.faults.act` applies the rows to drives.
    """
    rng = random.Random(seed)
    rows = [row for group in _DRAWN if rng.random() < 0.4 for row in rng.choice(group)]
    can_move = rng.random() >= 0.2
    return (*rows, *(() if can_move else _absent(rng.choice(_NEEDED)))), can_move
