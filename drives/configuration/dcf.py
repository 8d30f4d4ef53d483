"""Device configuration files (CiA 306), one per node: the data sheet of a drive with the values that it shall have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from drives.configuration.dcf_text import configured
from drives.configuration.kinds import own_identifier
from drives.datasheet.building import sheet_of_text
from drives.datasheet.encoding import read_text
from drives.datasheet.object_values import Value, is_held, written
from drives.datasheet.sections import COMMISSIONING
from drives.datasheet.sheet import Sheet, SheetObject
from drives.errors import ProfileError
from drives.objects import object_name
from drives.values import Identity

Address = tuple[int, int]
#: A value outside a limit of its sheet: address, key of the limit, text of value and limit.
BeyondLimit = tuple[Address, str, str]
_WRONG_FILE: Final = "give the file that `config dump` wrote, or another DCF (CiA 306) of this drive"
#: Problems of a file that are reported at once.
_MOST: Final = 10
#: Author of complete files: an object missing in such a file was lost.
_AUTHOR: Final = "servo gateway"


class ConfigurationFileError(ProfileError):
    """A device configuration file, or the data sheet for one, that cannot be used."""


@dataclass(frozen=True, slots=True)
class NodeConfiguration:
    """Content of the device configuration file of one node.

    Attributes
    ----------
    path : Path
    node_id : int
    sheet : Sheet
        Objects, their limits and defaults.
    values : mapping of (index, subindex) to value
        Configured values.
    defaults : mapping of (index, subindex) to value
        Factory values, where the sheet states them.
    """

    path: Path
    node_id: int
    sheet: Sheet
    values: Mapping[Address, Value]
    defaults: Mapping[Address, Value]

    @property
    def serial_number(self) -> int | None:
        """Serial number (0x1018:04) in the file; None = not stated."""
        value = self.values.get((0x1018, 4))
        return value if isinstance(value, int) and value else None

    def require_same_product(self, identity: Identity) -> list[str]:
        """Compare a drive with the one that the file is of.

        Returns
        -------
        list of str
            Other differences as text: firmware, serial number.

        Raises
        ------
        ConfigurationFileError
            It is another product.
        """
        pairs = (
            ("vendor id", self.sheet.vendor_id, identity.vendor_id),
            ("product code", self.sheet.product_code, identity.product_code),
        )
        odd = [f"{what} {said:#x}, and node {identity.node_id} says {have}" for what, said, have in _other(pairs)]
        if odd:
            what = f"{self.path}: it is of another product: {'; '.join(odd)}"
            raise ConfigurationFileError(what, advice="give the file of this drive, or the node id that it is of")
        rest = (
            ("revision", self.sheet.revision, identity.revision),
            ("serial number", self.serial_number, identity.serial_number),
        )
        return [f"{what} {said:#x} in {self.path.name}, {have} on the drive" for what, said, have in _other(rest)]


def _other(pairs: tuple[tuple[str, int | None, int | None], ...]) -> list[tuple[str, int, str]]:
    return [
        (what, said, "none" if have is None else f"{have:#x}")
        for what, said, have in pairs
        if said is not None and said != have
    ]


@dataclass(frozen=True, slots=True)
class Commissioning:
    """Node id, bit rate and serial number of a drive: section DeviceComissioning."""

    node_id: int
    node_name: str
    bitrate_bit_s: int
    network: str
    serial_number: int | None

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Keys and values, the bit rate in kbit/s."""
        serial = () if self.serial_number is None else (("LSS_SerialNumber", f"0x{self.serial_number:08X}"),)
        return (
            ("NodeID", str(self.node_id)),
            ("NodeName", self.node_name),
            ("Baudrate", str(self.bitrate_bit_s // 1000)),
            ("NetNumber", "0"),
            ("NetworkName", self.network),
            *serial,
            ("CANopenManager", "0"),
        )


def dcf_text(
    source: Path,
    values: Mapping[Address, Value],
    site: Commissioning,
    moment: datetime,
    not_kept: Sequence[BeyondLimit] = (),
) -> str:
    """Text of the file of one node.

    Identifiers of the node's own are written relative to it (`$NODEID+0x180`), so that a file that is given to another
    node gives that node its own.

    Parameters
    ----------
    source : Path
        Its data sheet.
    values : mapping of (index, subindex) to value
    site : Commissioning
    moment : datetime
        Of the reading.
    not_kept : sequence of BeyondLimit, optional
        Limits of the sheet that the drive itself does not keep; they become comments.

    Raises
    ------
    ConfigurationFileError
        The sheet cannot be read.
    """
    text = _text(source)
    sheet = _sheet(text, source)
    about = {
        "FileName": f"{site.node_id}.dcf",
        "LastEDS": source.name,
        "ModificationTime": moment.strftime("%I:%M%p"),
        "ModificationDate": moment.strftime("%m-%d-%Y"),
        "ModifiedBy": _AUTHOR,
    }
    texts = {address: _written(sheet.entries[address], value, site.node_id) for address, value in values.items()}
    violated = [(address, key) for address, key, _ in not_kept]
    return configured(text, texts, violated, about, site.lines)


def _written(entry: SheetObject, value: Value, node_id: int) -> str:
    if isinstance(value, int) and own_identifier(entry, value, node_id):
        digits = len(written(entry.data_type, value)) - 2
        return f"$NODEID+0x{value - node_id:0{digits}X}"
    return written(entry.data_type, value)


def can_hold(entry: SheetObject, value: Value) -> bool:
    """Whether a file gives a value back as it was: texts with line ends, blanks at an end or comment signs are lost."""
    if not isinstance(value, str):
        return True
    return value != "" and value == value.strip() and value.isprintable() and ";" not in value


def read_data_sheet(path: Path) -> Sheet:
    """Data sheet of a node.

    Raises
    ------
    ConfigurationFileError
        It cannot be read.
    """
    return _sheet(_text(path), path)


def read_dcf(path: Path, node_id: int) -> NodeConfiguration:
    """Read the file of one node.

    Raises
    ------
    ConfigurationFileError
        The file cannot be read, is truncated, belongs to another node, or stores no values. Invalid values and values
        outside their limits are listed together, the first ten.
    """
    sheet = _sheet(_text(path), path)
    lacking = sheet.missing if sheet.modified_by == _AUTHOR else ()
    if sheet.node_id is None or lacking:
        what = f"it lacks {', '.join(lacking[:_MOST])}" if lacking else f"its section {COMMISSIONING} names no node"
        raise ConfigurationFileError(f"{path}: it is cut short, or no DCF: {what}", advice=_WRONG_FILE)
    if sheet.node_id != node_id:
        what = f"{path}: it is of node {sheet.node_id}, not of node {node_id}"
        advice = f"let `config dump` write the file of node {node_id}; NodeID = {node_id} in this file gives the node "
        advice += "the other one's values, and its own identifiers only where they are written as $NODEID+..."
        raise ConfigurationFileError(what, advice=advice)
    problems = [str(remark) for remark in sheet.remarks if remark.of_value]
    values = _values(sheet, node_id, "value", problems)
    problems += [what for _, _, what in beyond_limits(sheet, values, node_id)]
    if problems:
        texts = [f"{path}: {problem}" for problem in problems[:_MOST]]
        raise ConfigurationFileError.of(texts, advice="correct the file, or dump it again")
    if not values:
        what = f"{path}: no object has a value (ParameterValue): there is nothing to compare or to write"
        raise ConfigurationFileError(what, advice=_WRONG_FILE)
    return NodeConfiguration(path, node_id, sheet, values, _values(sheet, node_id, "default", []))


def beyond_limits(sheet: Sheet, values: Mapping[Address, Value], node_id: int) -> list[BeyondLimit]:
    """Find values that are not within the limits of their sheet."""
    found: list[BeyondLimit] = []
    for address, value in values.items():
        entry = sheet.entries[address]
        if not isinstance(value, int | float) or "w" not in entry.access_type:
            continue
        low, high = (_limit(entry, text, node_id) for text in (entry.low, entry.high))
        if low is not None and value < low:
            found.append((address, "LowLimit", f"{object_name(*address)}: {value} is below its LowLimit {low}"))
        if high is not None and value > high:
            found.append((address, "HighLimit", f"{object_name(*address)}: {value} is above its HighLimit {high}"))
    return found


def _limit(entry: SheetObject, text: str, node_id: int) -> int | float | None:
    limit = entry.read(text, node_id)
    return limit if isinstance(limit, int | float) else None


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except ProfileError as error:
        raise ConfigurationFileError(error.what, advice=error.advice) from error


def _sheet(text: str, path: Path) -> Sheet:
    try:
        return sheet_of_text(text, path)
    except ProfileError as error:
        raise ConfigurationFileError(error.what, advice=_WRONG_FILE) from error


def _values(sheet: Sheet, node_id: int, key: str, problems: list[str]) -> dict[Address, Value]:
    """Values of one key; texts that are no values become problems."""
    values: dict[Address, Value] = {}
    for address, entry in sheet.entries.items():
        text = getattr(entry, key)
        try:
            value = entry.read(text, node_id) if is_held(entry.data_type) else None
        except ValueError:
            problems.append(f"{object_name(*address)}: '{text}' is not a value of its type")
            continue
        if value is not None:
            values[address] = value
    return values
