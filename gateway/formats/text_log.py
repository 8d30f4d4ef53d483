"""Logs as text: a header and rows, whatever stands between the cells (UR's RTDE client, KUKA's trace as CSV)."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from gateway.errors import InputError
from gateway.formats.log import Log
from gateway.formats.log_map import LogFormat


def read_text_log(path: Path, form: LogFormat) -> Log:
    """Read a log as text; cells stay text until they are asked for.

    Raises
    ------
    InputError
        It cannot be read, has no header or no row, a name stands twice, or a row is of another length.
    """
    try:
        with path.open(encoding="utf-8-sig" if form.encoding == "utf-8" else form.encoding, newline="") as stream:
            lines = list(stream)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f'{path}: not UTF-8 text at byte {error.start}; write encoding = "latin-1" under [log] of the map'
        ) from error
    rows = [
        (number, cells)
        for number, line in enumerate(lines, start=1)
        if number > form.skip_lines and (cells := _cells(line, form.separator)) and any(cells)
    ]
    if not rows:
        raise InputError(f"{path}:1: the file holds no header line; see skip_lines under [log] of the map")
    return _log(path, rows, form.decimal)


def _log(path: Path, rows: list[tuple[int, list[str]]], decimal: str) -> Log:
    (at, header), *body = rows
    twice = next((name for index, name in enumerate(header) if name and name in header[:index]), None)
    if twice is not None:
        raise InputError(f"{path}:{at}: column '{twice[:40]}' is given twice")
    if not body:
        raise InputError(f"{path}:{at}: the log has a header but no row")
    for number, cells in body:
        if len(cells) != len(header):
            raise InputError(
                f"{path}:{number}: {len(cells)} cells where the header names {len(header)} columns; see separator under"
                " [log] of the map"
            )
    columns = {
        name: np.array(cells, dtype=object)
        for name, cells in zip(header, zip(*(cells for _, cells in body), strict=True), strict=True)
        if name
    }
    return Log(str(path), columns, np.array([number for number, _ in body]), decimal=decimal)


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
