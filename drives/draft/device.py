"""Information about a drive before its profile exists: data sheet, and SDO answers where it is connected."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from drives.abort import ABSENT
from drives.bus import Bus
from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet
from drives.discovery import nmt_states, probe, read_identity, refuse_foreign, require_one
from drives.errors import IdentityMismatch, SdoAbort, SdoProtocolError
from drives.objects import OBJECTS, DataType, object_name
from drives.sdo import SdoClient
from drives.values import Identity

#: SI unit velocity (CiA 402-2; notation of CiA 303-2).
VELOCITY_UNIT: Final = (0x60A9, 0)
#: Numerator: radian and revolution; denominator: second and minute.
_TURN_RAD: Final = {0x10: 1.0, 0xB4: 2.0 * math.pi}
_TIME_S: Final = {0x03: 1.0, 0x47: 60.0}


Address = tuple[int, int]

#: Objects read from a connected drive: values that a data sheet omits or that may differ in this firmware.
ASKED: Final = tuple(
    OBJECTS[name].address
    for name in (
        "abort_connection_option",
        "consumer_heartbeat",
        "mode_display",
        "rated_current",
        "rated_torque",
        "torque",
        "target_position",
        "encoder_increments",
        "encoder_revolutions",
        "torque_offset",
        "supported_modes",
    )
) + (VELOCITY_UNIT,)


@dataclass(frozen=True, slots=True)
class Device:
    """A drive as far as it is known.

    Attributes
    ----------
    sheet : Sheet
    identity : Identity or None
        Of the connected drive; None = only the sheet was read.
    live : mapping of (index, subindex) to int or None
        What the drive answered; None = it does not have the object.
    """

    sheet: Sheet
    identity: Identity | None = None
    live: Mapping[Address, int | None] = field(default_factory=dict)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the sheet has an object, and the drive does not deny it."""
        address = (index, subindex)
        return address in self.sheet.entries and not (address in self.live and self.live[address] is None)

    def type_of(self, index: int, subindex: int = 0) -> DataType | None:
        """Type of an object; None where it is not there, or its type is not a number."""
        return self.sheet.type_of(index, subindex) if self.has(index, subindex) else None

    def value_of(self, index: int, subindex: int = 0) -> tuple[int, str] | None:
        """Return a value and its source, the drive before the sheet; None where neither has it."""
        value = self.live.get((index, subindex))
        if value is not None and self.identity is not None:
            return value, f"{object_name(index, subindex)} read from node {self.identity.node_id}"
        value = self.sheet.value_of(index, subindex)
        return None if value is None else (value, f"{object_name(index, subindex)} in {self.sheet.name}")


def device_of_sheet(path: Path) -> Device:
    """A drive of which only the data sheet is at hand.

    Raises
    ------
    ProfileError
        The file cannot be read.
    """
    return Device(read_sheet(path))


def ask_drive(bus: Bus, node_id: int, device: Device) -> Device:
    """Read from a drive what its data sheet omits. Nothing is written, and nothing is sent while another master is
    active.

    Parameters
    ----------
    bus : Bus
    node_id : int
    device : Device
        From its data sheet.

    Raises
    ------
    ForeignMaster
        Another master is active on this bus.
    NodeMissing, DuplicateNode
        No device answers at this node id, or more than one.
    IdentityMismatch
        The sheet is that of another drive.
    SdoError
        The drive stops answering.
    """
    refuse_foreign(bus)
    state = nmt_states(bus, (node_id,), 0.0)[node_id]
    require_one(node_id, probe(bus, (node_id,))[node_id], state)
    sdo = SdoClient(bus, node_id)
    try:
        identity = read_identity(sdo)
        _require_same(identity, device.sheet)
        live: dict[Address, int | None] = {}
        for address in ASKED:
            with suppress(SdoAbort, SdoProtocolError):  # it cannot be read: an open question, or the value of the sheet
                live[address] = _answer(sdo, device.sheet, address)
        return Device(device.sheet, identity, live)
    finally:
        sdo.close()


def _answer(sdo: SdoClient, sheet: Sheet, address: Address) -> int | None:
    kind = sheet.type_of(*address)
    if kind is None:
        return None
    try:
        return sdo.read(*address, kind)
    except SdoAbort as abort:
        if abort.code in ABSENT:
            return None
        raise


def _require_same(identity: Identity, sheet: Sheet) -> None:
    pairs = (("vendor id", sheet.vendor_id, identity.vendor_id), ("product", sheet.product_code, identity.product_code))
    odd = [
        f"{what} {have:#x} instead of {said:#x}"
        for what, said, have in pairs
        if said is not None and have is not None and said != have
    ]
    if odd:
        what = f"is another drive than {sheet.name} describes: {', '.join(odd)}"
        advice = "give the EDS of this drive, or the node id of the drive that the EDS is of"
        raise IdentityMismatch(what, node=identity.node_id, index=0x1018, subindex=1, advice=advice)


def velocity_unit_rad_s(device: Device) -> tuple[float, str] | None:
    """Return the motor speed of one bit of 0x606C [rad/s] and its source; None where the drive does not report it."""
    found = device.value_of(*VELOCITY_UNIT)
    if found is None:
        return None
    unit = unit_rad_s(found[0])
    return None if unit is None else (unit, f"{found[1]} = 0x{found[0]:08X}")


def unit_rad_s(code: int) -> float | None:
    """Unit of a code: power of ten, numerator, denominator, one byte each from the top; None where it is not a
    speed.
    """
    exponent, numerator, denominator = (code >> 24) & 0xFF, (code >> 16) & 0xFF, (code >> 8) & 0xFF
    turn, time = _TURN_RAD.get(numerator), _TIME_S.get(denominator)
    if turn is None or time is None or code & 0xFF:
        return None
    return turn / time * 10.0 ** (exponent - 256 if exponent > 127 else exponent)
