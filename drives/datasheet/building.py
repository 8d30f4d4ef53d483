"""Sections of a data sheet become objects: elements of short forms, defaults of CiA 306, remarks on all the rest."""

from __future__ import annotations

import difflib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

from canopen.objectdictionary import datatypes

from drives.datasheet.object_values import is_ambiguous, is_held, number, plain_number, type_name
from drives.datasheet.sections import COMMISSIONING_NAMES, LISTS, Address, Section, read_text, sections_of, unreadable
from drives.datasheet.sheet import Remark, Sheet, SheetObject
from drives.printable import one_line

#: Largest number of elements of an array (CiA 301: subindex 0xFF is the structure).
MAX_ELEMENTS: Final = 254
#: Bounds of a whole file; drives have up to a few thousand objects.
MAX_LINES: Final = 100_000
MAX_OBJECTS: Final = 10_000
MAX_REMARKS: Final = 1_000
MAX_MISSPELLED: Final = 500

_VAR, _ARRAY, _RECORD, _DOMAIN = 0x7, 0x8, 0x9, 0x2
_NO_OBJECT: Final = {0x0: "NULL", 0x5: "DEFTYPE", 0x6: "DEFSTRUCT"}
#: Below are data types (CiA 301, 7.4.1).
_FIRST_INDEX: Final = 0x1000
_ACCESS: Final = frozenset({"ro", "wo", "rw", "rwr", "rww", "const"})
#: Keys of an object that are used, and those that CiA 306 and common tools write beside them.
_SPELLED: Final = {
    spelled.lower(): spelled
    for spelled in (
        "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "ParameterValue", "LowLimit",
        "HighLimit", "PDOMapping", "SubNumber", "CompactSubObj",
    )
}  # fmt: skip
_USED: Final = tuple(_SPELLED)
_KNOWN: Final = frozenset(
    (*_USED, "unit", "factor", "description", "denotation", "objflags", "uploadfile", "downloadfile", "paramrefd")
)
#: Keys whose first value is taken where they are repeated: they change nothing but a name.
_TEXTS: Final = frozenset({"parametername", "denotation", "unit", "description"})
_INFO: Final = ("vendorname", "vendornumber", "productname", "productnumber", "revisionnumber")
_OTHER_SECTIONS: Final = frozenset(
    {"fileinfo", "deviceinfo", "dummyusage", "comments", "tools", "standarddatatypes", "dynamicchannels"}
    | {"supportedmodules", "eds", "deviceinfo2"}
    | LISTS
    | COMMISSIONING_NAMES
)

#: Key -> value and line number.
Keys = dict[str, tuple[str, int]]


@dataclass(slots=True)
class _Index:
    """Sections of one index."""

    head: Section | None = None
    keys: Keys = field(default_factory=dict[str, tuple[str, int]])
    elements: dict[int, tuple[Section, Keys]] = field(default_factory=dict[int, tuple[Section, Keys]])
    lists: dict[str, tuple[Section, Keys]] = field(default_factory=dict[str, tuple[Section, Keys]])


