"""Object dictionary of a simulated drive: access functions and values of every index and subindex (CiA 301, 7.4).

An entry is a pair of functions. Reads and writes by SDO and by PDO go through the same entry, so that a mapped object
and an uploaded one can never differ.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable, datatypes
from canopen.sdo.exceptions import SdoAbortedError

Address = tuple[int, int]
Value = int | str
Getter = Callable[[], Value]
Setter = Callable[[int], None]

STRUCT_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}
LIMITS = {
    "u8": (0, 0xFF),
    "i8": (-0x80, 0x7F),
    "u16": (0, 0xFFFF),
    "i16": (-0x8000, 0x7FFF),
    "u32": (0, 0xFFFFFFFF),
    "i32": (-0x80000000, 0x7FFFFFFF),
}
_DATA_TYPES = {
    "u8": datatypes.UNSIGNED8,
    "i8": datatypes.INTEGER8,
    "u16": datatypes.UNSIGNED16,
    "i16": datatypes.INTEGER16,
    "u32": datatypes.UNSIGNED32,
    "i32": datatypes.INTEGER32,
    "str": datatypes.VISIBLE_STRING,
}

# SDO abort codes, CiA 301 table 22.
TOGGLE = 0x05030000
UNKNOWN_COMMAND = 0x05040001
UNSUPPORTED_ACCESS = 0x06010000
READ_ONLY = 0x06010002
NO_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_TOO_LONG = 0x06040042
TYPE_LENGTH = 0x06070010
NO_SUBINDEX = 0x06090011
VALUE_RANGE = 0x06090030
TOO_HIGH, TOO_LOW = 0x06090031, 0x06090032
DEVICE_STATE = 0x08000022
NO_DATA = 0x08000024


@dataclass(frozen=True, slots=True)
class Entry:
    """Object dictionary entry: data type, read and write function (None = read only), whether PDO-mappable."""

    type: str
    get: Getter
    set: Setter | None = None
    mappable: bool = False

    @property
    def size_bytes(self) -> int:
        """Return the length of the value [bytes]; 0 for strings."""
        return 0 if self.type == "str" else struct.calcsize(STRUCT_CODES[self.type])


class ObjectStore:
    """Object dictionary entries of one drive, and the stored values of most of them."""

    def __init__(self) -> None:
        self.entries: dict[Address, Entry] = {}
        self.values: dict[Address, Value] = {}

    def constant(self, address: Address, type_: str, value: Value) -> None:
        """Add an object with a constant value."""
        self.values[address] = value
        self.entries[address] = Entry(type_, lambda: self.values[address])

    def parameter(self, address: Address, type_: str, value: int, check: Setter | None = None) -> None:
        """Add a writable object; `check` may refuse a value by SdoAbortedError, or act on it."""
        self.values[address] = value

        def assign(new: int) -> None:
            if check is not None:
                check(new)
            self.values[address] = new

        self.entries[address] = Entry(type_, lambda: self.values[address], assign, mappable=True)

    def live(self, address: Address, type_: str, get: Callable[[], int], set_: Setter | None = None) -> None:
        """Add an object computed at each read; the value is limited to the range of its type."""
        low, high = LIMITS[type_]
        self.entries[address] = Entry(type_, lambda: min(max(get(), low), high), set_, mappable=True)

    def number(self, address: Address) -> int:
        """Return the stored value of a numeric object."""
        return int(self.values[address])

    def find(self, index: int, subindex: int) -> Entry:
        """Entry of an address.

        Raises
        ------
        SdoAbortedError : 0x06020000 no such object, 0x06090011 no such subindex
        """
        entry = self.entries.get((index, subindex))
        if entry is None:
            known = any(address[0] == index for address in self.entries)
            raise SdoAbortedError(NO_SUBINDEX if known else NO_OBJECT)
        return entry

    def read(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object for an upload."""
        entry = self.find(index, subindex)
        value = entry.get()
        if isinstance(value, str):
            return value.encode("ascii")
        return struct.pack("<" + STRUCT_CODES[entry.type], value)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of a download to an object.

        Raises
        ------
        SdoAbortedError : unknown, read only, wrong length, or refused by the object
        """
        entry = self.find(index, subindex)
        if entry.set is None:
            raise SdoAbortedError(READ_ONLY)
        if len(data) != entry.size_bytes:
            raise SdoAbortedError(TYPE_LENGTH)
        entry.set(struct.unpack("<" + STRUCT_CODES[entry.type], data)[0])

    def dictionary(self) -> ObjectDictionary:
        """Return the entries as a canopen object dictionary."""
        table = ObjectDictionary()
        indices = sorted({index for index, _ in self.entries})
        for index in indices:
            subindices = sorted(sub for number, sub in self.entries if number == index)
            if subindices == [0]:
                table.add_object(self._variable(index, 0))
                continue
            record = (
                ODArray(f"object {index:04X}", index) if index == 0x1003 else ODRecord(f"object {index:04X}", index)
            )
            for sub in subindices:
                record.add_member(self._variable(index, sub))
            table.add_object(record)
        return table

    def _variable(self, index: int, subindex: int) -> ODVariable:
        entry = self.entries[index, subindex]
        variable = ODVariable(f"object {index:04X}:{subindex:02X}", index, subindex)
        variable.data_type = _DATA_TYPES[entry.type]
        variable.access_type = "ro" if entry.set is None else "rw"
        variable.pdo_mappable = entry.mappable
        return variable
