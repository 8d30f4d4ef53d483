"""Faults inside a simulated drive: what real drives do against CiA 301, CiA 402 or a manual, or when they fail.

Each function is the hook of a kind in `sim.faults.KINDS`. It commands the drive, or replaces a method or an object of
it (`FakeDrive.alter`, `FakeDrive.alter_object`), so that a drive without faults runs no line of this module. What is
replaced persists over an NMT reset, as properties of firmware and hardware do, until `FakeDrive.repair`.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import can
from canopen.sdo.exceptions import SdoAbortedError

from sim.fake_drive import FakeDrive
from sim.fault import Fault
from sim.node import EMCY_OFF, PRE_OPERATIONAL
from sim.objects import DEVICE_STATE, LIMITS, NO_SUBINDEX, TOO_HIGH, TOO_LOW, VALUE_RANGE, Address
from sim.pdo import DISABLED, Pdo
from sim.states import PdsState

DriveHook = Callable[[FakeDrive, Fault], None]

EMCY_COMMUNICATION, EMCY_SAFE_TORQUE_OFF = 0x8100, 0x5442
REGISTER_COMMUNICATION = 0x11
#: Bits in which the serial numbers and the vendors of a drive and of its replacement differ.
OTHER_SERIAL, OTHER_VENDOR = 0x0100_0000, 0x00FF_0001
HUNTING_RAD, HUNTING_HZ = 0.004, 1.5
OBJECTS_WITHOUT_DATA = frozenset({0x6502, 0x1029})
#: Offset to the node id in the EMCY identifier of `foreign_emcy`.
EMCY_NODE_OFFSET = 0x20
#: A SYNC period that differs from 0x1006 by this share is wrong; this number of them in a row ends OPERATIONAL.
SYNC_PERIOD_TOLERANCE, MAX_WRONG_PERIODS = 0.5, 3
#: Number of the TPDO that floods the bus (0 = TPDO1), and the longest pause after which it does not catch up [s].
FLOODING_TPDO, MAX_FLOOD_BACKLOG_S = 2, 0.1
#: Delay of a TPDO behind its SYNC [s]; age of the torque word, in SYNCs.
TPDO_DELAY_S, TORQUE_AGE_SYNCS = 0.008, 3
#: Time that a slow brake takes to close after the motor is off [s].
BRAKE_CLOSING_S = 0.08
CONTROLWORD, STATUSWORD, POSITION, DIGITAL_INPUTS = (0x6040, 0), (0x6041, 0), (0x6064, 0), (0x60FD, 0)
TORQUE_ALLOWED, REFERENCED = 24, 25
#: Bit 30 of 0x1005: the device produces SYNC.
SYNC_PRODUCER = 1 << 30


# ------------------------------------------------------------------------------------------------- power, NMT, states


def lose_power(drive: FakeDrive, _fault: Fault) -> None:
    """The drive loses power: it sends and answers nothing, and its brake closes."""
    drive.alter(drive.node, "unpowered", True)
    drive.axis.lock()
    drive.automaton.power_up()


def restart(keeps: Callable[[int], bool]) -> DriveHook:
    """Return a hook that restarts the drive with its brake applied; it keeps objects by their index."""

    def hook(drive: FakeDrive, _fault: Fault) -> None:
        drive.reset(keeps)
        drive.node.boot()

    return hook


def enter(state: int) -> DriveHook:
    """Return a hook that changes the NMT state."""
    return lambda drive, _fault: drive.node.enter(state)


def raise_fault(drive: FakeDrive, fault: Fault) -> None:
    """The drive goes to FAULT."""
    drive.raise_fault(fault.code)


def quick_stop(drive: FakeDrive, _fault: Fault) -> None:
    """The drive makes a quick stop without a command."""
    drive.make(drive.automaton.quick_stop)


def torque_off(drive: FakeDrive, _fault: Fault) -> None:
    """The safety circuit switches the torque off once."""
    drive.node.emergency(EMCY_SAFE_TORQUE_OFF, 0x81)
    drive.make(drive.automaton.disable_voltage)


def open_safety_circuit(drive: FakeDrive, fault: Fault) -> None:
    """The safety circuit stays open: no controlword leads out of SWITCH ON DISABLED."""
    _without_input(drive, TORQUE_ALLOWED)
    faults = (PdsState.FAULT, PdsState.FAULT_REACTION_ACTIVE)
    _in_place(drive, lambda state: state if state in faults else PdsState.SWITCH_ON_DISABLED)
    if drive.automaton.energised:
        torque_off(drive, fault)
    elif drive.automaton.state is not PdsState.FAULT:
        drive.automaton.state = PdsState.SWITCH_ON_DISABLED


def lose_reference(drive: FakeDrive, _fault: Fault) -> None:
    """The encoder has lost its reference."""
    _without_input(drive, REFERENCED)


def _without_input(drive: FakeDrive, bit: int) -> None:
    shown = drive.store.entries[DIGITAL_INPUTS].get
    drive.alter_object(DIGITAL_INPUTS, get=lambda: int(shown()) & ~(1 << bit))


def never_enable(drive: FakeDrive, _fault: Fault) -> None:
    """The drive stays in SWITCHED ON when it is enabled."""
    _in_place(drive, lambda state: PdsState.SWITCHED_ON if state is PdsState.OPERATION_ENABLED else state)


def _in_place(drive: FakeDrive, other: Callable[[PdsState], PdsState]) -> None:
    """Let each controlword lead to another state than it does in a good drive."""
    automaton, command = drive.automaton, drive.automaton.command

    def prevented(word: int) -> None:
        command(word)
        automaton.state = other(automaton.state)

    drive.alter(automaton, "command", prevented)


def drop_out(drive: FakeDrive, fault: Fault) -> None:
    """The drive falls back to SWITCHED ON a few SYNCs after each enabling."""
    latch = drive.latch
    enabled_syncs = 0

    def drops() -> None:
        nonlocal enabled_syncs
        latch()
        enabled_syncs = enabled_syncs + 1 if drive.automaton.state is PdsState.OPERATION_ENABLED else 0
        if enabled_syncs > fault.count:
            drive.automaton.state = PdsState.SWITCHED_ON
            drive.motion.state_changed(PdsState.SWITCHED_ON)

    drive.alter(drive, "latch", drops)


def refuse_start(drive: FakeDrive, fault: Fault) -> None:
    """A communication error begins at the first START and lasts `delay_s`; until then an EMCY refuses START."""
    node, first_s, erroneous = drive.node, math.nan, False

    def may_start() -> bool:
        nonlocal first_s, erroneous
        now = time.monotonic()
        first_s = now if math.isnan(first_s) else first_s
        before, erroneous = erroneous, now - first_s < fault.delay_s
        if erroneous:
            node.emergency(EMCY_COMMUNICATION, node.error_register | REGISTER_COMMUNICATION)
        elif before:
            node.emergency(0, 0)
        return not erroneous

    drive.alter(node, "may_start", may_start)


def ignore_heartbeat(drive: FakeDrive, _fault: Fault) -> None:
    """The drive runs on without the master's heartbeat."""
    drive.alter(drive.node, "on_heartbeat_lost", lambda _node: None)


