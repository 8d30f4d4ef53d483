"""Device configuration files (CiA 306), one per node: the data sheet of a drive with the values that it shall have.

The lines of a data sheet stay as they are; values and node are added.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from drives.configuration.kinds import own_identifier
from drives.datasheet.building import MAX_ELEMENTS, element_name, read_sheet, sheet_of_text
from drives.datasheet.object_values import Value, is_held, plain_number, written
from drives.datasheet.sections import (
    COMMISSIONING,
    COMMISSIONING_NAMES,
    LISTS,
    Section,
    read_text,
    sections_of,
    text_of,
)
from drives.datasheet.sheet import Sheet, SheetObject
from drives.errors import ProfileError
from drives.ledger import KnownDevice
from drives.objects import object_name
from drives.values import Identity

Address = tuple[int, int]

#: Keys of an array in short form that each of its elements has.
_SHARED: Final = ("DataType", "AccessType", "DefaultValue", "PDOMapping", "LowLimit", "HighLimit")
_LENGTH: Final = ("ParameterName=Number of entries", "ObjectType=0x7", "DataType=0x0005", "AccessType=ro")


def configured(
    text: str,
    values: Mapping[Address, str],
    violated: Collection[tuple[Address, str]],
    about: Mapping[str, str],
    commissioning: Mapping[str, str],
) -> str:
    """Write a value at each object of a data sheet.

    Parameters
    ----------
    text : str
        EDS or DCF; values and node of a DCF are replaced.
    values : mapping of (index, subindex) to str
        What becomes `ParameterValue`.
    violated : collection of (address, key)
        Limits that the drive itself does not keep; they become comments.
    about : mapping
        What section FileInfo states.
    commissioning : mapping
        Section DeviceComissioning, the last of the file: a file that was cut short lacks it.
    """
    parts = list(_expanded(sections_of(text)))
    records = {part.address[0] for part in parts if part.address is not None and part.is_element}
    left = dict(values)
    for part in parts:
        part.drop("ParameterValue")
        if part.address is None or (not part.is_element and part.address[0] in records):
            continue
        for address, key in violated:
            if address == part.address:
                part.comment_out(key)
        value = left.pop(part.address, None)
        if value is not None:
            part.put("ParameterValue", value)
    _state_what_is_there(parts)
    info = next((part for part in parts if part.plain_name == "fileinfo"), None)
    if info is None:
        info = Section("FileInfo", 0, [""])
        parts.insert(1, info)
    for key, stated in about.items():
        info.put(key, stated)
    parts[-1].lines += [""]
    return text_of([*parts, Section(COMMISSIONING, 0, [f"{key}={value}" for key, value in commissioning.items()])])


def _expanded(sections: list[Section]) -> Iterator[Section]:
    """Sections with one for each element of every array in short form; without values and node of a DCF."""
    lists = {part.list_of: part for part in sections if part.list_of is not None}
    there = {part.address for part in sections if part.is_element}
    for section in sections:
        if section.list_of is not None or section.plain_name in COMMISSIONING_NAMES:
            continue
        address = section.address
        count = 0 if address is None or section.is_element else _number(section.get("CompactSubObj"))
        if address is None or count <= 0:
            yield section
            continue
        names = lists.get((address[0], "name"), Section("", 0))
        for part in _elements(section, address[0], min(count, MAX_ELEMENTS), names):
            if part is section or part.address not in there:
                yield part


def _elements(section: Section, index: int, count: int, names: Section) -> Iterator[Section]:
    listed = {key: (value, line) for key, value, line in names.statements()}
    shared = [f"{key}={value}" for key in _SHARED if (value := section.get(key)) is not None]
    stated = section.get("ParameterName") or ""
    section.drop("CompactSubObj", *_SHARED)
    section.put("SubNumber", str(count + 1))
    yield section
    yield Section(f"{index:04X}sub0", 0, [*_LENGTH, f"DefaultValue={count}", "PDOMapping=0", ""])
    for sub in range(1, count + 1):
        lines = [f"ParameterName={element_name(listed, sub) or f'{stated}{sub}'}", "ObjectType=0x7", *shared, ""]
        yield Section(f"{index:04X}sub{sub:X}", 0, lines)


def _state_what_is_there(parts: list[Section]) -> None:
    """Lists and numbers of elements name what the file has: a sheet that counts more is complete as it is."""
    heads = {part.address[0] for part in parts if part.address is not None and not part.is_element}
    elements: dict[int, int] = {}
    for part in parts:
        if part.address is not None and part.is_element:
            elements[part.address[0]] = elements.get(part.address[0], 0) + 1
    for part in parts:
        if part.address is not None and not part.is_element:
            count = elements.get(part.address[0], 0)
            if _number(part.get("SubNumber")) > count:
                part.put("SubNumber", str(count))
        elif part.plain_name in LISTS:
            listed = [value for key, value, _ in part.statements() if key.isdigit()]
            there = [value for value in listed if _number(value) in heads]
            if len(there) < len(listed):
                lines = [f"{position}={value}" for position, value in enumerate(there, start=1)]
                part.lines = [f"SupportedObjects={len(there)}", *lines, ""]


def _number(text: str | None) -> int:
    try:
        return plain_number(text or "0")
    except ValueError:
        return 0


#: A value outside a limit of its sheet: address, key of the limit, text of value and limit.
BeyondLimit = tuple[Address, str, str]
_WRONG_FILE: Final = "give the file that `config dump` wrote, or another DCF (CiA 306) of this drive"
#: Problems of a file that are reported at once.
_MOST: Final = 10
#: Author of complete files: an object missing in such a file was lost.
_AUTHOR: Final = "servo gateway"


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
        ProfileError
            It is another product.
        """
        pairs = (
            ("vendor id", self.sheet.vendor_id, identity.vendor_id),
            ("product code", self.sheet.product_code, identity.product_code),
        )
        odd = [f"{what} {said:#x}, and node {identity.node_id} says {have}" for what, said, have in _other(pairs)]
        if odd:
            what = f"{self.path}: it is of another product: {'; '.join(odd)}"
            raise ProfileError(what, advice="give the file of this drive, or the node id that it is of")
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


