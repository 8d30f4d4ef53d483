"""Simulated CANopen servo drive after CiA 301 and CiA 402-2, which exchanges CAN frames with the master under test.

It shares object numbers with the master and no code. Actual values are computed from the simulated motor's torque,
angle and speed with the scaling of the drive's profile; setpoints are converted back with the same scaling.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import can
from canopen.sdo.exceptions import SdoAbortedError

from sim.cellfile import AxisSpec
from sim.device import PDO_COUNT, Device
from sim.makes import Word
from sim.motion import MODES, DriveMotion
from sim.motor import Motor
from sim.node import OPERATIONAL
from sim.objects import LIMITS, VALUE_RANGE, Address, Setter
from sim.pdo import EVENT_TYPES, Pdo
from sim.states import Automaton, PdsState
from sim.units import MAX_TORQUE_PER_MILLE, drive_units, named_object

VOLTAGE_ENABLED, REMOTE = 1 << 4, 1 << 9
EMCY_HEARTBEAT, EMCY_PDO_LENGTH = 0x8130, 0x8210
REGISTER_GENERIC, REGISTER_COMMUNICATION, REGISTER_PROFILE = 0x01, 0x10, 0x20

VENDOR_ID = 0x0000053A
REVISION = 0x00010000
#: Margin of the drive's software limits outside the cell's [rad].
LIMIT_MARGIN_RAD = 0.05
FOLLOWING_WINDOW_RAD = 0.15


class FakeDrive(Device):
    """One simulated drive: network node, object dictionary, CiA 402 state machine and motor.

    Parameters
    ----------
    node_id : CANopen node id
    spec : axis of the cell that the drive moves
    axis : its motor
    sync_period_s : period of the SYNC that it receives
    send : sends a frame on the bus
    limited : has software position limits (not on a coupled axis, whose range depends on other joints)

    Attributes
    ----------
    units : scaling of its objects
    automaton : CiA 402 state machine
    motion : setpoints and what follows of them
    axis : the motor that it drives
    reading_nm : torque measured last, at the gear output [Nm]
    error_code : 0x603F
    time_s : simulated time that it has reached [s]
    power_up_values : objects by address, as they are after a restart
    """

    def __init__(
        self,
        node_id: int,
        spec: AxisSpec,
        axis: Motor,
        sync_period_s: float,
        send: Callable[[can.Message], None],
        limited: bool = True,
    ) -> None:
        super().__init__(node_id, send)
        self.spec, self.sync_period_s = spec, sync_period_s
        self.limited, self.axis = limited, axis
        self.units = drive_units(spec)
        self.serial = 0x51_0000 + node_id
        self.reading_nm = 0.0
        self.automaton = Automaton()
        self.time_s = 0.0
        self.error_code = 0
        self.motion = DriveMotion(spec, self.units, self.store, axis, self.automaton, self.raise_fault)
        fill(self)
        self.motion.reset(0)
        self.tpdos = [Pdo(self.store, 0x1800 + n, 0x1A00 + n) for n in range(PDO_COUNT)]
        self.rpdos = [Pdo(self.store, 0x1400 + n, 0x1600 + n) for n in range(PDO_COUNT)]
        self.connect()
        self.power_up_values = dict(self.store.values)
        self.keep_as_built()
        self.node.on_reset = self.reset
        self.node.on_heartbeat_lost = self._heartbeat_lost
        self.node.on_heartbeat_resumed = self._heartbeat_resumed
        self.take_max_torque(MAX_TORQUE_PER_MILLE)
        self.automaton.power_up()

    def reset(self, keeps: Callable[[int], bool] = lambda _index: False) -> None:
        """Restart with the brake applied; objects and PDOs take their power-up values unless `keeps(index)` is true."""
        self.axis.lock()
        self.error_code = 0
        self.store.values.update({key: value for key, value in self.power_up_values.items() if not keeps(key[0])})
        self.automaton.quick_stop_holds = self.store.number((0x605A, 0)) >= 5
        self.motion.reset(self.motion.mode if keeps(0x6060) else 0)
        if not keeps(0x1800):
            self.preset_pdos()
        self.take_max_torque(self.store.number((0x6072, 0)))
        self.automaton.power_up()

    def keep_as_built(self) -> None:
        """Let `repair` lead back to the drive as it is now, with what was altered until now."""
        self._built = dict(self.power_up_values), dict(self.store.entries)
        self._altered: list[tuple[object, str, Any]] = []

    def alter(self, owner: object, name: str, value: Any) -> None:
        """Replace an attribute or a method of the drive or of a part of it, until `repair`."""
        self._altered.append((owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def alter_object(self, address: Address, **fields: Any) -> None:
        """Replace fields of an object's `Entry` (access functions, type, mapping), for SDO and PDO, until `repair`."""
        self.store.entries[address] = replace(self.store.entries[address], **fields)
        for pdo in (*self.tpdos, *self.rpdos):
            pdo.refresh()

    def repair(self) -> None:
        """Undo every alteration and restart the drive; the caller sends the boot-up message."""
        while self._altered:
            setattr(*self._altered.pop())
        values, entries = self._built
        self.power_up_values = dict(values)
        self.store.entries.update(entries)
        self.reset()

    # ----------------------------------------------------------------------------------------------------- PDOs

    def preset_pdos(self) -> None:
        """Set the default PDO mapping of CiA 402-2: PDO 1 by event (statusword, controlword), others invalid."""
        self.preset(self.tpdos, 0x180, [(0x6041, 0), (0x6064, 0)], first=True)
        self.preset(self.rpdos, 0x200, [(0x6040, 0), (0x607A, 0)], first=True)
        self._buffers: list[bytes | None] = [None] * PDO_COUNT
        self._last_event: list[bytes | None] = [None] * PDO_COUNT
        self._event_due_s = [0.0] * PDO_COUNT

    def rpdo_received(self, number: int, data: bytes) -> None:
        """Process a frame of RPDO `number` (0 = RPDO1); a synchronous RPDO is buffered until the next SYNC."""
        if not self.exchanges:
            return
        rpdo = self.rpdos[number]
        if len(data) < rpdo.packing.size:
            self.node.emergency(EMCY_PDO_LENGTH, self.node.error_register | REGISTER_COMMUNICATION)
        elif rpdo.transmission in EVENT_TYPES:
            rpdo.unpack(data)
        else:
            self._buffers[number] = data

    def latch(self) -> None:
        """Take over the synchronous RPDOs that have come since the last SYNC, and the next setpoint of mode 7."""
        self.take_synchronous()
        self.motion.take_next()

    def take_synchronous(self) -> None:
        """Take over the synchronous RPDOs that have been received."""
        for number, data in enumerate(self._buffers):
            if data is not None:
                self._buffers[number] = None
                self.rpdos[number].unpack(data)

    def send_events(self, time_s: float) -> None:
        """Send event-driven TPDOs: on change, limited by the inhibit time, and when the event timer elapses."""
        if not self.exchanges:
            return
        for number, tpdo in enumerate(self.tpdos):
            if tpdo.enabled and tpdo.transmission in (0, *EVENT_TYPES):
                self.send_event(number, time_s)

    def send_event(self, number: int, time_s: float) -> None:
        """Send an event-driven TPDO (0 = TPDO1) if it is due."""
        tpdo = self.tpdos[number]
        data, before = tpdo.pack(), self._last_event[number]
        waited = time_s - self._event_due_s[number]
        timer = tpdo.event_ms and waited >= tpdo.event_ms * 1e-3
        if (data != before and (before is None or waited >= tpdo.inhibit_100us * 1e-4)) or timer:
            self._last_event[number], self._event_due_s[number] = data, time_s
            self.transmit(tpdo)

    # ------------------------------------------------------------------------------------------- state and faults

    def take_controlword(self, word: int) -> None:
        """Process the controlword (0x6040)."""
        before = self.automaton.state
        self.automaton.command(word)
        if before is PdsState.FAULT and self.automaton.state is PdsState.SWITCH_ON_DISABLED:
            self.error_code = 0
            self.node.emergency(0x0000, 0)
        self.motion.state_changed(before)

    def make(self, transition: Callable[[], None]) -> None:
        """Make a transition of the state machine without a command, and let the motion follow it."""
        before = self.automaton.state
        transition()
        self.motion.state_changed(before)

    @property
    def enabled(self) -> bool:
        """Return whether the drive is in OPERATION ENABLED."""
        return self.automaton.state is PdsState.OPERATION_ENABLED

    def statusword(self) -> int:
        """Return the statusword (0x6041)."""
        word = self.automaton.state.value | VOLTAGE_ENABLED | self.motion.status_bits(self.error_code)
        return word | REMOTE if self.node.state == OPERATIONAL else word

    def take_quick_stop_option(self, value: int) -> None:
        """Set the quick stop option (0x605A): 0 coast, 1-3 end SWITCH ON DISABLED, 5-7 hold QUICK STOP ACTIVE."""
        if value not in (0, 1, 2, 3, 5, 6, 7):
            raise SdoAbortedError(VALUE_RANGE)
        self.automaton.quick_stop_holds = value >= 5

    def raise_fault(self, code: int, register: int = REGISTER_GENERIC | REGISTER_PROFILE) -> None:
        """Make transition 13 of CiA 402: send an EMCY, then start the fault reaction."""
        if self.automaton.state in (PdsState.FAULT, PdsState.FAULT_REACTION_ACTIVE):
            return
        self.error_code = code
        self.node.emergency(code, register)
        self.make(self.automaton.fault)

    def _heartbeat_lost(self, _node_id: int) -> None:
        self.node.emergency(EMCY_HEARTBEAT, self.node.error_register | REGISTER_GENERIC | REGISTER_COMMUNICATION)
        self._connection_lost(EMCY_HEARTBEAT)
        behaviour = self.store.number((0x1029, 1))
        if behaviour != 1 and self.node.state == OPERATIONAL:
            self.node.nmt_command(128 if behaviour == 0 else 2)

    def _heartbeat_resumed(self) -> None:
        """Clear the error register (CiA 301: error reset); in a fault it stays until the fault reset."""
        if self.automaton.state not in (PdsState.FAULT, PdsState.FAULT_REACTION_ACTIVE):
            self.node.emergency(0x0000, 0)

    def nmt_changed(self, old: int, new: int) -> None:
        """Forget what was sent; a drive that leaves OPERATIONAL acts as on a lost connection."""
        super().nmt_changed(old, new)
        if new == OPERATIONAL:
            self._last_event = [None] * PDO_COUNT
        elif old == OPERATIONAL:
            self._connection_lost(0)

    def _connection_lost(self, code: int) -> None:
        """Act on the abort connection option (0x6007): 1 fault, 2 disable voltage, 3 quick stop."""
        automaton, option = self.automaton, self.store.number((0x6007, 0))
        if self.enabled and option:
            if option == 1:
                self.error_code = code or 0x8100
            self.make({1: automaton.fault, 2: automaton.disable_voltage, 3: automaton.quick_stop}[option])

    # ------------------------------------------------------------------------------------------------ words in, out

    def counts_at(self, joint_rad: float) -> int:
        """Return the position [counts] at a joint angle; the cell's zero offset is subtracted first."""
        return round((joint_rad - self.spec.zero_offset_rad) * self.motion.counts_per_joint_rad)

    def position_counts(self) -> int:
        """Return the position actual value (0x6064)."""
        return self.motion.polarity * round(self.axis.position_rad * self.motion.counts_per_joint_rad)

    def demand_counts(self) -> int:
        """Return the position demand value (0x6062)."""
        return self.motion.polarity * round(self.axis.servo.reference_rad * self.motion.counts_per_joint_rad)

    def following_error_counts(self) -> int:
        """Return the following error actual value (0x60F4)."""
        return self.motion.polarity * round(self.axis.servo.error_rad * self.motion.counts_per_joint_rad)

    def _speed_word(self, joint_rad_s: float) -> int:
        motor = self.spec.position_sign * self.spec.gear_ratio * joint_rad_s
        return self.motion.polarity * round(motor * self.units.velocity.bits_per_unit)

    def velocity_word(self) -> int:
        """Return the velocity actual value (0x606C)."""
        return self._speed_word(self.axis.omega_rad_s)

    def demand_velocity(self) -> int:
        """Return the velocity demand value (0x606B)."""
        return self._speed_word(self.axis.servo.reference_step_rad * 1000.0)

    def _motor_nm(self, joint_nm: float) -> float:
        """Convert a torque at the gear output to the motor torque with the drive's sign [Nm]."""
        return joint_nm / (self.spec.torque_sign * self.spec.gear_ratio)

    def torque_word(self, word: Word) -> Callable[[], int]:
        """Return a function that reads the measured torque or current in the scaling of `word`."""
        return lambda: round(self._motor_nm(self.reading_nm) * word.bits_per_unit)

    def demand_word(self) -> int:
        """Return the torque demand (0x6074) in per mille of 0x6076; some drives report it in 0x6077 too."""
        return round(self._motor_nm(self.axis.servo.demand_nm) * 1000.0 / self.units.rated_torque_nm)

    def standard_current_word(self) -> int:
        """Return the current actual value (0x6078) in per mille of 0x6075."""
        return round(self._motor_nm(self.reading_nm) * 1000.0 / self.units.rated_torque_nm)

    def take_max_torque(self, word: int) -> None:
        """Set the maximum torque (0x6072), in per mille of the rated torque."""
        self.axis.servo.max_nm = word * 1e-3 * self.units.rated_torque_nm * abs(self.spec.gear_ratio)

    def digital_inputs(self) -> int:
        """Return the digital inputs (0x60FD).

        Bit 0: negative limit switch; bit 1: positive limit switch. Manufacturer bits: 16 holding brake applied, 24
        safety circuit closed (no emergency stop, torque allowed), 25 encoder referenced.
        """
        counts, low, high = self.position_counts(), self.store.number((0x607D, 1)), self.store.number((0x607D, 2))
        on = bool(low or high)
        limits = (on and counts < low) | (on and counts > high) << 1
        return limits | (not self.axis.free) << 16 | 1 << 24 | 1 << 25

    def advanced(self, time_s: float) -> None:
        """Run the monitoring of heartbeats and motion after the simulation has advanced to `time_s`."""
        self.time_s = time_s
        self.node.watch(time_s)
        self.motion.supervise(time_s)


