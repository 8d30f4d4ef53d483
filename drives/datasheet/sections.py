"""Text of a data sheet as sections, lines and keys, as their makers write them: any case, indented, repeated.

Makers state no encoding: UTF-8, UTF-16, GBK and Latin-1 occur.
"""

from __future__ import annotations

import codecs
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from drives.errors import ProfileError

#: No data sheet of a drive comes near this; a larger file is refused before it is read.
MAX_BYTES: Final = 4_000_000
_BOMS: Final = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_HIGH_RUN: Final = re.compile(rb"[\x80-\xff]+")
#: Share of zero bytes at even or odd places from which a text without a mark is UTF-16.
_UTF16_SHARE: Final = 0.3


def read_text(path: Path) -> str:
    """Read the text of an EDS or DCF.

    Raises
    ------
    ProfileError
        The file cannot be read, is not a regular file, is empty or larger than `MAX_BYTES`.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise unreadable(path, "it is not a regular file")
        with path.open("rb") as file:  # a read reserves as much memory as it may return
            content = file.read(min(found.st_size, MAX_BYTES) + 1)
    except OSError as error:
        raise unreadable(path, str(error)) from error
    if len(content) > MAX_BYTES:
        raise unreadable(path, f"it is larger than {MAX_BYTES // 1_000_000} MB, larger than any data sheet")
    text = decoded_text(content)
    if not text.strip(" \t\r\n\x1a\0"):
        raise unreadable(path, "it is empty, no data sheet")
    return text


def unreadable(path: Path, reason: str) -> ProfileError:
    """Error about a file that is not a data sheet."""
    advice = "give an EDS or DCF (CiA 306) as the maker of the drive delivers it"
    return ProfileError(f"data sheet {path} cannot be read: {reason}", advice=advice)


def decoded_text(content: bytes) -> str:
    """Decode the bytes of a data sheet; every byte sequence has a text."""
    for mark, name in _BOMS:
        if content.startswith(mark):
            return content[len(mark) :].decode(name, errors="replace")
    for name, zeros in (("utf-16-le", content[1::2]), ("utf-16-be", content[0::2])):
        if zeros.count(0) > _UTF16_SHARE * len(content):
            return content.decode(name, errors="replace")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("gbk" if _is_gbk(content) else "latin-1")


def _is_gbk(content: bytes) -> bool:
    """Whether bytes above 0x7F come in pairs that GBK assigns; accented letters of Latin-1 mostly come alone."""
    if any(len(run[0]) % 2 for run in _HIGH_RUN.finditer(content)):
        return False
    try:
        content.decode("gbk")
    except UnicodeDecodeError:
        return False
    return True


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