def dcf_text(
    source: Path,
    values: Mapping[Address, Value],
    moment: datetime,
    device: KnownDevice,
    node_name: str,
    bitrate_bit_s: int,
    network: str,
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
    moment : datetime
        Of the reading.
    device : KnownDevice
        Its node id and serial number.
    node_name, bitrate_bit_s, network
        What section DeviceComissioning states beside them.
    not_kept : sequence of BeyondLimit, optional
        Limits of the sheet that the drive itself does not keep; they become comments.

    Raises
    ------
    ProfileError
        The sheet cannot be read.
    """
    text = read_text(source)
    sheet = sheet_of_text(text, source)
    about = {
        "FileName": f"{device.node_id}.dcf",
        "LastEDS": source.name,
        "ModificationTime": moment.strftime("%I:%M%p"),
        "ModificationDate": moment.strftime("%m-%d-%Y"),
        "ModifiedBy": _AUTHOR,
    }
    texts = {address: _written(sheet.entries[address], value, device.node_id) for address, value in values.items()}
    violated = [(address, key) for address, key, _ in not_kept]
    serial = device.serial_number
    commissioning = {
        "NodeID": str(device.node_id),
        "NodeName": node_name,
        "Baudrate": str(bitrate_bit_s // 1000),
        "NetNumber": "0",
        "NetworkName": network,
        **({} if serial is None else {"LSS_SerialNumber": f"0x{serial:08X}"}),
        "CANopenManager": "0",
    }
    return configured(text, texts, violated, about, commissioning)


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


def read_dcf(path: Path, node_id: int) -> NodeConfiguration:
    """Read the file of one node.

    Raises
    ------
    ProfileError
        The file cannot be read, is truncated, belongs to another node, or stores no values. Invalid values and values
        outside their limits are listed together, the first ten.
    """
    sheet = read_sheet(path)
    lacking = sheet.missing if sheet.modified_by == _AUTHOR else ()
    if sheet.node_id is None or lacking:
        what = f"it lacks {', '.join(lacking[:_MOST])}" if lacking else f"its section {COMMISSIONING} names no node"
        raise ProfileError(f"{path}: it is cut short, or no DCF: {what}", advice=_WRONG_FILE)
    if sheet.node_id != node_id:
        what = f"{path}: it is of node {sheet.node_id}, not of node {node_id}"
        advice = f"let `config dump` write the file of node {node_id}; NodeID = {node_id} in this file gives the node "
        advice += "the other one's values, and its own identifiers only where they are written as $NODEID+..."
        raise ProfileError(what, advice=advice)
    problems = [str(remark) for remark in sheet.remarks if remark.of_value]
    values = _values(sheet, node_id, "value", problems)
    problems += [what for _, _, what in beyond_limits(sheet, values, node_id)]
    if problems:
        texts = [f"{path}: {problem}" for problem in problems[:_MOST]]
        raise ProfileError.of(texts, advice="correct the file, or dump it again")
    if not values:
        what = f"{path}: no object has a value (ParameterValue): there is nothing to compare or to write"
        raise ProfileError(what, advice=_WRONG_FILE)
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
