"""Text logs of any layout: the header is the line that contains the column names of the map.

Detected: separator, lines above the header, decimal mark, encoding with a byte order mark. Ignored: comments, a unit
row below the header, separators at the end of a line. Ambiguous settings are keys of the map.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from gateway.errors import InputError
from gateway.formats.log import Log, number_of, seconds_of
from gateway.formats.log_map import LogFormat

#: Tried in this order where the map names none.
SEPARATORS: Final = (";", "\t", ",", " ")
#: Lines in which the header is looked for, and rows in which the decimal mark is.
_HEADER_WITHIN: Final = 200
_ROWS_LOOKED_AT: Final = 50
#: Rows of units or descriptions below the header.
_MOST_UNITS_ROWS: Final = 2
_COMMENT: Final = re.compile(r"\s*(#|%|//)")
_COMMA_NUMBER: Final = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_GROUPED: Final = {",": re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d+"), ".": re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d+")}
#: One comma and three digits: a decimal comma, or one between thousands.
_EITHER: Final = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_BOMS: Final = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))

#: Lines of a file by their numbers, as cells.
_Rows = list[tuple[int, list[str]]]


def read_text_log(path: Path, form: LogFormat, texts: Collection[str], numbers: Collection[str]) -> Log:
    """Read a text log; cells remain text until they are used.

    Parameters
    ----------
    path : Path
    form : LogFormat
    texts, numbers : collections of str
        Columns that the map needs, as text and as numbers or times: the header is the first line with all of them.

    Raises
    ------
    InputError
        It cannot be read, has no header or no row, a duplicate name, or a row of another length.
    """
    lines = [(number, line) for number, line in enumerate(_lines(path, form), start=1) if number > form.skip_lines]
    lines = [(number, line) for number, line in lines if line.strip(" \t\r\n,;")]
    if not lines:
        raise InputError(f"{path}:1: the file contains no header line; see skip_lines under [log] of the map")
    wanted = {*texts, *numbers}
    separators = (form.separator,) if form.separator else SEPARATORS
    first = next((at for at, (_, line) in enumerate(lines) if not _COMMENT.match(line)), 0)
    found = (separators[0], first, _cells(lines[first][1], separators[0]))
    most = 0
    for at, (_, line) in enumerate(lines[:_HEADER_WITHIN]):
        for text in (line, _COMMENT.sub("", line, count=1)):
            for separator in separators:
                names = _cells(text, separator)
                held = len(wanted & set(names))
                if held > most:
                    found, most = (separator, at, names), held
        if most == len(wanted):
            break
    separator, at, header = found[0], found[1], _without_end(found[2])
    twice = next((name for index, name in enumerate(header) if name and name in header[:index]), None)
    if twice is not None:
        raise InputError(f"{path}:{lines[at][0]}: column '{twice[:40]}' is given twice")
    body = [(number, _cells(line, separator)) for number, line in lines[at + 1 :] if not _COMMENT.match(line)]
    asked = [index for index, name in enumerate(header) if name in numbers]
    units, body = _units_rows(body, asked)
    if not body:
        raise InputError(f"{path}:{lines[at][0]}: the log has a header but no row")
    for index, (number, cells) in enumerate(body):
        if len(cells) != len(header):
            body[index] = number, _of_length(path, number, cells, (len(header), separator))
    decimal, thousands = _marks(path, body, asked, separator, form)
    return Log(
        str(path),
        {
            name: np.array(cells, dtype=object)
            for name, cells in zip(header, zip(*(cells for _, cells in body), strict=True), strict=True)
            if name
        },
        np.array([number for number, _ in body]),
        decimal=decimal,
        thousands=thousands,
        units={
            name: (number, cell)
            for number, cells in units
            for name, cell in zip(header, cells, strict=False)
            if name and cell
        },
        header_line=lines[at][0],
    )


def _lines(path: Path, form: LogFormat) -> Iterator[str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    encoding = next((name for mark, name in _BOMS if data.startswith(mark)), form.encoding)
    if encoding == "utf-8" and b"\0" in data[:200]:  # UTF-16 without a mark: every other byte of Latin text is 0
        encoding = "utf-16-le" if data[1:2] == b"\0" else "utf-16-be"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        what = "UTF-8" if encoding.startswith("utf-8") else encoding.upper()
        other = "latin-1" if encoding.startswith("utf-8") else "utf-8"
        raise InputError(
            f'{path}: not {what} text at byte {error.start}; write encoding = "{other}" under [log] of the map'
        ) from error
    return iter(io.StringIO(text, newline=None))


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _without_end(names: list[str]) -> list[str]:
    """Return the names without empty ones at the end, caused by a trailing separator."""
    while len(names) > 1 and not names[-1]:
        names = names[:-1]
    return names


def _units_rows(body: _Rows, asked: list[int]) -> tuple[_Rows, _Rows]:
    """Separate unit rows below the header, in which no required cell is a number or a time, from the data rows."""
    count = 0
    for _, cells in body[:_MOST_UNITS_ROWS]:
        reported = [cells[index] for index in asked if index < len(cells) and cells[index]]
        if not reported or any(
            re.search(r"\d{2}|^[-+.,]*\d", cell) or cell.lower() in ("nan", "inf") for cell in reported
        ):
            break
        count += 1
    return body[:count], body[count:]


def _of_length(path: Path, number: int, cells: list[str], like: tuple[int, str]) -> list[str]:
    """Return a row without the empty cells after its last column."""
    length, separator = like
    if len(cells) > length and not any(cells[length:]):
        return cells[:length]
    advice = "see separator under [log] of the map"
    if separator == "," and len(cells) > length:
        advice = "is the comma also the decimal mark? Export with another separator, or with decimal points"
    raise InputError(f"{path}:{number}: {len(cells)} cells where the header names {length} columns; {advice}")


def _marks(path: Path, body: _Rows, asked: list[int], separator: str, form: LogFormat) -> tuple[str, str | None]:
    """Return the decimal mark and the thousands separator."""
    if form.decimal is not None or separator == "," or form.thousands is not None:
        return form.decimal or ("," if form.thousands == "." else "."), form.thousands
    looked_at = [(number, cells[index]) for number, cells in body[:_ROWS_LOOKED_AT] for index in asked]
    with_comma = [(number, cells[index]) for number, cells in body for index in asked if "," in cells[index]]
    for decimal, grouped in _GROUPED.items():
        if any(grouped.fullmatch(cell) for _, cell in with_comma):
            return decimal, "." if decimal == "," else ","
    commas = [(number, cell) for number, cell in with_comma if _COMMA_NUMBER.fullmatch(cell)]
    if not commas or any("." in cell and seconds_of(cell) is None for _, cell in looked_at):
        return ".", None
    if all(_EITHER.fullmatch(cell) for _, cell in commas):
        number, cell = commas[0]
        raise InputError(
            f"{path}:{number}: '{cell}' is {number_of(cell, ',')} or {number_of(cell.replace(',', ''), '.'):.0f}: write"
            ' decimal = "," or thousands = "," under [log] of the map'
        )
    return ",", None
