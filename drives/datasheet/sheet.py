"""Data sheets as values: the objects of a device, and every line that could not be used, by section and line number.

The reader leaves out what it cannot use and names it (`Sheet.remarks`); it never guesses a type or a value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from canopen.objectdictionary import datatypes

from drives.datasheet.object_values import Value, understood
from drives.objects import DataType

Address = tuple[int, int]

_TYPE_NAMES: Final[dict[int, DataType]] = {
    datatypes.UNSIGNED8: "u8",
    datatypes.INTEGER8: "i8",
    datatypes.UNSIGNED16: "u16",
    datatypes.INTEGER16: "i16",
    datatypes.UNSIGNED32: "u32",
    datatypes.INTEGER32: "i32",
}


@dataclass(frozen=True, slots=True)
class Remark:
    """One statement of a file that is not used, or not as it is written.

    Attributes
    ----------
    section : str
        As written in the file; empty before the first header.
    line : int
    what : str
    of_value : bool
        It concerns a value that a DCF stores: such a file is not written to a drive.
    """

    section: str
    line: int
    what: str
    of_value: bool = False

    def __str__(self) -> str:
        place = f"line {self.line}" if self.line else "the file"
        return f"[{self.section}] {place}: {self.what}" if self.section else f"{place}: {self.what}"


@dataclass(frozen=True, slots=True)
class SheetObject:
    """One object as a data sheet describes it; texts as written, `$NODEID` included.

    Attributes
    ----------
    index, subindex : int
    name : str
    data_type : int
        By CiA 301, table 44.
    access_type : str
        ro, wo, rw, rwr, rww or const.
    pdo_mappable : bool
    unit : str
        Empty where the sheet gives none.
    default, value, low, high : str
        DefaultValue, ParameterValue, LowLimit, HighLimit; empty = not stated.
    line : int
        Of the section.
    """

    index: int
    subindex: int
    name: str = ""
    data_type: int = datatypes.UNSIGNED32
    access_type: str = "rw"
    pdo_mappable: bool = False
    unit: str = ""
    default: str = ""
    value: str = ""
    low: str = ""
    high: str = ""
    line: int = 0

    def read(self, text: str, node_id: int) -> Value | None:
        """Read one of the texts for a node; None where it is empty.

        Raises
        ------
        ValueError
            It is not a value of the object's type.
        """
        return understood(self.data_type, text, node_id) if text else None


@dataclass(frozen=True, slots=True)
class Sheet:
    """What an EDS or DCF states about a device.

    Attributes
    ----------
    name : str
        Of the file.
    vendor_name, product_name : str
        Empty where the file does not state them.
    vendor_id, product_code, revision : int or None
        Of 0x1018, else of section DeviceInfo; a 0 states nothing.
    entries : mapping of (index, subindex) to SheetObject
        Arrays in short form included, element by element.
    remarks : tuple of Remark
        What was left out.
    missing : tuple of str
        Objects that the lists of the file name, and elements that it counts, without a section.
    node_id : int or None
        Of section DeviceComissioning.
    modified_by : str
        Who wrote the file.
    """

    name: str
    vendor_name: str
    product_name: str
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    entries: Mapping[Address, SheetObject]
    remarks: tuple[Remark, ...] = ()
    missing: tuple[str, ...] = ()
    node_id: int | None = None
    modified_by: str = ""

    def type_of(self, index: int, subindex: int = 0) -> DataType | None:
        """Type of an object as profiles name it; None where the sheet has no such object, or one of another kind."""
        entry = self.entries.get((index, subindex))
        return None if entry is None else _TYPE_NAMES.get(entry.data_type)

    def value_of(self, index: int, subindex: int = 0) -> int | None:
        """Value that a DCF stores for an object, else its default; None where the file states none."""
        entry = self.entries.get((index, subindex))
        if entry is None:
            return None
        stored = self.number(entry, entry.value)
        return self.number(entry, entry.default) if stored is None else stored

    def number(self, entry: SheetObject, text: str) -> int | None:
        """Whole number of a text; None where it is none, or depends on a node id that the file does not state."""
        if "$" in text and self.node_id is None:
            return None
        try:
            value = entry.read(text, self.node_id or 0)
        except ValueError:
            return None
        return value if isinstance(value, int) else None

    def remarks_of(self, index: int) -> list[Remark]:
        """Remarks about one index."""
        named = f"{index:04X}"
        return [remark for remark in self.remarks if named in remark.section.upper() or named in remark.what.upper()]