# ------------------------------------------------------------------------------------------------- object dictionary


def _one_of(*allowed: int, first: Setter = lambda _value: None) -> Setter:
    def check(value: int) -> None:
        first(value)
        if value not in allowed:
            raise SdoAbortedError(VALUE_RANGE)

    return check


def fill(drive: FakeDrive) -> None:
    """Register all objects of a drive except those of PDOs and network management."""
    _device(drive)
    _state_objects(drive)
    _motion_objects(drive)
    _torque_objects(drive)
    _temperature(drive)


def _temperature(drive: FakeDrive) -> None:
    """Register the temperature object if the profile names one."""
    stated = drive.spec.profile.get("temperature")
    if stated is not None:
        address, type_ = named_object(stated["object"])
        per_bit = float(stated["unit_c"]["value"])
        drive.store.live(address, type_, lambda: round(drive.axis.winding_c() / per_bit))


def _device(drive: FakeDrive) -> None:
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


def _state_objects(drive: FakeDrive) -> None:
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
    store.live((0x6060, 0), "i8", lambda: drive.motion.mode, drive.motion.take_mode)
    store.live((0x6061, 0), "i8", lambda: drive.motion.mode)
    store.constant((0x6502, 0), "u32", sum(1 << bit for bit in MODES.values()))
    store.constant((0x6402, 0), "u16", 10)
    store.live((0x60FD, 0), "u32", drive.digital_inputs)
    store.constant((0x60FE, 0), "u8", 1)
    store.live((0x60FE, 1), "u32", lambda: 0 if drive.axis.free else 1)
    store.constant((0x6079, 0), "u32", 565_000)


