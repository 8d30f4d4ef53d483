"""The text of a data sheet becomes a device configuration file (CiA 306): its lines stay, values and node are added."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

from drives.datasheet.building import MAX_ELEMENTS, element_name
from drives.datasheet.numbers import plain_number
from drives.datasheet.sections import COMMISSIONING, COMMISSIONING_NAMES, LISTS, Section, sections_of, text_of

Address = tuple[int, int]

#: Keys of an array in short form that each of its elements has.
_SHARED: Final = ("DataType", "AccessType", "DefaultValue", "PDOMapping", "LowLimit", "HighLimit")
_LENGTH: Final = ("ParameterName=Number of entries", "ObjectType=0x7", "DataType=0x0005", "AccessType=ro")


def configured(
    text: str,
    values: Mapping[Address, str],
    violated: Collection[tuple[Address, str]],
    about: Mapping[str, str],
    commissioning: Sequence[tuple[str, str]],
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
    commissioning : sequence of (key, value)
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
    return text_of([*parts, Section(COMMISSIONING, 0, [f"{key}={value}" for key, value in commissioning])])


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
