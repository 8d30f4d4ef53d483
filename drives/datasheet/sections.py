"""Text of a data sheet as sections, lines and keys, as their makers write them: any case, indented, repeated."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

Address = tuple[int, int]

#: How CiA 306 spells it, and how it is spelled otherwise.
COMMISSIONING: Final = "DeviceComissioning"
COMMISSIONING_NAMES: Final = frozenset({"devicecomissioning", "devicecommissioning"})
LISTS: Final = frozenset({"mandatoryobjects", "optionalobjects", "manufacturerobjects"})
_LINE_END: Final = re.compile(r"\r\n|\r|\n")
#: White space, the end-of-file character of DOS, zero bytes, byte order marks.
_BLANK: Final = " \t\v\f\x1a\0\xa0\ufeff"
_OBJECT: Final = re.compile(r"(?:0x)?([0-9A-F]{4})(?:sub(?:0x)?([0-9A-F]{1,3}))?", re.IGNORECASE)
_PARTS: Final = re.compile(r"(?:0x)?([0-9A-F]{4})(name|value|denotation)", re.IGNORECASE)
_INLINE_COMMENT: Final = re.compile(r"\s;.*")


@dataclass(slots=True)
class Section:
    """A section and its lines; the name is empty before the first header.

    Attributes
    ----------
    name : str
        As written, without brackets.
    line : int
        Line number of the header.
    lines : list of str
        What follows it.
    closed : bool
        The header ends with a bracket.
    """

    name: str
    line: int
    lines: list[str] = field(default_factory=list[str])
    closed: bool = True

    @property
    def plain_name(self) -> str:
        """Name without white space, in lower case."""
        return "".join(self.name.split()).lower()

    @property
    def address(self) -> Address | None:
        """(index, subindex) of the object that it describes; None = another section."""
        found = _OBJECT.fullmatch(self.plain_name)
        if found is None or int(found[2] or "0", 16) > 0xFF:
            return None
        return int(found[1], 16), int(found[2] or "0", 16)

    @property
    def is_element(self) -> bool:
        """Whether it describes an element of an array or record."""
        return self.address is not None and "sub" in self.plain_name

    @property
    def list_of(self) -> tuple[int, str] | None:
        """Index, and `name`, `value` or `denotation`, of a section with one line per element; None = another one."""
        found = _PARTS.fullmatch(self.plain_name)
        return None if found is None else (int(found[1], 16), found[2].lower())

    def statements(self) -> Iterator[tuple[str, str, int]]:
        """Key in lower case, value and line number of every line; a line without `=` or `:` has an empty key."""
        for number, line in enumerate(self.lines, start=self.line + 1):
            text = line.strip(_BLANK)
            if not text or text[0] in ";#":
                continue
            mark = "=" if "=" in text else ":"
            key, found, value = text.partition(mark)
            plain = key.strip(_BLANK)
            plain = "".join(plain.split()) if found else ""
            yield plain.lower(), _INLINE_COMMENT.sub("", value if found else key).strip(_BLANK), number

    def get(self, key: str) -> str | None:
        """Value of a key; None where it is not there."""
        return next((value for name, value, _ in self.statements() if name == key.lower()), None)

    def put(self, key: str, value: str) -> None:
        """Set a key: in its place, else behind the last line."""
        line = f"{key}={value}"
        for number, old in enumerate(self.lines):
            if _key(old) == key.lower():
                self.lines[number] = line
                return
        end = len(self.lines)
        while end and not self.lines[end - 1].strip(_BLANK):
            end -= 1
        self.lines.insert(end, line)

    def drop(self, *keys: str) -> None:
        """Remove keys."""
        gone = {key.lower() for key in keys}
        self.lines = [line for line in self.lines if _key(line) not in gone]

    def comment_out(self, key: str) -> None:
        """Turn the lines of a key into comments."""
        self.lines = [f";{line.lstrip(_BLANK)}" if _key(line) == key.lower() else line for line in self.lines]


def _key(line: str) -> str:
    text = line.strip(_BLANK)
    if not text or text[0] in ";#":
        return ""
    return "".join(text.partition("=" if "=" in text else ":")[0].split()).lower()


def sections_of(text: str) -> list[Section]:
    """Split a text into sections; lines end at CR and LF alone."""
    found = [Section("", 0)]
    for number, line in enumerate(_LINE_END.split(text), start=1):
        plain = line.strip(_BLANK)
        if plain.startswith("["):
            name, bracket, _ = plain[1:].partition("]")
            found.append(Section(name.strip(_BLANK), number, closed=bool(bracket)))
        else:
            found[-1].lines.append(line)
    return found


def text_of(sections: list[Section]) -> str:
    """Text of sections."""
    lines = [line for part in sections for line in ([f"[{part.name}]"] if part.name else []) + part.lines]
    while lines and not lines[-1].strip(_BLANK):
        lines.pop()
    return "\n".join(lines) + "\n"
