"""Compare a drive with its configuration file and the factory defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drives.configuration.dcf import NodeConfiguration
from drives.configuration.kinds import beyond_length, kind_of, mapped_objects
from drives.configuration.object_reading import Readout, name_of
from drives.datasheet.object_values import Value, encoded, type_name, written

Address = tuple[int, int]
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
