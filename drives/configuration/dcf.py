"""Device configuration files (CiA 306), one per node: the data sheet of a drive with the values that it shall have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Final

from canopen.objectdictionary import ODVariable

from drives.configuration.sheet_text import COMMISSIONING, configured, expanded, missing_sections, node_of
from drives.configuration.values import Value, understood, written
from drives.eds import Sheet, sheet_of_text, sheet_text
from drives.errors import ProfileError
from drives.objects import object_name
from drives.values import Identity

Address = tuple[int, int]
_WRONG_FILE: Final = "give the file that `config dump` wrote, or another DCF (CiA 306) of this drive"
#: Problems of a file that are told at once.
_TOLD: Final = 10


class ConfigurationFileError(ProfileError):
    """A device configuration file, or the data sheet for one, that cannot be used."""


@dataclass(frozen=True, slots=True)
class NodeConfiguration:
    """What a device configuration file says of one node.

    Attributes
    ----------
    path : Path
    node_id : int
    sheet : Sheet
        Objects, their limits and defaults.
    values : mapping of (index, subindex) to value
        What they shall hold.
    defaults : mapping of (index, subindex) to value
        What they hold as the maker delivers them, where the sheet says so.
    """

    path: Path
    node_id: int
    sheet: Sheet
    values: Mapping[Address, Value]
    defaults: Mapping[Address, Value]

    @property
    def serial_number(self) -> int | None:
        """0x1018:04 of the drive that the file is of; None = it does not say."""
        value = self.values.get((0x1018, 4))
        return value if isinstance(value, int) and value else None

    def require_same_product(self, identity: Identity) -> list[str]:
        """Compare a drive with the one that the file is of.

        Returns
        -------
        list of str
            What else is different: another firmware, another serial number; in words.

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
    """Where a drive sits, and who it is: section DeviceComissioning."""

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


def dcf_text(source: Path, values: Mapping[Address, Value], site: Commissioning, moment: datetime) -> str:
    """Text of the file of one node.

    Parameters
    ----------
    source : Path
        Its data sheet.
    values : mapping of (index, subindex) to value
    site : Commissioning
    moment : datetime
        Of the reading.

    Raises
    ------
    ConfigurationFileError
        The sheet cannot be read.
    """
    text = _text(source)
    entries = sheet_of_text(expanded(text), source, site.node_id).entries
    about = {
        "FileName": f"{site.node_id}.dcf",
        "LastEDS": source.name,
        "ModificationTime": moment.strftime("%I:%M%p"),
        "ModificationDate": moment.strftime("%m-%d-%Y"),
        "ModifiedBy": "servo gateway",
    }
    texts = {address: written(_type(entries[address]), value) for address, value in values.items()}
    return configured(text, texts, about, site.lines)


def can_hold(entry: ODVariable, value: Value) -> bool:
    """Whether a file gives a value back as it was: texts with line ends, blanks at an end or comment signs are lost."""
    if not isinstance(value, str):
        return True
    return value != "" and value == value.strip() and value.isprintable() and ";" not in value


def read_data_sheet(path: Path, node_id: int) -> Sheet:
    """Data sheet of a node, arrays in short form included.

    Raises
    ------
    ConfigurationFileError
        It cannot be read.
    """
    return sheet_of_text(expanded(_text(path)), path, node_id)


def read_dcf(path: Path, node_id: int) -> NodeConfiguration:
    """Read the file of one node.

    Raises
    ------
    ConfigurationFileError
        It cannot be read, is cut short, is of another node, or holds values that are none or out of their limits:
        the first ten of them at once.
    """
    text = _text(path)
    try:
        sheet = sheet_of_text(expanded(text), path, node_id)
    except ProfileError as error:
        raise ConfigurationFileError(error.what, advice=_WRONG_FILE) from error
    lacking = missing_sections(text)
    said = node_of(text)
    if said is None or lacking:
        what = f"it lacks {', '.join(lacking[:_TOLD])}" if lacking else f"its section {COMMISSIONING} names no node"
        raise ConfigurationFileError(f"{path}: it is cut short, or no DCF: {what}", advice=_WRONG_FILE)
    if said != node_id:
        what = f"{path}: it is of node {said}, not of node {node_id}"
        raise ConfigurationFileError(what, advice="give the file of this node, or correct NodeID in it")
    found = NodeConfiguration(path, node_id, sheet, {}, {})
    problems: list[str] = []
    values = _values(sheet, node_id, "value_raw", problems)
    problems += _out_of_limits(sheet, values)
    if problems:
        told = [f"{path}: {problem}" for problem in problems[:_TOLD]]
        raise ConfigurationFileError.of(told, advice="correct the file, or dump it anew")
    return replace(found, values=values, defaults=_values(sheet, node_id, "default_raw", []))


def _text(path: Path) -> str:
    try:
        return sheet_text(path)
    except ProfileError as error:
        raise ConfigurationFileError(error.what, advice=error.advice) from error


def _values(sheet: Sheet, node_id: int, key: str, problems: list[str]) -> dict[Address, Value]:
    """Values of one key; those that are none are told."""
    values: dict[Address, Value] = {}
    for address, entry in sheet.entries.items():
        text = getattr(entry, key, None)
        if not text:
            continue
        try:
            values[address] = understood(_type(entry), text, node_id)
        except ValueError:
            problems.append(f"{object_name(*address)}: '{text}' is no value of its type")
    return values


def _out_of_limits(sheet: Sheet, values: Mapping[Address, Value]) -> list[str]:
    problems = []
    for address, value in values.items():
        entry = sheet.entries[address]
        if not isinstance(value, int | float) or "w" not in entry.access_type:
            continue
        for limit, bad, word in (
            (entry.min, entry.min is not None and value < entry.min, "below its LowLimit"),
            (entry.max, entry.max is not None and value > entry.max, "above its HighLimit"),
        ):
            if bad:
                problems.append(f"{object_name(*address)}: {value} is {word} {limit}")
    return problems


def _type(entry: ODVariable) -> int:
    return entry.data_type or 0