def _motion_objects(drive: FakeDrive) -> None:
    store, axis, units = drive.store, drive.spec, drive.units
    window = abs(round(FOLLOWING_WINDOW_RAD * drive.motion.counts_per_joint_rad))
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
    store.live((0x607A, 0), "i32", lambda: drive.motion.target_counts, drive.motion.take_target)
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
    store.live((0x60B1, 0), "i32", lambda: drive.motion.velocity_offset, drive.motion.take_velocity_offset)
    store.parameter((0x60C0, 0), "i16", 0, _one_of(0))
    store.constant((0x60C1, 0), "u8", 1)
    store.live((0x60C1, 1), "i32", lambda: drive.motion.record_counts, drive.motion.take_record)
    store.constant((0x60C2, 0), "u8", 2)
    store.parameter((0x60C2, 1), "u8", max(1, round(drive.sync_period_s * 1000.0)), drive.motion.refuse_period)
    store.parameter((0x60C2, 2), "i8", -3, _one_of(-3, -2, -1, 0, first=drive.motion.refuse_period))
    store.live((0x60F4, 0), "i32", drive.following_error_counts)


def _torque_objects(drive: FakeDrive) -> None:
    store, units = drive.store, drive.units
    store.live((0x6071, 0), "i16", lambda: drive.motion.target_torque, drive.motion.take_target_torque)
    store.parameter((0x6072, 0), "u16", MAX_TORQUE_PER_MILLE, drive.take_max_torque)
    store.parameter((0x6073, 0), "u16", MAX_TORQUE_PER_MILLE)
    store.live((0x6074, 0), "i16", drive.demand_word)
    store.live((0x6077, 0), "i16", drive.demand_word)
    store.live((0x6078, 0), "i16", drive.standard_current_word)
    store.live((0x60B2, 0), "i16", lambda: drive.motion.torque_offset, drive.motion.take_torque_offset)
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
