"""Read every object of a drive that its data sheet lists; compare it with configuration file and factory defaults."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drives.access import NodeAccess
from drives.configuration.dcf import NodeConfiguration, can_hold
from drives.configuration.kinds import Kind, beyond_length, kind_of, mapped_objects
from drives.datasheet.object_values import Value, decoded, encoded, is_held, size_bytes, type_name, written
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


#: `both`: drive and file have left the default, for different values; `differs`: the sheet gives no default.
State = Literal["equal", "changed on drive", "changed in DCF", "both", "differs", "not on drive"]


@dataclass(frozen=True, slots=True)
class Compared:
    """One object of the configuration.

    Attributes
    ----------
    index, subindex : int
    name : str
    data_type : int
        By CiA 301.
    unit : str
        Empty where the sheet gives none.
    default, file, drive : value or None
        None = the sheet gives no default; the drive does not give the object.
    state : State
    why : str
        Why the drive does not give it.
    """

    index: int
    subindex: int
    name: str
    data_type: int
    unit: str
    default: Value | None
    file: Value
    drive: Value | None
    state: State
    why: str = ""

    @property
    def address(self) -> Address:
        """(index, subindex)."""
        return self.index, self.subindex

    @property
    def kind_and_unit(self) -> str:
        """Type, and unit where there is one."""
        return " ".join(filter(None, (type_name(self.data_type), self.unit)))

    def text(self, value: Value | None) -> str:
        """Return the text of a value; a dash where there is none."""
        return "-" if value is None else written(self.data_type, value)


def compare(file: NodeConfiguration, found: Readout) -> tuple[Compared, ...]:
    """Every object of the configuration that the file gives a value, in the order of the addresses.

    Left out: objects that are not configuration (`kinds`), and entries of a PDO mapping that it does not use.
    """
    mapped = mapped_objects(found.values) | mapped_objects(file.values)
    rows = []
    for address, value in sorted(file.values.items()):
        entry = file.sheet.entries[address]
        if kind_of(entry, mapped) != "configuration" or beyond_length(address, file.values):
            continue
        default, drive = file.defaults.get(address), found.values.get(address)
        data_type = entry.data_type
        state = "not on drive" if drive is None else _state(data_type, default, value, drive)
        name, why = name_of(file.sheet, address), found.unread.get(address, "")
        rows.append(Compared(*address, name, data_type, entry.unit, default, value, drive, state, why))
    return tuple(rows)


def _state(data_type: int, default: Value | None, file: Value, drive: Value) -> State:
    if encoded(data_type, file) == encoded(data_type, drive):
        return "equal"
    if default is None:
        return "differs"
    first = encoded(data_type, default)
    if encoded(data_type, file) == first:
        return "changed on drive"
    return "changed in DCF" if encoded(data_type, drive) == first else "both"


def differing(rows: Sequence[Compared]) -> tuple[Compared, ...]:
    """Rows that are not equal."""
    return tuple(row for row in rows if row.state != "equal")
