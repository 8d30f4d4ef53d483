"""What was read from another program's log: columns by name, and where each row stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Columns of one log.

    Attributes
    ----------
    file : str
    columns : dict of str to array of shape (n,)
        Floats, or text as it stands there.
    line : int array of shape (n,)
        Line, or number of the message, from 1.
    row_word : str
        Before the number of a row: empty for a line, `message ` for a message.
    decimal : str
        Decimal mark of the text columns.
    """

    file: str
    columns: dict[str, np.ndarray]
    line: np.ndarray
    row_word: str = ""
    decimal: str = "."

    def where(self, row: int) -> str:
        """`file:line` of a row."""
        return f"{self.file}:{self.row_word}{self.line[row]}"

    def take(self, rows: np.ndarray) -> Log:
        """The rows of a mask (n,)."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Log(self.file, columns, self.line[rows], self.row_word, self.decimal)

    def text(self, name: str) -> np.ndarray:
        """A column as it stands there.

        Raises
        ------
        InputError
            It is not in the log.
        """
        if name not in self.columns:
            held = ", ".join(list(self.columns)[:12]) + (" .." if len(self.columns) > 12 else "")
            raise InputError(f"{self.file}:1: column '{name}', which the map names, is missing; the log holds {held}")
        return self.columns[name]

    def numbers(self, name: str) -> np.ndarray:
        """A column of finite numbers (n,).

        Raises
        ------
        InputError
            It is missing, or a cell is empty or no finite number.
        """
        cells = self.text(name)
        values = (
            cells if cells.dtype.kind == "f" else np.array([_number(cell, self.decimal) for cell in cells.tolist()])
        )
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            told = "is empty" if cells[row] == "" else f"'{str(cells[row])[:40]}' is not a finite number"
            raise InputError(
                f"{self.where(row)}: {name}: {told}; nothing is filled in: leave the row out by [rows] of the map"
            )
        return values.astype(float)


def _number(cell: str, decimal: str) -> float:
    text = cell.strip()
    if decimal == ",":
        text = text.replace(",", ".") if "." not in text else "?"
    try:
        return float("nan") if "_" in text else float(text)
    except ValueError:
        return float("nan")