def send_no_heartbeat(drive: FakeDrive, _fault: Fault) -> None:
    """The drive sends no heartbeat, whatever 0x1017 holds."""
    drive.alter(drive.node, "keep_time", lambda _simulated_s, _wall_s: None)


# ------------------------------------------------------------------------------------------------------------ objects


def show(address: Address, value: Callable[[FakeDrive, Fault], int]) -> DriveHook:
    """Return a hook that gives an object another value at power-up."""
    return lambda drive, fault: _shows(drive, address, value(drive, fault))


def _shows(drive: FakeDrive, address: Address, value: int) -> None:
    drive.power_up_values[address] = drive.store.values[address] = value


def scale_rating(factor: int) -> DriveHook:
    """Return a hook that shows the rated current and torque in another unit."""

    def hook(drive: FakeDrive, _fault: Fault) -> None:
        for address in ((0x6075, 0), (0x6076, 0)):
            _shows(drive, address, min(drive.store.number(address) * factor, 0xFFFFFFFF))

    return hook


other_vendor = show((0x1018, 1), lambda drive, fault: fault.code or drive.store.number((0x1018, 1)) ^ OTHER_VENDOR)
foreign_emcy = show((0x1014, 0), lambda drive, fault: fault.code or 0x80 + (drive.node_id + EMCY_NODE_OFFSET) % 128)
no_emcy = show((0x1014, 0), lambda drive, _fault: EMCY_OFF | 0x80 + drive.node_id)


