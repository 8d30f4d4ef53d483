"""Read torque demand and current of the drives at the same SYNC as the measured torque.

A third TPDO carries the torque object of the profile, the torque demand 0x6074 and the current of each drive, sampled
at the same SYNC. It is mapped for a check and switched off again; the exchange does not read it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from drives.bus import Bus
from drives.drive import Cia402Drive
from drives.errors import DriveError
from drives.heartbeat import NmtCommand, send_nmt
from drives.objects import OBJECTS
from drives.pdo import INVALID, PdoPlan, tpdo_plan
from drives.profile import DriveProfile, ObjectReference

_DEMAND: Final = ObjectReference(index=OBJECTS["torque_demand"].index, type="i16")
_CURRENT: Final = ObjectReference(index=OBJECTS["current"].index, type="i16")
_MAX_BITS: Final = 64
#: Kept at most; the check is short.
_MOST: Final = 100_000


@dataclass(slots=True)
class TorqueSignals:
    """Raw values of one drive, one entry per SYNC; empty where the drive lacks the object.

    Attributes
    ----------
    node_id : int
    torque, demand, current : lists of int
    missing : str
        Why there are no values; empty where there are.
    """

    node_id: int
    torque: list[int] = field(default_factory=list)
    demand: list[int] = field(default_factory=list)
    current: list[int] = field(default_factory=list)
    missing: str = ""


class TorqueSignalReader:
    """Receiver of a third TPDO of each drive.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
        Configured, not enabled.
    """

    def __init__(self, bus: Bus, drives: Sequence[Cia402Drive]) -> None:
        self.signals = tuple(TorqueSignals(drive.node_id) for drive in drives)
        self._bus = bus
        self._drives = tuple(drives)
        self._plans: dict[int, PdoPlan] = {}
        self._handlers: dict[int, Callable[[int, bytes | bytearray, float], None]] = {}

    def __enter__(self) -> TorqueSignalReader:
        """Map the TPDO on every drive that supports it; `missing` holds the reason of the others."""
        for drive, own in zip(self._drives, self.signals, strict=True):
            try:
                entries = self._entries(drive)
                plan = tpdo_plan(3, drive.node_id, [reference for _, reference in entries])
                send_nmt(self._bus, NmtCommand.ENTER_PREOPERATIONAL, drive.node_id)
                drive.access.map_pdo(plan)
            except DriveError as error:
                own.missing = str(error)
                continue
            lists = [getattr(own, role) for role, _ in entries]
            self._plans[drive.node_id] = plan
            self._handlers[plan.cob_id] = _storing_handler(plan.layout, lists)
            self._bus.subscribe(plan.cob_id, self._handlers[plan.cob_id])
        return self

    def _entries(self, drive: Cia402Drive) -> list[tuple[str, ObjectReference]]:
        profile = drive.setup.profile
        wanted = [("torque", profile.torque.object), ("demand", _DEMAND), ("current", current_object(profile))]
        found: list[tuple[str, ObjectReference]] = []
        bits = 0
        for role, reference in wanted:
            known = any(reference == other for _, other in found)
            if known or bits + reference.size_bits > _MAX_BITS or drive.access.read_readable(reference) is None:
                continue
            found.append((role, reference))
            bits += reference.size_bits
        return found

    def close(self) -> None:
        """Stop listening and switch the TPDO off again; a drive that does not answer keeps it until it is restored."""
        for can_id, handler in self._handlers.items():
            self._bus.unsubscribe(can_id, handler)
        self._handlers.clear()
        for drive in self._drives:
            plan = self._plans.pop(drive.node_id, None)
            if plan is None:
                continue
            off = ObjectReference(index=plan.communication, subindex=1, type="u32")
            try:
                drive.access.write(off, drive.access.read(off) | INVALID, "the check is over")
            except DriveError:
                self._bus.counts["witness_left_on"] += 1

    def __exit__(self, *_: object) -> None:
        self.close()


def current_object(profile: DriveProfile) -> ObjectReference:
    """Return the current object of a drive: the one of its profile, else 0x6078."""
    return _CURRENT if profile.current is None else profile.current.object


def _storing_handler(
    layout: struct.Struct, lists: Sequence[list[int]]
) -> Callable[[int, bytes | bytearray, float], None]:
    def keep(_can_id: int, data: bytes | bytearray, _time_s: float) -> None:
        if len(data) == layout.size and len(lists[0]) < _MOST:
            for values, value in zip(lists, layout.unpack(data), strict=True):
                values.append(value)

    return keep
