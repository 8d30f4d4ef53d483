"""Bytes of a data sheet file as text. Makers state no encoding: UTF-8, UTF-16, GBK and Latin-1 occur."""

from __future__ import annotations

import codecs
import re
import stat
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
