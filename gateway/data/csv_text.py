"""Read and write the CSV text of measured tables and paths: columns by name, values as numbers.

Every error names file and line. The file is converted in blocks of rows, so that memory use is close to the size of
the numbers.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from gateway.cell.axes import MOST_AXES
from gateway.cell.plausible import LARGEST_ANGLE_RAD
from gateway.errors import InputError

AXES = range(1, MOST_AXES + 1)
BLOCK_ROWS = 2048

#: What a spreadsheet may take for a formula, and what would be read as marked against that.
_FORMULA = re.compile(r"'*[=+\-@]")
TEXT = frozenset({"run", "load"})
#: Columns of our own that rows at rest have and rows of a motion have not, or the other way round.
_OWN_OF_ONE_KIND = ("x_validation", "x_excitation", "x_period", "x_phase_s", "x_motion_hz")
_OF_ONE_KIND = ("qd{}_rad_s", "qdd{}_rad_s2", "tau{}_std_nm", "taum{}_std_nm", "i{}_std_a")
BLANK_ALLOWED = frozenset(
    {"pose", "time_s", *_OWN_OF_ONE_KIND, *(pattern.format(i) for pattern in _OF_ONE_KIND for i in AXES)}
)


@dataclass(frozen=True, slots=True)
class Column:
    """Column of the measured table, or one per axis (`{}` stands for the axis): name, unit, when required, meaning."""

    name: str
    unit: str
    needed: str
    meaning: str


#: Every column that has a meaning, in the order in which it is explained.
COLUMNS = (
    Column("run", "", "no", "recording of the sample; the name of the file if absent"),
    Column("load", "", "no", "label of the load on the flange; `none` = unloaded arm, the default"),
    Column("pose", "", "rest rows", "integer; equal numbers with two loads are the same pose"),
    Column("time_s", "s", "moving rows", "at rest optional: start of the visit"),
    Column("q{}_rad", "rad", "yes", "joint position in the convention of the robot model"),
    Column("qd{}_rad_s", "rad/s", "moving rows", "joint speed; absent: at rest"),
    Column("qdd{}_rad_s2", "rad/s2", "moving rows", "joint acceleration"),
    Column("dir{}", "-1, 0, 1", "no", "sign of the joint's last motion before it came to rest; 0: unknown"),
    Column(
        "tau{}_nm",
        "Nm",
        "one of three",
        "actuator torque on the joint side, positive in the direction of positive q; ratio applied, efficiency"
        " not, nothing subtracted",
    ),
    Column("taum{}_nm", "Nm", "one of three", "torque on the motor side; the cell has ratio, efficiency and sign"),
    Column("i{}_a", "A", "one of three", "motor current; needs `--cell` for torque constant, ratio and sign"),
    Column("tau{}_std_nm", "Nm", "no", "standard deviation of the averaged samples"),
    Column("taum{}_std_nm", "Nm", "no", "standard deviation of `taum{}_nm`"),
    Column("i{}_std_a", "A", "no", "standard deviation of `i{}_a`"),
    Column("n", "", "no", "number of averaged samples"),
    Column("q2nd{}_rad", "rad", "no", "encoder on the link side"),
    Column("temp{}_c", "deg C", "no", "temperature of motor or drive"),
)
#: Columns of our own that say which rows of a motion repeat one another.
PERIOD_COLUMNS = (
    Column("x_excitation", "", "no", "moving samples: number of the motion, equal for equal motion and speed"),
    Column("x_period", "", "no", "number of the period; samples of one instant in two periods differ by noise alone"),
    Column("x_phase_s", "s", "no", "time in the period"),
    Column(
        "x_motion_hz", "Hz", "no", "frequency above which the motion was filtered; an estimate filters the torque too"
    ),
)
PATTERNS = tuple(column.name for column in COLUMNS if "{}" in column.name)
AXIS_OF = {pattern.format(axis): axis for pattern in PATTERNS for axis in AXES}
ANGLES = frozenset(f"{kind}{axis}_rad" for kind in ("q", "q2nd") for axis in AXES)
KNOWN = frozenset({*(column.name for column in COLUMNS if "{}" not in column.name), *AXIS_OF})

#: Lines of a file by their numbers, as cells; empty ones are left out.
Lines = Iterator[tuple[int, list[str]]]


@dataclass(frozen=True, slots=True)
class CsvColumns:
    """Columns of one CSV file.

    Attributes
    ----------
    values : dict of str to array of shape (n_rows,)
        Floats (NaN only where a cell may be left empty) or text.
    line : int array of shape (n_rows,)
        Line of each row in the file, the header is on line 1.
    """

    file: str
    values: dict[str, np.ndarray]
    line: np.ndarray

    @property
    def axes(self) -> int:
        """Number of axes: the highest axis in a column name."""
        return max((AXIS_OF.get(name, 0) for name in self.values), default=0)

    def where(self, row: int) -> str:
        """Return `file:line` of a row."""
        return f"{self.file}:{self.line[row]}"


def read_columns(path: Path) -> CsvColumns:
    """Read the columns of a measured table (UTF-8 with or without byte order mark, comma, quoting, any line end).

    Raises
    ------
    InputError
        File unreadable, header or row malformed, column unknown or given twice, cell that is not a finite number,
        angle that can only be degrees.
    """
    columns = _opened(path, KNOWN)
    for name in sorted(ANGLES & set(columns.values)):
        values = columns.values[name]
        far = np.abs(values) > LARGEST_ANGLE_RAD
        if far.any():
            row = int(np.argmax(far))
            raise InputError(
                f"{columns.where(row)}: {name} = {values[row]:g} is beyond {LARGEST_ANGLE_RAD:.4g} rad: these"
                f" are degrees; write {math.radians(values[row]):.6g}, and every angle of the table in radians"
            )
    return columns


def read_path_columns(path: Path, needed: Sequence[str], optional: Sequence[str] = ()) -> CsvColumns:
    """Read the columns of a path, all numbers; lines that begin with # are comments.

    Raises
    ------
    InputError
        As `read_columns`, or a required column is missing.
    """
    columns = _opened(path, frozenset((*needed, *optional)), remarks=True)
    missing = [name for name in needed if name not in columns.values]
    if missing:
        raise InputError(f"{path}:1: column {missing[0]} is missing; a path needs the columns {', '.join(needed)}")
    return columns


def _opened(path: Path, known: frozenset[str], *, remarks: bool = False) -> CsvColumns:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            try:
                rows = ((reader.line_num, cells) for cells in reader if cells)
                if remarks:
                    rows = ((line, cells) for line, cells in rows if not cells[0].lstrip().startswith("#"))
                return _read(rows, str(path), known)
            except csv.Error as error:
                raise InputError(f"{path}:{reader.line_num}: not valid CSV: {error}") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not UTF-8 text: {error.reason} at byte {error.start}; save the table as UTF-8"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _read(lines: Lines, file: str, known: frozenset[str]) -> CsvColumns:
    header = _header(next((cells for _, cells in lines), None), file, known)
    rows = _rows(lines, header, file)
    kinds: dict[str, str] = {}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in header}
    numbers: list[np.ndarray] = []
    while block := list(islice(rows, BLOCK_ROWS)):
        line = np.array([number for number, _ in block])
        numbers.append(line)
        for name, cells in zip(header, zip(*(cells for _, cells in block), strict=True), strict=True):
            kind = kinds.setdefault(name, _kind(name, cells[0], known | BLANK_ALLOWED))
            parts[name].append(_text(cells) if kind == "text" else _numbers(name, cells, line, file))
    if not numbers:
        raise InputError(f"{file}:1: the table has a header but no row")
    return CsvColumns(file, {name: np.concatenate(part) for name, part in parts.items()}, np.concatenate(numbers))


def _header(cells: list[str] | None, file: str, known: frozenset[str]) -> list[str]:
    if cells is None:
        raise InputError(f"{file}:1: the file is empty; a header line with column names is needed")
    names: list[str] = []
    seen: set[str] = set()
    for name in (cell.strip() for cell in cells):
        if name not in known and not (name.startswith("x_") and name.isprintable()):
            hint = "the separator must be a comma" if ";" in name or "\t" in name else "user columns start with x_"
            raise InputError(f"{file}:1: unknown column '{_short(name)}'; {hint}, units are part of the name")
        if name in seen:
            raise InputError(f"{file}:1: column '{_short(name)}' is given twice")
        seen.add(name)
        names.append(name)
    return names


def _rows(lines: Lines, header: list[str], file: str) -> Lines:
    for line, cells in lines:
        if len(cells) != len(header):
            raise InputError(f"{file}:{line}: {len(cells)} cells where the header names {len(header)} columns")
        yield line, cells


def _kind(name: str, first: str, known: frozenset[str]) -> str:
    """Return whether a column holds text or numbers; for a user column (`x_`) its first cell decides."""
    if name in TEXT:
        return "text"
    return "text" if name not in known and not _is_number(first) else "number"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _text(cells: tuple[str, ...]) -> np.ndarray:
    return np.array([cell[1:] if _FORMULA.match(cell[1:]) and cell[0] == "'" else cell for cell in cells], dtype=object)


def text_cells(texts: Sequence[object]) -> list[object]:
    """Return cells with an apostrophe before those that a spreadsheet would take for a formula; reading removes it."""
    return [f"'{text}" if isinstance(text, str) and _FORMULA.match(text) else text for text in texts]


def _numbers(name: str, cells: tuple[str, ...], line: np.ndarray, file: str) -> np.ndarray:
    try:
        values = np.array([*map(float, cells)])
    except ValueError:
        values = np.array([float(cell) if _is_number(cell) else math.nan for cell in cells])
    bad = ~np.isfinite(values)
    if any("_" in cell for cell in cells):
        bad |= np.array(["_" in cell for cell in cells])
    if name in BLANK_ALLOWED and bad.any():
        bad &= np.array([bool(cell.strip()) for cell in cells])
    if bad.any():
        row = int(np.argmax(bad))
        cell = cells[row].strip()
        what = "is empty" if not cell else f"'{_short(cell)}' is not a finite number"
        raise _unusable(f"{file}:{line[row]}", name, what)
    return values


def _unusable(where: str, name: str, what: str) -> InputError:
    return InputError(f"{where}: {name}: {what}; missing values are not filled in; correct or remove the row")


def empty_cell(where: str, name: str) -> InputError:
    """Return the error for an empty cell in a required column."""
    return _unusable(where, name, "is empty")


def _short(text: str) -> str:
    return ascii(text[:40])[1:-1] + ("..." if len(text) > 40 else "")