class _Builder:
    """Collects objects and remarks of one file."""

    def __init__(self) -> None:
        self.remarks: list[Remark] = []
        self.missing: list[str] = []
        self.entries: dict[Address, SheetObject] = {}
        self.objects: dict[int, _Index] = defaultdict(_Index)
        self.info: dict[str, Keys] = {}
        self.unknown: set[str] = set()
        self.is_full = False

    def remark(self, section: Section, line: int, what: str, *, of_value: bool = False) -> None:
        if len(self.remarks) == MAX_REMARKS:
            self.remarks.append(Remark("", 0, f"more than {MAX_REMARKS} lines cannot be used; the rest is not named"))
        if len(self.remarks) < MAX_REMARKS:
            self.remarks.append(Remark(section.name, line, what, of_value))

    # ------------------------------------------------------------------------------------------------------- lines

    def sort(self, sections: list[Section]) -> None:
        """Assign every section to what it describes."""
        for section in sections:
            if not section.closed:
                self.remark(section, section.line, "the header lacks its closing bracket")
            plain, address, part = section.plain_name, section.address, section.list_of
            if address is not None:
                self._sort_object(section, address)
            elif part is not None:
                lists = self.objects[part[0]].lists
                owner, keys = lists.setdefault(part[1], (section, {}))
                self._again(section, owner)
                self._collect(section, keys)
            elif plain in _OTHER_SECTIONS:
                name = "commissioning" if plain in COMMISSIONING_NAMES else plain
                if plain != "comments":
                    self._collect(section, self.info.setdefault(name, {}))
            elif plain:
                self.remark(section, section.line, "unknown section, not used")
            else:
                self._collect(section, {})

    def _again(self, section: Section, owner: Section | None) -> None:
        if owner is not None and owner is not section:
            self.remark(section, section.line, f"a section of this name is in line {owner.line} already: both are read")

    def _sort_object(self, section: Section, address: Address) -> None:
        found = self.objects[address[0]]
        if section.is_element:
            owner, keys = found.elements.setdefault(address[1], (section, {}))
        else:
            owner, keys = found.head or section, found.keys
            found.head = owner
        self._again(section, owner)
        self._collect(section, keys)
        for key in keys:
            if key not in _KNOWN and len(self.unknown) < MAX_MISSPELLED:
                self.unknown.add(key)
                near = _near(key)
                if near:
                    self.remark(
                        section, keys[key][1], f"key {key} is unknown, not used ({_spelled(near)} is misspelled?)"
                    )

    def _collect(self, section: Section, keys: Keys) -> None:
        conflicting: set[str] = set()
        for key, value, line in section.statements():
            if not key:
                self.remark(section, line, f"'{value[:40]}' is not KEY=VALUE, not used")
            elif key not in keys:
                keys[key] = (value, line)
            elif not _is_same(keys[key][0], value):
                first, first_line = keys[key]
                if not first or not value:
                    keys[key] = (first or value, first_line if first else line)
                    continue
                taken = "the first is used" if key in _TEXTS else "neither is used"
                what = f"{_spelled(key)} is '{first[:40]}' in line {first_line} and '{value[:40]}' here: {taken}"
                self.remark(section, line, what, of_value=key == "parametervalue")
                if key not in _TEXTS:
                    conflicting.add(key)
        for key in conflicting:
            del keys[key]

    # ------------------------------------------------------------------------------------------------------ numbers

    def number(self, section: Section, keys: Keys, key: str, default: int | None = None) -> int | None:
        """Number of a key; the default where it is missing, empty or no number."""
        text, line = keys.get(key, ("", 0))
        if not text:
            return default
        try:
            value = plain_number(text)
        except ValueError:
            self.remark(section, line, f"{_spelled(key)} '{text[:40]}' is not a number, not used")
            return default
        self._ambiguous(section, line, key, text)
        return value

    def _ambiguous(self, section: Section, line: int, key: str, text: str) -> None:
        if is_ambiguous(text):
            self.remark(section, line, f"{_spelled(key)} '{text}' is read as the decimal number {int(text)}")

    # ------------------------------------------------------------------------------------------------------ objects

    def build(self) -> None:
        """Make objects of all sections."""
        for index, found in self.objects.items():
            if index >= _FIRST_INDEX and not self.is_full:
                self._build(index, found)

    def _build(self, index: int, found: _Index) -> None:
        head = found.head
        if head is None:
            sections = [section for section, _ in (*found.elements.values(), *found.lists.values())]
            self.remark(sections[0], sections[0].line, f"there is no section [{index:04X}] for this element")
            kind = _RECORD
        else:
            kind = self.number(head, found.keys, "objecttype", _RECORD if found.elements else _VAR)
            if kind in _NO_OBJECT:
                what = f"ObjectType is {_NO_OBJECT[kind]}: [{index:04X}] is not an object and is left out"
                self.remark(head, head.line, what)
                return
        for sub, (section, keys) in sorted(found.elements.items()):
            self._add(self._object(index, sub, section, keys))
        compact = self._elements_of_short_form(index, found, kind)
        if head is not None and not found.elements and not compact:
            self._lone(index, head, found.keys, kind)
        self._count(index, found, compact)
        self._values(index, found)

    def _add(self, entry: SheetObject | None) -> None:
        if entry is None:
            return
        if len(self.entries) < MAX_OBJECTS:
            self.entries[entry.index, entry.subindex] = entry
        elif not self.is_full:
            self.is_full = True
            self.remarks.append(Remark("", 0, f"more than {MAX_OBJECTS} objects: the rest is left out"))

    def _lone(self, index: int, head: Section, keys: Keys, kind: int | None) -> None:
        if kind in (_ARRAY, _RECORD):
            self.remark(head, head.line, f"array or record [{index:04X}] without elements, left out")
        else:
            if kind not in (_VAR, _DOMAIN):
                self.remark(head, head.line, f"ObjectType 0x{kind or 0:X} is unknown: read as a single variable")
            self._add(self._object(index, 0, head, keys, domain=kind == _DOMAIN))

    def _elements_of_short_form(self, index: int, found: _Index, kind: int | None) -> int:
        """Add the elements that CompactSubObj stands for (CiA 306, 4.5.2.4); their number."""
        head, keys = found.head, found.keys
        if head is None:
            return 0
        count = self.number(head, keys, "compactsubobj", 0) or 0
        if count <= 0:
            return 0
        if count > MAX_ELEMENTS:
            what = f"CompactSubObj={count}: an array has at most {MAX_ELEMENTS} elements, the rest is left out"
            self.remark(head, keys["compactsubobj"][1], what)
            count = MAX_ELEMENTS
        if kind == _VAR:
            self.remark(head, head.line, "ObjectType is not an array, and CompactSubObj states elements: read as array")
        own = {key: stated for key, stated in keys.items() if key != "parametervalue"}
        pattern = self._object(index, 1, head, own)
        if pattern is None:
            return count
        _, names = found.lists.get("name", (head, {}))
        if (index, 0) not in self.entries:
            self._add(SheetObject(index, 0, "Number of entries", datatypes.UNSIGNED8, "ro", default=str(count)))
        for sub in range(1, count + 1):
            if (index, sub) not in self.entries:
                name = one_line(element_name(names, sub)) or f"{pattern.name}{sub}"
                self._add(replace(pattern, subindex=sub, name=name))
        return count

    def _object(
        self, index: int, sub: int, section: Section, keys: Keys, *, domain: bool = False
    ) -> SheetObject | None:
        """One object; None where its type is not stated."""
        data_type = self.number(section, keys, "datatype", datatypes.DOMAIN if domain else None)
        if data_type is None or not 0 < data_type < _FIRST_INDEX:
            stated = keys.get("datatype", ("", section.line))
            what = f"DataType '{stated[0][:40]}' is not a type" if stated[0] else "DataType is missing"
            self.remark(section, stated[1], f"{what}: object {index:04X}:{sub:02X} is left out")
            return None
        access = keys.get("accesstype", ("", section.line))
        word = "".join(access[0].lower().split())
        if word not in _ACCESS:
            what = f"AccessType '{access[0][:40]}' is unknown" if word else "AccessType is missing"
            self.remark(section, access[1], f"{what}: object {index:04X}:{sub:02X} counts as read only")
            word = "ro"
        mappable = self.number(section, keys, "pdomapping", 0)
        if keys.get("pdomapping", ("0", 0))[0] == "":
            self.remark(section, keys["pdomapping"][1], "PDOMapping is empty: read as 0, not for PDOs")
        if mappable not in (0, 1):
            self.remark(section, keys["pdomapping"][1], f"PDOMapping {mappable} is neither 0 nor 1: read as 1")
        entry = SheetObject(
            index,
            sub,
            one_line(keys.get("parametername", ("", 0))[0]),
            data_type,
            word,
            bool(mappable),
            one_line(keys.get("unit", ("", 0))[0]),
            line=section.line,
        )
        return self._with_values(entry, section, keys)

    def _with_values(self, entry: SheetObject, section: Section, keys: Keys) -> SheetObject:
        """The object with the texts of its values that fit its type; a stored value stays as it is written."""
        kept: dict[str, str] = {}
        for attribute, key in (
            ("default", "defaultvalue"),
            ("low", "lowlimit"),
            ("high", "highlimit"),
            ("value", "parametervalue"),
        ):
            text, line = keys.get(key, ("", 0))
            if not text:
                continue
            if self._fits(entry, section, (key, text, line)) or attribute == "value":
                kept[attribute] = text
        return replace(entry, **kept) if kept else entry

    def _fits(self, entry: SheetObject, section: Section, stated: tuple[str, str, int]) -> bool:
        key, text, line = stated
        if not is_held(entry.data_type):
            if key == "parametervalue":
                self.remark(section, line, f"values of type {type_name(entry.data_type)} are not compared")
            return True
        try:
            entry.read(text, 1)
        except ValueError:
            what = f"{_spelled(key)} '{text[:40]}' is not a value of type {type_name(entry.data_type)}, not used"
            self.remark(section, line, what)
            return False
        if type_name(entry.data_type)[0] in "iu":
            self._ambiguous(section, line, key, text)
        return True

    def _values(self, index: int, found: _Index) -> None:
        """Values of a DCF that are listed in a section of their own (CiA 306: `[1003Value]`)."""
        if "value" not in found.lists:
            return
        section, keys = found.lists["value"]
        for key, (text, line) in keys.items():
            if key == "nrofentries" or not text:
                continue
            sub = _sub_of(key)
            entry = None if sub is None else self.entries.get((index, sub))
            if entry is None:
                self.remark(section, line, f"there is no object {index:04X}:{key} for this value")
            elif entry.value and not _is_same(entry.value, text):
                what = f"{index:04X}:{key} has the value '{entry.value[:40]}' in its own section, which is used"
                self.remark(section, line, what, of_value=True)
            else:
                self._fits(entry, section, ("parametervalue", text, line))
                self.entries[index, entry.subindex] = replace(entry, value=text)

    def _count(self, index: int, found: _Index, compact: int) -> None:
        """Compare the stated number of elements with those that are there."""
        if found.head is None or compact:
            return
        stated = self.number(found.head, found.keys, "subnumber", 0) or 0
        lacking = stated - len(found.elements)
        if lacking > 0:
            self.missing.append(f"{lacking} elements of {index:04X}")
            line = found.keys["subnumber"][1]
            self.remark(found.head, line, f"{lacking} of {stated} elements of {index:04X} have no section")
        length = self.entries.get((index, 0))
        if length is None or not found.elements or length.access_type not in ("ro", "const") or not length.default:
            return
        highest, most = max(found.elements), plain_number(length.default)
        if highest > most and any(sub not in found.elements for sub in range(1, min(most, MAX_ELEMENTS) + 1)):
            section = found.elements[highest][0]
            what = f"element {highest} is beyond the {most} that {index:04X}:00 states, and one of those is missing"
            self.remark(section, section.line, what)

    def listed(self, sections: list[Section]) -> None:
        """Compare the lists of objects with the sections that are there."""
        known: set[int] = set()
        for section in sections:
            if section.plain_name not in LISTS:
                continue
            for key, value, line in section.statements():
                if not key.isdigit() or not value:
                    continue
                try:
                    index = plain_number(value)
                except ValueError:
                    self.remark(section, line, f"'{value[:40]}' is not an index, not used")
                    continue
                known.add(index)
                if index not in self.objects or self.objects[index].head is None:
                    self.missing.append(f"{index:04X}")
                    self.remark(section, line, f"object {index:04X} is listed and has no section")
        for index, found in self.objects.items() if self.missing and known else ():
            if index not in known and found.head is not None:
                what = f"object {index:04X} is in no list, and a listed one is missing"
                self.remark(found.head, found.head.line, what)


