"""Fault injection in a simulated drive: each fault changes the drive's state, its quirks or its reported values."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from sim.fake_drive import FakeDrive
from sim.faults import Fault
from sim.node import EMCY_OFF, PRE_OPERATIONAL, STOPPED
from sim.objects import VALUE_RANGE, Address
from sim.server import BusServer
from sim.states import PdsState

ENCODER_FAULT = 0x7305
#: Bits in which the serial numbers of a drive and of its replacement differ.
OTHER_SERIAL = 0x0100_0000
EMCY_SAFE_TORQUE_OFF = 0x5442
HUNTING_RAD, HUNTING_HZ = 0.004, 1.5
#: Values that a fault without its own value takes.
STRICT_INHIBIT_100US = 100
START_REFUSED_S = 0.5
SYNC_PERIOD_US = 1_000
OBJECTS_WITHOUT_DATA = frozenset({0x6502, 0x1029})
FLOOD_HZ = 5_000.0
#: Offset to the node id in the EMCY identifier of `foreign_emcy_id`.
EMCY_NODE_OFFSET = 0x20
DROPS_AFTER_SYNCS = 3
BRAKE_SLIP_RAD_S = 0.02
BRAKE_FALL_RAD_S2 = 5.0


def act(server: BusServer, fault: Fault) -> None:
    """Inject one fault into every drive that it concerns."""
    change = ACTIONS.get(fault.kind)
    if change is None:
        return
    for drive in server.drives:
        if fault.concerns(drive.node_id):
            change(drive, fault)


def _killed(drive: FakeDrive, _fault: Fault) -> None:
    drive.node.unpowered = True
    drive.axis.lock()
    drive.automaton.power_up()


def _reboot(keeps: Callable[[int], bool]) -> Callable[[FakeDrive, Fault], None]:
    def act_on(drive: FakeDrive, _fault: Fault) -> None:
        drive.reset(keeps)
        drive.node.boot()

    return act_on


def _leaves_operational(state: int) -> Callable[[FakeDrive, Fault], None]:
    return lambda drive, _fault: drive.node.enter(state)


def _faulted(drive: FakeDrive, fault: Fault) -> None:
    drive.raise_fault(fault.code or ENCODER_FAULT)


def _quick_stop(drive: FakeDrive, _fault: Fault) -> None:
    before = drive.automaton.state
    drive.automaton.quick_stop()
    drive.motion.state_changed(before)


def _torque_off(drive: FakeDrive, _fault: Fault) -> None:
    before = drive.automaton.state
    drive.node.emergency(EMCY_SAFE_TORQUE_OFF, 0x81)
    drive.automaton.disable_voltage()
    drive.motion.state_changed(before)


def _brake(drive: FakeDrive, _fault: Fault) -> None:
    drive.motion.brake_stuck = True
    drive.axis.lock()


def _hunting(drive: FakeDrive, _fault: Fault) -> None:
    drive.motion.wobble = (HUNTING_RAD, HUNTING_HZ)


def _replace_torque(drive: FakeDrive, make: Callable[[Callable[[], int]], Callable[[], int]]) -> None:
    word = drive.units.torque
    entry = drive.store.entries[word.address]
    drive.store.entries[word.address] = replace(entry, get=make(drive.torque_word(word)))
    for pdo in drive.tpdos:
        pdo.refresh()


def _demand(drive: FakeDrive, _fault: Fault) -> None:
    _replace_torque(drive, lambda _get: drive.demand_word)


def _unsigned(drive: FakeDrive, _fault: Fault) -> None:
    _replace_torque(drive, lambda get: lambda: abs(get()))


def _ignore_heartbeat(drive: FakeDrive, _fault: Fault) -> None:
    drive.node.on_heartbeat_lost = lambda _node: None


def _scaled_rating(factor: int) -> Callable[[FakeDrive, Fault], None]:
    def change(drive: FakeDrive, _fault: Fault) -> None:
        for address in ((0x6075, 0), (0x6076, 0)):
            drive.quirks.values[address] = min(drive.store.number(address) * factor, 0xFFFFFFFF)
        drive.take_quirks()

    return change


def _other_make(drive: FakeDrive, fault: Fault) -> None:
    _shows(drive, (0x1018, 1), fault.code or drive.store.number((0x1018, 1)) ^ 0x00FF0001)


def _exchanged(drive: FakeDrive, fault: Fault) -> None:
    """Replace the drive by another of the same product: serial number and torque limit differ, settings are lost."""
    limit = fault.code or drive.store.number((0x6072, 0)) * 9 // 10
    drive.reset()
    _shows(drive, (0x1018, 4), drive.store.number((0x1018, 4)) ^ OTHER_SERIAL)
    _shows(drive, (0x6072, 0), limit)
    drive.take_max_torque(drive.store.number((0x6072, 0)))
    drive.node.boot()


def _write_ignored(drive: FakeDrive, fault: Fault) -> None:
    index = fault.index or 0x6007
    for address, entry in drive.store.entries.items():
        if address[0] == index and entry.set is not None:
            drive.store.entries[address] = replace(entry, set=lambda _value: None)


def _shows(drive: FakeDrive, address: Address, value: int) -> None:
    drive.quirks.values[address] = value
    drive.take_quirks()


def _strict_inhibit(drive: FakeDrive, _fault: Fault) -> None:
    drive.quirks.inhibit_abort, drive.quirks.inhibit_100us = VALUE_RANGE, STRICT_INHIBIT_100US
    drive.take_quirks()
    drive.preset_pdos()


def _start_refused(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.start_refused_s = fault.delay_s or START_REFUSED_S


def _start_never(drive: FakeDrive, _fault: Fault) -> None:
    drive.quirks.start_refused_s = math.inf


def _cycle_period(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.watches_cycle = True
    _shows(drive, (0x1006, 0), fault.code or SYNC_PERIOD_US)


def _without_data(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.without_data |= {fault.index} if fault.index else OBJECTS_WITHOUT_DATA


def _tpdo3_on(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.flood_hz = fault.rate_hz or FLOOD_HZ
    drive.preset_pdos()


def _foreign_emcy(drive: FakeDrive, fault: Fault) -> None:
    _shows(drive, (0x1014, 0), fault.code or 0x80 + (drive.node_id + EMCY_NODE_OFFSET) % 128)


def _emcy_off(drive: FakeDrive, _fault: Fault) -> None:
    _shows(drive, (0x1014, 0), EMCY_OFF | 0x80 + drive.node_id)


def _coasting(drive: FakeDrive, fault: Fault) -> None:
    for index in (fault.index,) if fault.index else (0x605A, 0x605E):
        _shows(drive, (index, 0), 0)


def _estop(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.sto_open = True
    if drive.automaton.energised:
        _torque_off(drive, fault)
    elif drive.automaton.state is not PdsState.FAULT:
        drive.automaton.state = PdsState.SWITCH_ON_DISABLED


def _unreferenced(drive: FakeDrive, _fault: Fault) -> None:
    drive.quirks.unreferenced = True


def _mute(drive: FakeDrive, _fault: Fault) -> None:
    drive.quirks.mute_heartbeat = True
    drive.take_quirks()


def _drops(drive: FakeDrive, fault: Fault) -> None:
    drive.quirks.drops_after = fault.count or DROPS_AFTER_SYNCS


def _never_enables(drive: FakeDrive, _fault: Fault) -> None:
    drive.quirks.never_enables = True


def _slips(drive: FakeDrive, fault: Fault) -> None:
    drive.axis.slip_rad_s = fault.speed_rad_s or BRAKE_SLIP_RAD_S


def _falls(drive: FakeDrive, fault: Fault) -> None:
    drive.axis.fall_rad_s2 = fault.accel_rad_s2 or BRAKE_FALL_RAD_S2


ACTIONS: dict[str, Callable[[FakeDrive, Fault], None]] = {
    "node_killed": _killed,
    "node_missing": _killed,
    "power_cycle": _reboot(lambda _index: False),
    "reboot_keeps_all": _reboot(lambda _index: True),
    "reboot_keeps_communication": _reboot(lambda index: index < 0x2000),
    "reboot_keeps_nothing": _reboot(lambda _index: False),
    "nmt_stopped": _leaves_operational(STOPPED),
    "nmt_preoperational": _leaves_operational(PRE_OPERATIONAL),
    "drive_fault": _faulted,
    "fault_at_start": _faulted,
    "quick_stop": _quick_stop,
    "safe_torque_off": _torque_off,
    "brake_engaged": _brake,
    "never_settles": _hunting,
    "demand_torque": _demand,
    "unsigned_torque": _unsigned,
    "heartbeat_ignored": _ignore_heartbeat,
    "wrong_rated": _scaled_rating(1000),
    "rated_zero": _scaled_rating(0),
    "wrong_vendor": _other_make,
    "write_ignored": _write_ignored,
    "drive_exchanged": _exchanged,
    "strict_inhibit": _strict_inhibit,
    "start_refused": _start_refused,
    "start_never": _start_never,
    "cycle_period_set": _cycle_period,
    "no_data_abort": _without_data,
    "tpdo3_on": _tpdo3_on,
    "foreign_emcy_id": _foreign_emcy,
    "emcy_disabled": _emcy_off,
    "estop_pressed": _estop,
    "unreferenced": _unreferenced,
    "coasting_stop": _coasting,
    "no_heartbeat": _mute,
    "enables_and_drops": _drops,
    "never_enables": _never_enables,
    "brake_slips": _slips,
    "brake_falls": _falls,
}