def exchange(drive: FakeDrive, fault: Fault) -> None:
    """Replace the drive by another of the same product: serial number and torque limit differ, settings are lost."""
    limit = fault.code or drive.store.number((0x6072, 0)) * 9 // 10
    drive.reset()
    _shows(drive, (0x1018, 4), drive.store.number((0x1018, 4)) ^ OTHER_SERIAL)
    _shows(drive, (0x6072, 0), limit)
    drive.take_max_torque(limit)
    drive.node.boot()


def ignore_writes(drive: FakeDrive, fault: Fault) -> None:
    """A write of an object is confirmed without effect."""
    for address, entry in list(drive.store.entries.items()):
        if address[0] == fault.index and entry.set is not None:
            drive.alter_object(address, set=lambda _value: None)


def _addresses(drive: FakeDrive, fault: Fault) -> list[Address]:
    """Return the object of a fault; with subindex 0, all subindices of its index."""
    index, subindex = fault.index, fault.subindex
    return [each for each in drive.store.entries if each[0] == index and subindex in (0, each[1])]


def lack(drive: FakeDrive, fault: Fault) -> None:
    """Requests of an object, or of optional ones, are aborted, and it is not mapped."""
    without = {fault.index} if fault.index else OBJECTS_WITHOUT_DATA
    refuse, only = drive.node.sdo.refuse, fault.subindex

    def aborted(index: int, subindex: int) -> int | None:
        return fault.code if index in without and only in (0, subindex) else refuse(index, subindex)

    drive.alter(drive.node.sdo, "refuse", aborted)
    do_not_map(drive, fault)


def do_not_map(drive: FakeDrive, fault: Fault) -> None:
    """The object is not mapped into a PDO."""
    for address in _addresses(drive, fault):
        drive.alter_object(address, mappable=False)


def fix(drive: FakeDrive, fault: Fault) -> None:
    """The object is read only."""
    for address in _addresses(drive, fault):
        drive.alter_object(address, set=None)


def deliver(drive: FakeDrive, fault: Fault) -> None:
    """The object has another value at power-up."""
    address = fault.index, fault.subindex
    entry, preset_pdos = drive.store.entries[address], drive.preset_pdos
    low, high = LIMITS[entry.type]
    value = fault.code if fault.code <= high else fault.code - (high - low + 1)
    if address in drive.power_up_values:
        _shows(drive, address, value)
        drive.reset()
        return

    def preset() -> None:
        preset_pdos()
        if entry.set is not None:
            if address[0] >> 8 in (0x14, 0x18) and address[1] == 1:  # an identifier changes while its PDO is off
                entry.set(value | DISABLED)
            entry.set(value)

    drive.alter(drive, "preset_pdos", preset)
    preset()


def _checked(drive: FakeDrive, address: Address, check: Callable[[int], int]) -> None:
    """Let a function change or refuse what is written to an object."""
    assign = drive.store.entries[address].set
    if assign is not None:
        drive.alter_object(address, set=lambda value: assign(check(value)))


def limit(drive: FakeDrive, fault: Fault) -> None:
    """The object accepts a range of values."""

    def check(value: int) -> int:
        if not fault.low <= value <= fault.high:
            raise SdoAbortedError(TOO_LOW if value < fault.low else TOO_HIGH)
        return value

    _checked(drive, (fault.index, fault.subindex), check)


def round_to(drive: FakeDrive, fault: Fault) -> None:
    """The object is rounded to a multiple of `code`."""
    _checked(drive, (fault.index, fault.subindex), lambda value: round(value / fault.code) * fault.code)


def resize(drive: FakeDrive, fault: Fault) -> None:
    """The object is shorter or longer than its type."""
    for address in _addresses(drive, fault):
        entry = drive.store.entries[address]
        type_ = f"{entry.type[0]}{8 * fault.code}"
        if address[1] == 0 and fault.subindex == 0 and (fault.index, 1) in drive.store.entries or type_ not in LIMITS:
            continue  # the number of subindices
        low, high = LIMITS[type_]
        get = entry.get
        drive.alter_object(address, type=type_, get=lambda get=get, low=low, high=high: min(max(int(get()), low), high))


def shorten(drive: FakeDrive, fault: Fault) -> None:
    """The record ends at subindex `code`."""
    drive.alter_object((fault.index, 0), get=lambda: fault.code)
    for _, subindex in _addresses(drive, replace(fault, subindex=0)):
        if subindex > fault.code:
            lack(drive, replace(fault, subindex=subindex, code=NO_SUBINDEX))


