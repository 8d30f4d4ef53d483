"""Faults that happen inside a simulated drive, or in what it says about itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from sim.fake_drive import FakeDrive
from sim.faults import Fault
from sim.node import STOPPED
from sim.server import BusServer

ENCODER_FAULT = 0x7305
STO_CODE = 0x5442
WOBBLE_RAD, WOBBLE_HZ = 0.004, 1.5


def act(server: BusServer, fault: Fault) -> None:
    """Carry out one fault on every drive it concerns."""
    change = ACTIONS.get(fault.kind)
    if change is None:
        return
    for drive in server.drives:
        if fault.concerns(drive.node_id):
            change(drive, fault)


def _killed(drive: FakeDrive, _fault: Fault) -> None:
    drive.node.silent = True
    drive.axis.lock()
    drive.automaton.power_up()


def _power_cycle(drive: FakeDrive, _fault: Fault) -> None:
    drive.reset()
    drive.node.boot()


def _nmt_stopped(drive: FakeDrive, _fault: Fault) -> None:
    drive.node.enter(STOPPED)


def _faulted(drive: FakeDrive, fault: Fault) -> None:
    drive.raise_fault(fault.code or ENCODER_FAULT)


def _quick_stop(drive: FakeDrive, _fault: Fault) -> None:
    before = drive.automaton.state
    drive.automaton.quick_stop()
    drive.motion.state_changed(before)


def _torque_off(drive: FakeDrive, _fault: Fault) -> None:
    before = drive.automaton.state
    drive.node.emergency(STO_CODE, 0x81)
    drive.automaton.disable_voltage()
    drive.motion.state_changed(before)


def _brake(drive: FakeDrive, _fault: Fault) -> None:
    drive.motion.brake_stuck = True
    drive.axis.lock()


def _wobble(drive: FakeDrive, _fault: Fault) -> None:
    drive.motion.wobble = (WOBBLE_RAD, WOBBLE_HZ)


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


def _deaf(drive: FakeDrive, _fault: Fault) -> None:
    drive.node.on_heartbeat_lost = lambda _node: None


def _scaled_rating(factor: int) -> Callable[[FakeDrive, Fault], None]:
    def change(drive: FakeDrive, _fault: Fault) -> None:
        for address in ((0x6075, 0), (0x6076, 0)):
            drive.store.values[address] = min(drive.store.number(address) * factor, 0xFFFFFFFF)

    return change


def _other_make(drive: FakeDrive, fault: Fault) -> None:
    drive.store.values[0x1018, 1] = fault.code or drive.store.number((0x1018, 1)) ^ 0x00FF0001


ACTIONS: dict[str, Callable[[FakeDrive, Fault], None]] = {
    "node_killed": _killed,
    "node_missing": _killed,
    "power_cycle": _power_cycle,
    "nmt_stopped": _nmt_stopped,
    "drive_fault": _faulted,
    "fault_at_start": _faulted,
    "quick_stop": _quick_stop,
    "safe_torque_off": _torque_off,
    "brake_engaged": _brake,
    "never_settles": _wobble,
    "demand_torque": _demand,
    "unsigned_torque": _unsigned,
    "heartbeat_ignored": _deaf,
    "wrong_rated": _scaled_rating(1000),
    "rated_zero": _scaled_rating(0),
    "wrong_vendor": _other_make,
}
