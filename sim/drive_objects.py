"""The object dictionary of one simulated servo drive (CiA 301 and CiA 402-2), filled from cell file and profile."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from canopen.sdo.exceptions import SdoAbortedError

from sim.cellfile import AxisSpec
from sim.makes import SUPPORTED_MODES
from sim.motor import MotorAxis
from sim.objects import LIMITS, VALUE_RANGE, ObjectStore
from sim.states import Automaton
from sim.units import MAX_TORQUE_PER_MILLE, DriveUnits, Word

VENDOR_ID = 0x0000053A
REVISION = 0x00010000
MODES = {1: 0, 8: 7, 10: 9}
#: Margin of the drive's software limits outside the cell's [rad].
LIMIT_MARGIN_RAD = 0.05
FOLLOWING_WINDOW_RAD = 0.15


class DescribedDrive(Protocol):
    """Interface of a drive used by its object dictionary: values read and written by the objects."""

    node_id: int
    serial: int
    limited: bool
    sync_period_s: float
    counts_per_joint_rad: float
    spec: AxisSpec
    units: DriveUnits
    store: ObjectStore
    axis: MotorAxis
    automaton: Automaton
    mode: int
    error_code: int
    target_counts: int
    target_torque: int
    velocity_offset: int
    torque_offset: int

    def statusword(self) -> int: ...
    def digital_inputs(self) -> int: ...
    def position_counts(self) -> int: ...
    def demand_counts(self) -> int: ...
    def following_error_counts(self) -> int: ...
    def counts_at(self, joint_rad: float) -> int: ...
    def velocity_word(self) -> int: ...
    def demand_velocity(self) -> int: ...
    def demand_word(self) -> int: ...
    def standard_current_word(self) -> int: ...
    def torque_word(self, word: Word) -> Callable[[], int]: ...
    def take_controlword(self, word: int) -> None: ...
    def take_mode(self, value: int) -> None: ...
    def take_quick_stop_option(self, value: int) -> None: ...
    def take_target(self, counts: int) -> None: ...
    def take_target_torque(self, word: int) -> None: ...
    def take_velocity_offset(self, value: int) -> None: ...
    def take_torque_offset(self, word: int) -> None: ...
    def take_max_torque(self, word: int) -> None: ...


def _one_of(*allowed: int):
    def check(value: int) -> None:
        if value not in allowed:
            raise SdoAbortedError(VALUE_RANGE)

    return check


def fill(drive: DescribedDrive) -> None:
    """Register all objects of a drive except those of PDOs and network management."""
    _device(drive)
    _state_objects(drive)
    _motion_objects(drive)
    _torque_objects(drive)
    _temperature(drive)


def _temperature(drive: DescribedDrive) -> None:
    """Register the temperature object if the profile names one."""
    stated = drive.spec.profile.get("temperature")
    if stated is None:
        return
    at, per_bit = stated["object"], float(stated["unit_c"]["value"])
    least, most = LIMITS[at["type"]]
    address = (int(at["index"]), int(at.get("subindex", 0)))
    drive.store.live(address, at["type"], lambda: min(max(round(drive.axis.winding_c() / per_bit), least), most))


def _device(drive: DescribedDrive) -> None:
    store, profile = drive.store, drive.spec.profile
    identity = profile.get("identity", {})
    revision = max(int(identity.get("revision_min", 0)), min(REVISION, int(identity.get("revision_max", REVISION))))
    store.constant((0x1000, 0), "u32", 0x00020192)
    store.parameter((0x1005, 0), "u32", 0x80)
    store.parameter((0x1006, 0), "u32", 0)
    store.parameter((0x1007, 0), "u32", 0)
    store.parameter((0x1019, 0), "u8", 0)
    store.constant((0x1008, 0), "str", f"simulated servo drive, {profile.get('name', 'unnamed')}")
    store.constant((0x1009, 0), "str", "simulated hardware 1")
    store.constant((0x100A, 0), "str", "simulated firmware 1.0.0")
    for index, signature in ((0x1010, 0x65766173), (0x1011, 0x64616F6C)):
        store.constant((index, 0), "u8", 1)
        store.parameter((index, 1), "u32", 1, _one_of(signature))
    store.parameter((0x1015, 0), "u16", 0)
    values = (int(identity.get("vendor_id", VENDOR_ID)), int(identity.get("product_code", 1)), revision, drive.serial)
    store.constant((0x1018, 0), "u8", 4)
    for sub, value in enumerate(values, start=1):
        store.constant((0x1018, sub), "u32", value)
    store.constant((0x1029, 0), "u8", 1)
    store.parameter((0x1029, 1), "u8", 1, _one_of(0, 1, 2))
    store.constant((0x1200, 0), "u8", 2)
    store.constant((0x1200, 1), "u32", 0x600 + drive.node_id)
    store.constant((0x1200, 2), "u32", 0x580 + drive.node_id)


def _state_objects(drive: DescribedDrive) -> None:
    store = drive.store
    store.parameter((0x6007, 0), "i16", 1, _one_of(0, 1, 2, 3))
    store.live((0x603F, 0), "u16", lambda: drive.error_code)
    store.live((0x6040, 0), "u16", lambda: drive.automaton.controlword, drive.take_controlword)
    store.live((0x6041, 0), "u16", drive.statusword)
    store.parameter((0x605A, 0), "i16", 2, drive.take_quick_stop_option)
    store.parameter((0x605B, 0), "i16", 0, _one_of(0, 1))
    store.parameter((0x605C, 0), "i16", 0, _one_of(0, 1))
    store.parameter((0x605D, 0), "i16", 1, _one_of(1, 2))
    store.parameter((0x605E, 0), "i16", 2, _one_of(0, 1, 2))
    store.live((0x6060, 0), "i8", lambda: drive.mode, drive.take_mode)
    store.live((0x6061, 0), "i8", lambda: drive.mode)
    modes = sum(1 << bit for bit in MODES.values())
    store.constant((0x6502, 0), "u32", SUPPORTED_MODES.get(str(drive.spec.profile.get("name")), modes))
    store.constant((0x6402, 0), "u16", 10)
    store.live((0x60FD, 0), "u32", drive.digital_inputs)
    store.constant((0x60FE, 0), "u8", 1)
    store.live((0x60FE, 1), "u32", lambda: 0 if drive.axis.free else 1)
    store.constant((0x6079, 0), "u32", 565_000)


def _motion_objects(drive: DescribedDrive) -> None:
    store, axis, units = drive.store, drive.spec, drive.units
    window = abs(round(FOLLOWING_WINDOW_RAD * drive.counts_per_joint_rad))
    speed = axis.speed_limit_rad_s * abs(axis.gear_ratio)
    bits = units.velocity.bits_per_unit
    store.live((0x6062, 0), "i32", drive.demand_counts)
    store.live((0x6063, 0), "i32", drive.position_counts)
    store.live((0x6064, 0), "i32", drive.position_counts)
    store.parameter((0x6065, 0), "u32", window)
    store.parameter((0x6066, 0), "u16", 20)
    store.parameter((0x6067, 0), "u32", max(1, window // 100))
    store.parameter((0x6068, 0), "u16", 50)
    store.live((0x606B, 0), "i32", drive.demand_velocity)
    store.live(units.velocity.address, units.velocity.type, drive.velocity_word)
    store.live((0x607A, 0), "i32", lambda: drive.target_counts, drive.take_target)
    store.constant((0x607C, 0), "i32", 0)
    low, high = axis.position_limit_rad
    ends = [drive.counts_at(low - LIMIT_MARGIN_RAD), drive.counts_at(high + LIMIT_MARGIN_RAD)]
    store.constant((0x607D, 0), "u8", 2)
    for sub, value in ((1, min(ends)), (2, max(ends))):
        least, most = LIMITS["i32"]
        store.parameter((0x607D, sub), "i32", min(max(value, least), most) if drive.limited else 0)
    store.parameter((0x607E, 0), "u8", 0, _one_of(0, 0x80, 0x40, 0xC0))
    store.parameter((0x607F, 0), "u32", max(1, round(2.0 * speed * bits)))
    store.parameter((0x6080, 0), "u32", round(3.0 * speed * 30.0 / math.pi))
    store.parameter((0x6081, 0), "u32", max(1, round(0.5 * speed * bits)))
    for index, seconds in ((0x6083, 1.0), (0x6084, 1.0), (0x6085, 0.1)):
        store.parameter((index, 0), "u32", max(1, round(speed / seconds * (units.ramp_bits or bits))))
    store.parameter((0x6086, 0), "i16", 0, _one_of(0))
    store.constant((0x6091, 0), "u8", 2)
    store.constant((0x6091, 1), "u32", 1)
    store.constant((0x6091, 2), "u32", 1)
    store.live((0x60B1, 0), "i32", lambda: drive.velocity_offset, drive.take_velocity_offset)
    store.constant((0x60C2, 0), "u8", 2)
    store.parameter((0x60C2, 1), "u8", max(1, round(drive.sync_period_s * 1000.0)))
    store.parameter((0x60C2, 2), "i8", -3, _one_of(-3, -2, -1, 0))
    store.live((0x60F4, 0), "i32", drive.following_error_counts)


def _torque_objects(drive: DescribedDrive) -> None:
    store, units = drive.store, drive.units
    store.live((0x6071, 0), "i16", lambda: drive.target_torque, drive.take_target_torque)
    store.parameter((0x6072, 0), "u16", MAX_TORQUE_PER_MILLE, drive.take_max_torque)
    store.parameter((0x6073, 0), "u16", MAX_TORQUE_PER_MILLE)
    store.live((0x6074, 0), "i16", drive.demand_word)
    store.live((0x6077, 0), "i16", drive.demand_word)
    store.live((0x6078, 0), "i16", drive.standard_current_word)
    store.live((0x60B2, 0), "i16", lambda: drive.torque_offset, drive.take_torque_offset)
    seen: set[int] = set()
    for (index, sub), (type_, value) in units.constants.items():
        store.constant((index, sub), type_, value)
        if sub and index not in seen:
            seen.add(index)
            store.constant((index, 0), "u8", 2)
    for word in (units.torque, units.current):
        if word is not None:
            store.live(word.address, word.type, drive.torque_word(word))
            if word.address[1]:
                store.constant((word.address[0], 0), "u8", word.address[1])
