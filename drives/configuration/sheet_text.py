"""A data sheet as text becomes a device configuration file (CiA 306): its lines stay, values and the node are added."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

Address = tuple[int, int]

#: CiA 306 spells it so.
COMMISSIONING: Final = "DeviceComissioning"
_SECTION: Final = re.compile(r"^\s*\[([^\]]+)\]")
_OBJECT: Final = re.compile(r"^([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?$", re.IGNORECASE)
_NAMES: Final = re.compile(r"^([0-9A-F]{4})NAME$", re.IGNORECASE)
#: Keys of an array in short form that each of its elements has.
_SHARED: Final = ("DataType", "AccessType", "DefaultValue", "PDOMapping", "LowLimit", "HighLimit")


@dataclass(slots=True)
class _Section:
    """A section of the file and its lines; the name is empty before the first."""

    name: str
    lines: list[str]

    @property
    def address(self) -> Address | None:
        """(index, subindex) of the object that it describes."""
        found = _OBJECT.match(self.name)
        return None if found is None else (int(found[1], 16), int(found[2] or "0", 16))

    def get(self, key: str) -> str | None:
        """Value of a key; None where it is not there."""
        return next((line.partition("=")[2].strip() for line in self.lines if _key(line) == key.lower()), None)

    def put(self, key: str, value: str) -> None:
        """Set a key: in its place, else behind the last one."""
        line = f"{key}={value}"
        for number, old in enumerate(self.lines):
            if _key(old) == key.lower():
                self.lines[number] = line
                return
        end = len(self.lines)
        while end and not self.lines[end - 1].strip():
            end -= 1
        self.lines.insert(end, line)

    def drop(self, key: str) -> None:
        """Take a key out."""
        self.lines = [line for line in self.lines if _key(line) != key.lower()]


def _key(line: str) -> str:
    return "" if line.lstrip().startswith(";") else line.partition("=")[0].strip().lower()


def configured(
    text: str, values: Mapping[Address, str], about: Mapping[str, str], commissioning: Sequence[tuple[str, str]]
) -> str:
    """A data sheet with a value at each object.

    Parameters
    ----------
    text : str
        EDS or DCF; values and node of a DCF are replaced.
    values : mapping of (index, subindex) to str
        What becomes `ParameterValue`.
    about : mapping
        What is said in section FileInfo.
    commissioning : sequence of (key, value)
        Section DeviceComissioning, the last of the file: one that was cut short lacks it.
    """
    sections = [part for section in _sections(text) for part in _elements(section, text)]
    kept = [part for part in sections if part.name.lower() != COMMISSIONING.lower()]
    for part in kept:
        part.drop("ParameterValue")
        value = None if part.address is None else values.get(part.address)
        if value is not None:
            part.put("ParameterValue", value)
        if part.name.lower() == "fileinfo":
            for key, said in about.items():
                part.put(key, said)
    lines = [line for part in kept for line in ([f"[{part.name}]"] if part.name else []) + part.lines]
    while lines and not lines[-1].strip():
        lines.pop()
    lines += ["", f"[{COMMISSIONING}]", *(f"{key}={value}" for key, value in commissioning)]
    return "\n".join(lines) + "\n"


def expanded(text: str) -> str:
    """A data sheet in which every element of an array has its section, also where the file has a short form."""
    parts = [part for section in _sections(text) for part in _elements(section, text)]
    return "\n".join(line for part in parts for line in ([f"[{part.name}]"] if part.name else []) + part.lines) + "\n"


def node_of(text: str) -> int | None:
    """Node id in section DeviceComissioning; None where the section or the key is not there."""
    for part in _sections(text):
        if part.name.lower() == COMMISSIONING.lower():
            return _number(part.get("NodeID") or "") or None
    return None


def missing_sections(text: str) -> list[str]:
    """Objects that the lists of a file name, or the number of their elements counts, and that have no section."""
    sections = _sections(expanded(text))
    there = {part.address for part in sections if part.address is not None}
    lacking: list[str] = []
    for part in sections:
        if part.name.lower() in ("mandatoryobjects", "optionalobjects", "manufacturerobjects"):
            for line in part.lines:
                key, value = _key(line), line.partition("=")[2].strip()
                if key.isdigit() and (_number(value), 0) not in there:
                    lacking.append(f"{_number(value):04X}")
        elif part.address is not None and part.address[1] == 0 and part.get("SubNumber") is not None:
            wanted = _number(part.get("SubNumber") or "0")
            elements = sum(_is_element(other, part.address[0]) for other in sections)
            if elements < wanted:
                lacking.append(f"{wanted - elements} elements of {part.address[0]:04X}")
    return lacking


def _is_element(part: _Section, index: int) -> bool:
    found = _OBJECT.match(part.name)
    return found is not None and found[2] is not None and int(found[1], 16) == index


def _number(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        return 0


def _sections(text: str) -> list[_Section]:
    found = [_Section("", [])]
    for line in text.splitlines():
        head = _SECTION.match(line)
        if head is None:
            found[-1].lines.append(line)
        else:
            found.append(_Section(head[1].strip(), []))
    return found


def _elements(section: _Section, text: str) -> list[_Section]:
    """A section; one of an array in short form (CompactSubObj) with a section for each element behind it."""
    compact = section.get("CompactSubObj")
    if section.address is None or not compact or not _number(compact):
        return [section] if _NAMES.match(section.name) is None else []
    index, count = section.address[0], _number(compact)
    names = next((part for part in _sections(text) if part.name.lower() == f"{index:04x}name"), _Section("", []))
    shared = [f"{key}={value}" for key in _SHARED if (value := section.get(key)) is not None]
    head = _Section(section.name, [line for line in section.lines if _key(line) not in map(str.lower, _SHARED)])
    head.drop("CompactSubObj")
    head.put("SubNumber", str(count + 1))
    length = ["ParameterName=Number of entries", "ObjectType=0x7", "DataType=0x0005", "AccessType=ro"]
    parts = [head, _Section(f"{index:04X}sub0", [*length, f"DefaultValue={count}", "PDOMapping=0", ""])]
    for number in range(1, count + 1):
        name = names.get(str(number)) or f"{section.get('ParameterName')}{number}"
        lines = [f"ParameterName={name}", "ObjectType=0x7", *shared, ""]
        parts.append(_Section(f"{index:04X}sub{number:X}", lines))
    return parts