def support(drive: FakeDrive, fault: Fault) -> None:
    """0x6502 has other bits, and 0x6060 accepts these modes alone."""
    _shows(drive, (0x6502, 0), fault.code)

    def check(mode: int) -> int:
        if mode > 0 and not fault.code >> mode - 1 & 1:
            raise SdoAbortedError(VALUE_RANGE)
        return mode

    _checked(drive, (0x6060, 0), check)


def status_bits(value: bool) -> DriveHook:
    """Return a hook that sets or clears bits of the statusword."""

    def hook(drive: FakeDrive, fault: Fault) -> None:
        shown = drive.store.entries[STATUSWORD].get
        drive.alter_object(STATUSWORD, get=lambda: int(shown()) | fault.code if value else int(shown()) & ~fault.code)

    return hook


def show_mode_when_enabled(drive: FakeDrive, _fault: Fault) -> None:
    """0x6061 is 0 until the drive is enabled."""
    drive.alter_object((0x6061, 0), get=lambda: drive.motion.mode if drive.enabled else 0)


def warn(drive: FakeDrive, fault: Fault) -> None:
    """The drive sends the EMCY of a warning once it has been enabled for `count` SYNCs."""
    latch, enabled_syncs = drive.latch, 0

    def warns() -> None:
        nonlocal enabled_syncs
        latch()
        enabled_syncs += drive.enabled
        if drive.enabled and enabled_syncs == fault.count:
            drive.node.emergency(fault.code, drive.node.error_register)

    drive.alter(drive, "latch", warns)


def lock_pdos(drive: FakeDrive, _fault: Fault) -> None:
    """Parameters of PDOs are written in PRE-OPERATIONAL alone."""

    def check(value: int) -> int:
        if drive.node.state != PRE_OPERATIONAL:
            raise SdoAbortedError(DEVICE_STATE)
        return value

    for address in [each for each in drive.store.entries if 0x1400 <= each[0] < 0x1C00]:
        _checked(drive, address, check)


def await_both_periods(drive: FakeDrive, _fault: Fault) -> None:
    """Another interpolation period acts once both subindices of 0x60C2 were written."""
    period_s, written = drive.motion.period_s, set[int]()
    acts_s = period_s()

    def noted(subindex: int) -> Callable[[int], int]:
        def note(value: int) -> int:
            written.add(subindex)
            return value

        return note

    def acting_s() -> float:
        nonlocal acts_s
        if written == {1, 2}:
            acts_s = period_s()
            written.clear()
        return acts_s

    for subindex in (1, 2):
        _checked(drive, (0x60C2, subindex), noted(subindex))
    drive.alter(drive.motion, "period_s", acting_s)


def wrap_position(drive: FakeDrive, fault: Fault) -> None:
    """The position has `code` bits and wraps."""
    half = 1 << fault.code - 1
    drive.alter_object(POSITION, get=lambda: (drive.position_counts() + half) % (2 * half) - half)


def forget_turns(drive: FakeDrive, _fault: Fault) -> None:
    """The drive restarts with its brake applied, and its encoder reports the position within one turn."""
    turn = round(math.tau * drive.units.counts_per_rad)
    drive.alter_object(POSITION, get=lambda: drive.position_counts() % turn)
    drive.reset()
    drive.node.boot()


def coast_on_stops(drive: FakeDrive, fault: Fault) -> None:
    """Objects of the stop reactions are 0 at power-up: the axis coasts."""
    for index in (fault.index,) if fault.index else (0x605A, 0x605E):
        _shows(drive, (index, 0), 0)


def act_on(acts: dict[Address, int]) -> DriveHook:
    """Return a hook that lets objects return what is written to them, while the drive acts on other values."""

    def hook(drive: FakeDrive, _fault: Fault) -> None:
        for address, value in acts.items():
            _shown_alone(drive, address, value)

    return hook


def _shown_alone(drive: FakeDrive, address: Address, acts: int) -> None:
    assign, shown = drive.store.entries[address].set, drive.store.number(address)

    def write(value: int) -> None:
        nonlocal shown
        if assign is not None:
            assign(value)  # refuses what is out of range
        shown = value
        drive.store.values[address] = acts

    drive.alter_object(address, get=lambda: shown, set=write)
    _shows(drive, address, acts)