def read_sheet(path: Path) -> Sheet:
    """Read an EDS or DCF.

    Raises
    ------
    ProfileError
        The file cannot be read, or contains no object.
    """
    return sheet_of_text(read_text(path), path)


def sheet_of_text(text: str, path: Path) -> Sheet:
    """Build a data sheet from its text.

    Raises
    ------
    ProfileError
        It contains no object.
    """
    if max(text.count("\n"), text.count("\r")) > MAX_LINES:
        raise unreadable(path, f"it has more than {MAX_LINES} lines, more than any data sheet")
    builder, sections = _Builder(), sections_of(text)
    builder.sort(sections)
    builder.build()
    builder.listed(sections)
    if not builder.entries:
        xml = "an XML file (XDD), no EDS" if text.lstrip().startswith("<") else "a file without objects, no data sheet"
        first = next((f"; {remark}" for remark in builder.remarks), "")
        raise unreadable(path, f"it is {xml}{first}")
    info = builder.info
    section = next((each for each in sections if each.plain_name == "deviceinfo"), Section("DeviceInfo", 0))
    device = info.get("deviceinfo", {})
    for key in list(device)[:MAX_MISSPELLED]:
        near = "" if key in _INFO else _near(key, _INFO)
        if near:
            builder.remark(section, device[key][1], f"key {key} is unknown, not used ({near} is misspelled?)")
    numbers = [builder.number(section, device, f"{what}number") for what in ("vendor", "product", "revision")]
    node_id = _node_id(builder, sections)
    sheet = Sheet(
        path.name,
        one_line(device.get("vendorname", ("", 0))[0]),
        one_line(device.get("productname", ("", 0))[0]),
        None,
        None,
        None,
        builder.entries,
        tuple(sorted(builder.remarks, key=lambda remark: remark.line)),
        tuple(builder.missing),
        node_id,
        info.get("fileinfo", {}).get("modifiedby", ("", 0))[0],
    )
    return replace(
        sheet,
        vendor_id=sheet.value_of(0x1018, 1) or numbers[0] or None,
        product_code=sheet.value_of(0x1018, 2) or numbers[1] or None,
        revision=sheet.value_of(0x1018, 3) or numbers[2] or None,
    )


