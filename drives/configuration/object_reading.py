"""Read every object of a drive that its data sheet lists; refused objects are listed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from drives.access import NodeAccess
from drives.configuration.dcf import can_hold
from drives.configuration.kinds import Kind, kind_of, mapped_objects
from drives.datasheet.object_values import Value, decoded, is_held, size_bytes, type_name
from drives.datasheet.sheet import Sheet, SheetObject
from drives.errors import SdoAbort, SdoProtocolError
from drives.objects import object_name

Address = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Readout:
    """Values read from a drive.

    Attributes
    ----------
    node_id : int
    values : mapping of (index, subindex) to value
        Everything that was read.
    kinds : mapping of (index, subindex) to Kind
        Of every object of the sheet.
    unread : mapping of (index, subindex) to str
        Why an object that can be read was not.
    """

    node_id: int
    values: Mapping[Address, Value]
    kinds: Mapping[Address, Kind]
    unread: Mapping[Address, str]

    def of_kind(self, *kinds: Kind) -> dict[Address, Value]:
        """Values of objects of these kinds."""
        return {address: value for address, value in self.values.items() if self.kinds[address] in kinds}


def read_drive(access: NodeAccess, sheet: Sheet, also_mapped: Collection[Address] = ()) -> Readout:
    """Read every object of a data sheet; nothing is written.

    Parameters
    ----------
    access : NodeAccess
    sheet : Sheet
    also_mapped : collection of (index, subindex)
        Objects that count as carried by a PDO, beside those that the drive's own PDOs carry.

    Raises
    ------
    SdoTimeout
        The drive no longer answers.
    """
    values: dict[Address, Value] = {}
    unread: dict[Address, str] = {}
    for address, entry in sorted(sheet.entries.items()):
        if address[0] < 0x1000 or kind_of(entry, ()) == "write only":
            continue
        try:
            values[address] = _value(access, entry)
        except SdoAbort as abort:
            unread[address] = abort.what
        except (SdoProtocolError, ValueError) as error:
            unread[address] = error.what if isinstance(error, SdoProtocolError) else str(error)
    mapped = mapped_objects(values) | frozenset(also_mapped)
    kinds: dict[Address, Kind] = {
        address: kind_of(entry, mapped) for address, entry in sheet.entries.items() if address[0] >= 0x1000
    }
    return Readout(access.node_id, values, kinds, unread)


def _value(access: NodeAccess, entry: SheetObject) -> Value:
    data_type = entry.data_type
    if not is_held(data_type):
        raise ValueError(f"type {type_name(data_type)} is not stored")
    value = decoded(data_type, access.sdo.upload(entry.index, entry.subindex, size_bytes=size_bytes(data_type)))
    if not can_hold(entry, value):
        raise ValueError("its text cannot be written in a DCF")
    return value


def name_of(sheet: Sheet, address: Address) -> str:
    """Return the gateway's name of an object, else the name in the sheet."""
    known = object_name(*address)
    return known if "(" in known else f"{known} ({sheet.entries[address].name})"
