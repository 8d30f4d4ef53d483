"""Columns of a log of another program, with the line number of each row."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Final

import numpy as np

from gateway.errors import InputError

_TIME: Final = re.compile(
    r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d\d):(\d\d):(\d\d(?:[.,]\d+)?)\s*(Z|[-+]\d\d:?\d\d)?", re.IGNORECASE
)
#: Characters that stand for a mark between thousands.
_SPELLINGS: Final = {
    " ": ("\N{NO-BREAK SPACE}", "\N{NARROW NO-BREAK SPACE}"),
    "'": ("\N{RIGHT SINGLE QUOTATION MARK}",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Columns of one log.

    Attributes
    ----------
    file : str
    columns : dict of str to array of shape (n,)
        Floats, or text as in the file.
    line : int array of shape (n,)
        Line, or number of the message, from 1.
    row_word : str
        Before the number of a row: empty for a line, `message ` for a message.
    decimal, thousands : str, str or None
        Decimal mark of the text columns, and mark between thousands.
    units : dict of str to (int, str)
        Line and text of the unit row below the header, by column.
    header_line : int
    """

    file: str
    columns: dict[str, np.ndarray]
    line: np.ndarray
    row_word: str = ""
    decimal: str = "."
    thousands: str | None = None
    units: Mapping[str, tuple[int, str]] = field(default_factory=dict[str, tuple[int, str]])
    header_line: int = 1

    def where(self, row: int) -> str:
        """Return `file:line` of a row."""
        return f"{self.file}:{self.row_word}{self.line[row]}"

    def take(self, rows: np.ndarray) -> Log:
        """Return the rows of a mask (n,)."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return replace(self, columns=columns, line=self.line[rows])

    def text(self, name: str) -> np.ndarray:
        """Return a text column as in the file.

        Raises
        ------
        InputError
            It is not in the log.
        """
        if name not in self.columns:
            held = ", ".join(list(self.columns)[:12]) + (" .." if len(self.columns) > 12 else "")
            raise InputError(
                f"{self.file}:{self.header_line}: column '{name}', which the map names, is missing; the log holds"
                f" {held}"
            )
        return self.columns[name]

    def numbers(self, name: str) -> np.ndarray:
        """Return a column of finite numbers (n,).

        Raises
        ------
        InputError
            It is missing, or a cell is empty or not a finite number.
        """
        cells = self.text(name)
        values = (
            cells
            if cells.dtype.kind == "f"
            else np.array([number_of(cell, self.decimal, self.thousands) for cell in cells.tolist()])
        )
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            reported = "is empty" if cells[row] == "" else f"'{str(cells[row])[:40]}' is not a finite number"
            raise InputError(
                f"{self.where(row)}: {name}: {reported}; nothing is filled in: exclude the row with [rows] of the map"
            )
        return values.astype(float)

    def times(self, name: str) -> np.ndarray | None:
        """Return a column of ISO 8601 times, or times of day, in s (n,); None if its first cell is not a time.

        Raises
        ------
        InputError
            It is missing, or another cell is not a time.
        """
        cells = self.text(name)
        if cells.dtype.kind == "f" or not len(cells) or seconds_of(cells[0]) is None:
            return None
        found = [seconds_of(cell) for cell in cells.tolist()]
        if None in found:
            row = found.index(None)
            raise InputError(
                f"{self.where(row)}: {name}: '{str(cells[row])[:40]}' is not a time in the format of the rows above"
            )
        return np.array(found, dtype=float)


def number_of(cell: str, decimal: str, thousands: str | None = None) -> float:
    """Return a cell as a number, NaN if it is not a number."""
    text = cell.strip()
    if thousands is not None:
        for like in _SPELLINGS.get(thousands, ()):
            text = text.replace(like, thousands)
        if thousands in text:
            mark, point = re.escape(thousands), re.escape(decimal)
            if not re.fullmatch(rf"[-+]?\d{{1,3}}({mark}\d{{3}})+({point}\d*)?", text):
                return math.nan
            text = text.replace(thousands, "")
    if decimal == ",":
        text = text.replace(",", ".") if "." not in text else "?"
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def seconds_of(cell: str) -> float | None:
    """Return the seconds of an ISO 8601 time (since 1970, UTC without zone) or of a time of day; None if it is
    neither.
    """
    found = _TIME.fullmatch(cell.strip())
    if found is None:
        return None
    day, hours, minutes, seconds, zone = found.groups()
    try:
        at = datetime.fromisoformat(f"{day or '1970-01-01'}T00:00:00{(zone or 'Z').replace('Z', '+00:00')}")
    except ValueError:
        return None
    return at.timestamp() + 3600 * int(hours) + 60 * int(minutes) + float(seconds.replace(",", "."))