def _node_id(builder: _Builder, sections: list[Section]) -> int | None:
    section = next((each for each in sections if each.plain_name in COMMISSIONING_NAMES), None)
    if section is None:
        return None
    keys = builder.info["commissioning"]
    node_id = builder.number(section, keys, "nodeid")
    if node_id is not None and not 1 <= node_id <= 127:
        builder.remark(section, keys["nodeid"][1], f"NodeID {node_id} is not 1 to 127, not used")
        return None
    return node_id


def _is_same(first: str, second: str) -> bool:
    """Whether two texts state the same: without case, or as numbers."""
    if first.lower() == second.lower():
        return True
    try:
        return number(first) == number(second)
    except ValueError:
        return False


def element_name(listed: Mapping[str, tuple[str, int]], sub: int) -> str:
    """Name that a section of names (CiA 306: `[1003Name]`) gives an element; keys are decimal or hexadecimal."""
    return next((listed[key][0] for key in (str(sub), f"0x{sub:x}", f"0x{sub:02x}") if key in listed), "")


def _sub_of(key: str) -> int | None:
    try:
        return plain_number(key)
    except ValueError:
        return None


def _spelled(key: str) -> str:
    """A key as CiA 306 spells it."""
    return _SPELLED.get(key, key)


@lru_cache(maxsize=4096)
def _near(key: str, known: tuple[str, ...] = _USED) -> str:
    """A known key that one is perhaps meant to be."""
    return next(iter(difflib.get_close_matches(key, known, 1, 0.7)), "")
