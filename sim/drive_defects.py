"""Defects of a drive's firmware, brake or network interface: what real drives do against CiA 301, CiA 402 or a manual.

A defect is installed in one drive before it boots. It replaces methods or objects of that drive, so that a drive
without defects runs no line of this module. Unlike a fault (`sim.faults`), a defect does not end or change.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import can

from sim.fake_drive import FakeDrive
from sim.objects import Address, Setter
from sim.pdo import Pdo

#: Delay of a TPDO behind its SYNC, and of the reaction to a controlword [s].
TPDO_DELAY_S, CONTROLWORD_DELAY_S = 0.008, 0.04
#: Age of the torque word, in SYNCs.
TORQUE_AGE_SYNCS = 3
#: Time that the brake takes to close after the motor is off [s].
BRAKE_CLOSING_S = 0.08
_CONTROLWORD: Address = (0x6040, 0)
_INTERPOLATION: tuple[tuple[Address, int], ...] = (((0x60C2, 1), 1), ((0x60C2, 2), -3))


@dataclass(frozen=True, slots=True)
class DriveDefect:
    """One defect: how it is installed, and what it is in one line."""

    install: Callable[[FakeDrive], None]
    meaning: str


class DefectError(ValueError):
    """A defect that is not known, or a node that is not in the cell."""


def install_defects(drives: Iterable[FakeDrive], wanted: Iterable[str]) -> None:
    """Install defects, each given as NODE:NAME.

    Raises
    ------
    DefectError
        A name or node is not known.
    """
    by_node = {drive.node_id: drive for drive in drives}
    for text in wanted:
        node, _, name = text.partition(":")
        drive = by_node.get(int(node)) if node.isdigit() else None
        if drive is None or name not in DEFECTS:
            known = f"nodes {', '.join(map(str, by_node))}; names {', '.join(DEFECTS)}"
            raise DefectError(f"defect '{text}' is not NODE:NAME ({known})")
        DEFECTS[name].install(drive)


# ---------------------------------------------------------------------------------------------------------------- SDO


def _with_setter(drive: FakeDrive, address: Address, setter: Setter) -> None:
    drive.store.entries[address] = replace(drive.store.entries[address], set=setter)
    for pdo in (*drive.tpdos, *drive.rpdos):
        pdo.refresh()


def _shown_alone(drive: FakeDrive, address: Address, acts: int) -> None:
    """Let an object return what is written to it, while the drive acts on another value."""
    entry, shown = drive.store.entries[address], [drive.store.number(address)]

    def write(value: int) -> None:
        if entry.set is not None:
            entry.set(value)  # refuses what is out of range
        shown[0] = value
        drive.store.values[address] = acts

    drive.store.entries[address] = replace(entry, get=lambda: shown[0], set=write)
    drive.quirks.values[address] = acts
    drive.take_quirks()


# ----------------------------------------------------------------------------------------- EMCY, heartbeat, NMT, SYNC


def _ignores_master_loss(drive: FakeDrive) -> None:
    drive.node.on_heartbeat_lost = lambda _node: None


def _delayed_tpdo(drive: FakeDrive) -> None:
    due: deque[tuple[float, can.Message]] = deque()
    now = [0.0]
    advanced = drive.advanced

    def transmit(tpdo: Pdo) -> None:
        message = can.Message(arbitration_id=tpdo.frame_id, data=tpdo.pack(), is_extended_id=False)
        due.append((now[0] + TPDO_DELAY_S, message))

    def later(time_s: float) -> None:
        now[0] = time_s
        advanced(time_s)
        while due and time_s >= due[0][0]:
            drive.put(due.popleft()[1])

    drive.transmit, drive.advanced = transmit, later


def _every_second_sync(drive: FakeDrive) -> None:
    transmit, sync = drive.transmit, drive.sync
    state = {"count": 0, "syncing": False}

    def send(tpdo: Pdo) -> None:
        if not state["syncing"] or state["count"] % 2 == 0:
            transmit(tpdo)

    def on_sync() -> None:
        state["count"] += 1
        state["syncing"] = True
        sync()
        state["syncing"] = False

    drive.transmit, drive.sync = send, on_sync


# ------------------------------------------------------------------------------------------------- words in and out


def _old_torque(drive: FakeDrive) -> None:
    word = drive.units.torque
    entry, kept = drive.store.entries[word.address], deque([0] * (TORQUE_AGE_SYNCS + 1), TORQUE_AGE_SYNCS + 1)
    sync = drive.sync

    def on_sync() -> None:
        kept.append(int(entry.get()))
        sync()

    drive.sync = on_sync
    drive.store.entries[word.address] = replace(entry, get=lambda: kept[0])
    for pdo in drive.tpdos:
        pdo.refresh()


def _delayed_controlword(drive: FakeDrive) -> None:
    due: deque[tuple[float, int]] = deque()
    now = [0.0]
    advanced = drive.advanced

    def later(time_s: float) -> None:
        now[0] = time_s
        while due and time_s >= due[0][0]:
            drive.take_controlword(due.popleft()[1])
        advanced(time_s)

    drive.advanced = later
    _with_setter(drive, _CONTROLWORD, lambda word: due.append((now[0] + CONTROLWORD_DELAY_S, word)))


def _delayed_rpdo(drive: FakeDrive) -> None:
    received, sync = drive.rpdo_received, drive.sync
    waiting: list[tuple[int, bytes]] = []

    def on_sync() -> None:
        sync()
        for number, data in waiting:
            received(number, data)
        waiting.clear()

    drive.rpdo_received = lambda number, data: waiting.append((number, data))
    drive.sync = on_sync


# ------------------------------------------------------------------------------------------------------------ motion


def _ignores_interpolation(drive: FakeDrive) -> None:
    for address, acts in _INTERPOLATION:
        _shown_alone(drive, address, acts)


def _slow_brake(drive: FakeDrive) -> None:
    drive.motion.brake_closing_s = BRAKE_CLOSING_S


DEFECTS: dict[str, DriveDefect] = {
    "ignores_master_loss": DriveDefect(_ignores_master_loss, "the drive runs on without the master's heartbeat"),
    "delayed_tpdo": DriveDefect(_delayed_tpdo, "TPDOs are sent 8 ms after they are due"),
    "every_second_sync": DriveDefect(_every_second_sync, "synchronous TPDOs are sent at every second SYNC"),
    "old_torque": DriveDefect(_old_torque, "the torque word is three SYNCs old"),
    "delayed_controlword": DriveDefect(_delayed_controlword, "a controlword acts after 40 ms"),
    "delayed_rpdo": DriveDefect(_delayed_rpdo, "synchronous RPDOs act one SYNC after their own"),
    "quick_stop_coasts": DriveDefect(
        lambda drive: _shown_alone(drive, (0x605A, 0), 0), "the axis coasts in a quick stop, whatever 0x605A shows"
    ),
    "fault_coasts": DriveDefect(
        lambda drive: _shown_alone(drive, (0x605E, 0), 0), "the axis coasts in a fault, whatever 0x605E shows"
    ),
    "slow_brake": DriveDefect(_slow_brake, "the brake closes 80 ms after the motor is off"),
    "ignores_interpolation": DriveDefect(_ignores_interpolation, "setpoints are reached in 1 ms, whatever 0x60C2 is"),
}