def show_demand(drive: FakeDrive, _fault: Fault) -> None:
    """0x6077 reports the torque demand instead of the measured torque."""
    drive.alter_object(drive.units.torque.address, get=drive.demand_word)


def show_no_sign(drive: FakeDrive, _fault: Fault) -> None:
    """0x6077 reports the torque without its sign."""
    word = drive.torque_word(drive.units.torque)
    drive.alter_object(drive.units.torque.address, get=lambda: abs(word()))


# ---------------------------------------------------------------------------------------------------------- SYNC, PDO


def inhibit_strictly(drive: FakeDrive, fault: Fault) -> None:
    """TPDOs have an inhibit time at power-up, which is not written while the PDO is valid."""
    preset_pdos = drive.preset_pdos

    def preset() -> None:
        preset_pdos()
        for tpdo in drive.tpdos:
            tpdo.inhibit_100us = fault.code

    drive.alter(drive, "preset_pdos", preset)
    for tpdo in drive.tpdos:
        drive.alter(tpdo, "inhibit_abort", VALUE_RANGE)
    preset()


def watch_period(drive: FakeDrive, fault: Fault) -> None:
    """0x1006 is set at power-up; SYNCs of another period end OPERATIONAL."""
    _shows(drive, (0x1006, 0), fault.code)
    latch, node = drive.latch, drive.node
    previous_s, wrong = math.nan, 0

    def compare() -> None:
        nonlocal previous_s, wrong
        latch()
        period_s = drive.store.number((0x1006, 0)) * 1e-6
        passed_s, previous_s = drive.time_s - previous_s, drive.time_s
        wrong = wrong + 1 if period_s and abs(passed_s - period_s) > SYNC_PERIOD_TOLERANCE * period_s else 0
        if wrong >= MAX_WRONG_PERIODS:
            previous_s, wrong = math.nan, 0
            node.emergency(EMCY_COMMUNICATION, node.error_register | REGISTER_COMMUNICATION)
            node.enter(PRE_OPERATIONAL)

    drive.alter(drive, "latch", compare)


def flood(drive: FakeDrive, fault: Fault) -> None:
    """TPDO3 is valid at power-up and is sent at a rate, without a trigger."""
    preset_pdos, send_event, flooding = drive.preset_pdos, drive.send_event, drive.tpdos[FLOODING_TPDO]
    sent_s = math.nan

    def preset() -> None:
        preset_pdos()
        flooding.cob_id &= ~DISABLED

    def send(number: int, time_s: float) -> None:
        nonlocal sent_s
        if number != FLOODING_TPDO:
            send_event(number, time_s)
            return
        if not time_s - sent_s <= MAX_FLOOD_BACKLOG_S:
            sent_s = time_s
        for _ in range(int((time_s - sent_s) * fault.rate_hz)):
            sent_s += 1.0 / fault.rate_hz
            drive.transmit(flooding)

    drive.alter(drive, "preset_pdos", preset)
    drive.alter(drive, "send_event", send)
    preset()


def delay_tpdos(drive: FakeDrive, _fault: Fault) -> None:
    """TPDOs are sent a while after they are due."""
    due: deque[tuple[float, can.Message]] = deque()
    advanced = drive.advanced

    def transmit(tpdo: Pdo) -> None:
        message = can.Message(arbitration_id=tpdo.frame_id, data=tpdo.pack(), is_extended_id=False)
        due.append((drive.time_s + TPDO_DELAY_S, message))

    def later(time_s: float) -> None:
        advanced(time_s)
        while due and time_s >= due[0][0]:
            drive.put(due.popleft()[1])

    drive.alter(drive, "transmit", transmit)
    drive.alter(drive, "advanced", later)


def skip_syncs(drive: FakeDrive, _fault: Fault) -> None:
    """Synchronous TPDOs are sent at every second SYNC."""
    transmit, sync = drive.transmit, drive.sync
    count, syncing = 0, False

    def send(tpdo: Pdo) -> None:
        if not syncing or count % 2 == 0:
            transmit(tpdo)

    def on_sync() -> None:
        nonlocal count, syncing
        count, syncing = count + 1, True
        sync()
        syncing = False

    drive.alter(drive, "transmit", send)
    drive.alter(drive, "sync", on_sync)


def delay_torque(drive: FakeDrive, _fault: Fault) -> None:
    """The torque word is some SYNCs old."""
    address, sync = drive.units.torque.address, drive.sync
    word, kept = drive.store.entries[address].get, deque([0] * (TORQUE_AGE_SYNCS + 1), TORQUE_AGE_SYNCS + 1)

    def on_sync() -> None:
        kept.append(int(word()))
        sync()

    drive.alter(drive, "sync", on_sync)
    drive.alter_object(address, get=lambda: kept[0])


def delay_controlwords(drive: FakeDrive, fault: Fault) -> None:
    """A controlword acts after a while."""
    due: deque[tuple[float, int]] = deque()
    advanced = drive.advanced

    def later(time_s: float) -> None:
        while due and time_s >= due[0][0]:
            drive.take_controlword(due.popleft()[1])
        advanced(time_s)

    drive.alter(drive, "advanced", later)
    drive.alter_object(CONTROLWORD, set=lambda word: due.append((drive.time_s + fault.delay_s, word)))


def enable_slowly(drive: FakeDrive, fault: Fault) -> None:
    """Each transition towards OPERATION ENABLED takes `delay_s`; a stop acts at once."""
    take, advanced, waiting, since_s = drive.take_controlword, drive.advanced, -1, 0.0

    def later(word: int) -> None:
        nonlocal waiting, since_s
        rises = word & 0x06 == 0x06 and not word & 0x80 and not drive.automaton.energised
        if rises and word != waiting:
            waiting, since_s = word, drive.time_s
        elif not rises:
            waiting = -1
            take(word)

    def transit(time_s: float) -> None:
        nonlocal waiting
        if waiting >= 0 and time_s - since_s >= fault.delay_s:
            word, waiting = waiting, -1
            take(word)
        advanced(time_s)

    drive.alter(drive, "take_controlword", later)
    drive.alter(drive, "advanced", transit)
    drive.alter_object(CONTROLWORD, set=later)


def take_rpdos_at_once(drive: FakeDrive, _fault: Fault) -> None:
    """Synchronous RPDOs act when they arrive."""
    received = drive.rpdo_received

    def at_once(number: int, data: bytes) -> None:
        received(number, data)
        drive.take_synchronous()

    drive.alter(drive, "rpdo_received", at_once)


def produce_sync(drive: FakeDrive, fault: Fault) -> None:
    """The drive sends SYNC every `delay_s` until bit 30 of 0x1005 is cleared."""
    keep_time, sent_s = drive.node.keep_time, -math.inf
    _shows(drive, (0x1005, 0), SYNC_PRODUCER | 0x80)

    def sends(simulated_s: float, wall_s: float) -> None:
        nonlocal sent_s
        keep_time(simulated_s, wall_s)
        if drive.store.number((0x1005, 0)) & SYNC_PRODUCER and wall_s - sent_s >= fault.delay_s:
            sent_s = wall_s
            drive.node.send(0x80, b"")

    drive.alter(drive.node, "keep_time", sends)


def delay_rpdos(drive: FakeDrive, _fault: Fault) -> None:
    """Synchronous RPDOs act one SYNC after their own."""
    received, sync = drive.rpdo_received, drive.sync
    waiting: list[tuple[int, bytes]] = []

    def on_sync() -> None:
        sync()
        for number, data in waiting:
            received(number, data)
        waiting.clear()

    drive.alter(drive, "rpdo_received", lambda number, data: waiting.append((number, data)))
    drive.alter(drive, "sync", on_sync)


# ---------------------------------------------------------------------------------------------------------- mechanics


def stick_brake(drive: FakeDrive, _fault: Fault) -> None:
    """The holding brake closes while the drive is enabled, and does not open any more."""
    drive.alter(drive.motion, "brake_stuck", True)
    drive.axis.lock()


def hunt(drive: FakeDrive, _fault: Fault) -> None:
    """The position loop oscillates."""
    drive.alter(drive.motion, "wobble", (HUNTING_RAD, HUNTING_HZ))


def slip(drive: FakeDrive, fault: Fault) -> None:
    """The axis drops slowly with the brake closed."""
    drive.alter(drive.axis, "slip_rad_s", fault.speed_rad_s)


def fall(drive: FakeDrive, fault: Fault) -> None:
    """The brake does not hold the axis after it was opened once."""
    drive.alter(drive.axis, "fall_rad_s2", fault.accel_rad_s2)


def close_brake_slowly(drive: FakeDrive, _fault: Fault) -> None:
    """The brake closes a while after the motor is off."""
    drive.alter(drive.motion, "brake_closing_s", BRAKE_CLOSING_S)
