"""Map of a log: assigns its columns to those of the measured table, with a sign and one of the units listed here."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from drives.toml_lines import KeyPath
from drives.validation import Refused, Strict, Unfit, read_strict, refuse
from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.cell.quantities import Finite, Positive
from gateway.data.csv_text import AXIS_OF, COLUMNS, PATTERNS
from gateway.data.labels import BARE_LABEL, label_refused
from gateway.errors import ConfigError

Name = Annotated[str, Field(min_length=1, max_length=200)]
Numbers = Finite | tuple[Finite, ...]
Signs = Literal[-1, 1] | tuple[Literal[-1, 1], ...]
#: What a gear stands before.
_BEHIND_A_GEAR = ("angle", "speed", "acceleration")


class LogFormat(Strict):
    """Text format of the log."""

    separator: Literal[",", ";", " ", "\t"] | None = Field(
        default=None,
        description="of a text log; a blank: one or more blanks; detected from the column names if omitted",
    )
    decimal: Literal[".", ","] | None = Field(default=None, description="of a text log; detected if omitted")
    thousands: Literal[",", ".", " ", "'"] | None = Field(default=None, description="mark between thousands")
    encoding: Literal["utf-8", "latin-1", "utf-16"] = Field(
        default="utf-8", description="of a text log without a byte order mark"
    )
    skip_lines: int = Field(default=0, ge=0, le=1000, description="lines of a text log above its header")
    topic: Name = Field(default="/joint_states", description="of a bag: JointState messages")


class LogTime(Strict):
    """Time column of the log."""

    column: Name = Field(default="stamp", description="column of a text log; `stamp` or `log_time` of a bag")
    unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="unit of that column")
    base: Literal["first", "as logged"] = Field(
        default="first", description="whether the first row of the log is time zero"
    )


class LogLoad(Strict):
    """Load on the flange."""

    label: str | None = Field(default=None, description="of all rows")
    column: Name | None = Field(default=None, description="column of a text log with the label")

    @model_validator(mode="after")
    def _one_of_them(self) -> LogLoad:
        if (self.label is None) == (self.column is None):
            raise ValueError("load: give label, or column")
        if self.label is not None and (wrong := label_refused(self.label)):
            raise Refused((("label",), f"load '{self.label}' {wrong}"))
        return self


class LogRows(Strict):
    """Selection of rows."""

    from_s: Finite | None = Field(default=None, description="time of the first row to keep")
    to_s: Finite | None = Field(default=None, description="time of the last row to keep")
    every: int = Field(default=1, ge=1, description="of a motion: keep every n-th row")
    column: Name | None = Field(default=None, description="column that selects the rows to keep")
    equals: tuple[Finite, ...] = Field(default=(), description="values of that column to keep")

    @model_validator(mode="after")
    def _both_or_none(self) -> LogRows:
        if (self.column is None) == bool(self.equals):
            raise ValueError("rows: give both column and equals, or neither")
        return self


class LogColumn(Strict):
    """Column of the log, or one per axis: `{}` stands for the joint's name or number."""

    log: Name = Field(description="in the log; `position/{}`, `velocity/{}`, `effort/{}` of a bag")
    table: Name = Field(description="in the measured table: q{}_rad, qd{}_rad_s, tau{}_nm, taum{}_nm, i{}_a ..")
    unit: Name = Field(description="of the log's column; 1 of a bare number")
    sign: Signs = Field(default=1, description="1 or -1, or one per axis")
    offset: Numbers = Field(default=0.0, description="added last, in the table's unit; or one per axis")
    gear_ratio: Numbers | None = Field(default=None, description="the log has motor angles: divided by this ratio")
    counts_per_revolution: Positive | tuple[Positive, ...] | None = Field(default=None, description="of unit counts")
    rated: Positive | tuple[Positive, ...] | None = Field(default=None, description="of unit % and permille: Nm or A")
    first: Literal[0, 1] = Field(default=1, description="number of the first axis in the log")
    optional: bool = Field(default=False, description="omitted if the log does not contain it")

    @model_validator(mode="after")
    def _fits(self) -> LogColumn:
        found: list[tuple[KeyPath, str]] = []
        kind = kind_of(self.table)
        if kind is None:
            known = ", ".join(KIND_OF)
            raise Refused(
                (("table",), f"'{self.table}' is not a column of the measured table; write one of {known}, x_..")
            )
        if self.unit not in UNITS[kind]:
            known = ", ".join(UNITS[kind])
            found.append((("unit",), f"unit '{self.unit}' is not one of {kind}: write {known}"))
        for key in ("counts_per_revolution", "rated"):
            if (NEEDS.get(self.unit) == key) != (getattr(self, key) is not None):
                found.append(
                    (("unit",), f"unit '{self.unit}' and {key} cannot be combined: give the key with its own unit only")
                )
        if self.gear_ratio is not None and (kind not in _BEHIND_A_GEAR or not np.all(self.gear_ratio)):
            found.append((("gear_ratio",), "gear_ratio applies to angles, speeds and accelerations, and must not be 0"))
        if ("{}" in self.log) != ("{}" in self.table):
            found.append((("log",), "'{}', which stands for the axis, must be in both log and table, or in neither"))
        refuse(found)
        return self


class LogMotion(Strict):
    """Moving log: speeds and accelerations missing in the log are computed from its positions."""

    cutoff_hz: Positive = Field(description="cutoff of the zero-phase low pass on the positions (half power)")


class LogRest(Strict):
    """Log of rest poses: one row per rest interval, the mean over it."""

    within_rad: Positive = Field(default=0.001, description="largest motion of a joint within a rest interval")
    seconds: Positive = Field(default=0.5, description="shortest rest interval")
    settle_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        default=0.1, description="omitted at the beginning and at the end of each rest interval"
    )
    same_pose_rad: Positive = Field(default=0.02, description="largest joint difference within one pose")
    first_pose: int = Field(default=1, ge=1, description="number of the first pose")


class LogMap(Strict):
    """Conversion of the columns of a log to a measured table."""

    axes: int = Field(ge=FEWEST_AXES, le=MOST_AXES, description="of the arm")
    joints: tuple[Name, ...] | None = Field(default=None, description="names of the joints in the log, in order")
    log: LogFormat = Field(default_factory=LogFormat, description="how the log is written")
    time: LogTime = Field(default_factory=LogTime, description="the log's time")
    load: LogLoad = Field(default_factory=lambda: LogLoad(label=BARE_LABEL), description="what was on the flange")
    rows: LogRows = Field(default_factory=LogRows, description="which rows are kept")
    motion: LogMotion | None = Field(default=None, description="the arm moves")
    rest: LogRest | None = Field(default=None, description="the arm is at rest at poses")
    column: tuple[LogColumn, ...] = Field(min_length=1, description="which column is which")

    @model_validator(mode="after")
    def _complete(self) -> LogMap:
        found = list(self._lengths())
        tables = [column.table for column in self.column]
        for index, name in enumerate(tables):
            if name in tables[:index]:
                found.append((("column", index, "table"), f"{name} is given twice"))
        if "q{}_rad" not in tables:
            found.append((("column",), "no column becomes q{}_rad: a table needs the positions of all axes"))
        if not {"tau{}_nm", "taum{}_nm", "i{}_a"} & set(map(pattern_of, tables)):
            found.append((("column",), "no column becomes tau{}_nm, taum{}_nm or i{}_a: a table needs one of them"))
        if (self.rest is not None) + (self.motion is not None) + ("pose" in tables) > 1:
            found.append(
                (("rest",) if self.rest else ("motion",), "give one of [motion], [rest] and a column for pose")
            )
        moving = {"qd{}_rad_s", "qdd{}_rad_s2"} <= set(tables)
        if self.rest is None and self.motion is None and "pose" not in tables and not moving:
            found.append(
                (
                    (),
                    "state the motion: [rest], or [motion] cutoff_hz, or columns for qd{}_rad_s and qdd{}_rad_s2",
                )
            )
        refuse(found)
        return self

    def _lengths(self) -> list[tuple[KeyPath, str]]:
        found: list[tuple[KeyPath, str]] = []
        if self.joints is not None and len(self.joints) != self.axes:
            found.append((("joints",), f"{len(self.joints)} joints of {self.axes} axes"))
        for index, column in enumerate(self.column):
            for key in ("sign", "offset", "gear_ratio", "counts_per_revolution", "rated"):
                value = getattr(column, key)
                if isinstance(value, tuple) and (len(value) != self.axes or "{}" not in column.table):
                    found.append((("column", index, key), f"{key}: {len(value)} values for {self.axes} axes"))
        return found

    def needed(self) -> tuple[set[str], set[str]]:
        """Return the columns that a log must contain: those read as text, and those read as numbers or times."""
        texts = {name for name in (self.load.column,) if name is not None}
        numbers = {name for name in (self.time.column, self.rows.column) if name is not None}
        for column in self.column:
            if not column.optional:
                numbers |= {source for source, _, _ in self.names(column)}
        return texts, numbers

    def names(self, column: LogColumn) -> list[tuple[str, str, int]]:
        """Return name in the log, name in the table, and axis from 0 of each column of a rule."""
        if "{}" not in column.table:
            return [(column.log, column.table, 0)]
        called = self.joints or tuple(str(axis + column.first) for axis in range(self.axes))
        return [
            (column.log.replace("{}", name), column.table.replace("{}", str(axis + 1)), axis)
            for axis, name in enumerate(called)
        ]


def ready_maps() -> dict[str, Any]:
    """Return the maps included in the package, by name."""
    return {Path(file.name).stem: file for file in files("gateway.formats").joinpath("maps").iterdir()}


def read_map(path: Path, changes: Mapping[str, Any] | None = None) -> LogMap:
    """Read a map from a file, or an included one by name.

    Parameters
    ----------
    path : Path
    changes : mapping of str to value, optional
        Tables or values that replace those of the file.

    Raises
    ------
    ConfigError
        With every problem of the file: line, what is wrong, what to write.
    """
    ready = ready_maps()
    try:
        source = path if path.exists() or str(path) not in ready else ready[str(path)]
        found = read_strict(source.read_text(encoding="utf-8"), LogMap)
        return LogMap.model_validate({**found.model_dump(exclude_unset=True), **changes}) if changes else found
    except FileNotFoundError as error:
        known = ", ".join(sorted(ready))
        raise ConfigError(f"{path}: cannot be read: there is no such file, and no ready map ({known})") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    except Unfit as error:
        raise ConfigError.of(error.messages(str(path))) from error


#: Units that need a number of the drive beside them, and the key that gives it.
NEEDS: Final = {
    "counts": "counts_per_revolution",
    "counts/s": "counts_per_revolution",
    "%": "rated",
    "permille": "rated",
}
_TURN: Final = 2 * math.pi
#: What is measured -> unit -> (factor, shift): table value = factor x log value + shift.
UNITS: Final[Mapping[str, Mapping[str, tuple[float, float]]]] = {
    "angle": {
        "rad": (1.0, 0.0),
        "mrad": (1e-3, 0.0),
        "deg": (math.pi / 180, 0.0),
        "rev": (_TURN, 0.0),
        "counts": (_TURN, 0.0),
    },
    "speed": {
        "rad/s": (1.0, 0.0),
        "deg/s": (math.pi / 180, 0.0),
        "rpm": (_TURN / 60, 0.0),
        "rev/s": (_TURN, 0.0),
        "counts/s": (_TURN, 0.0),
    },
    "acceleration": {"rad/s2": (1.0, 0.0), "deg/s2": (math.pi / 180, 0.0)},
    "torque": {"Nm": (1.0, 0.0), "mNm": (1e-3, 0.0), "kNm": (1e3, 0.0), "%": (0.01, 0.0), "permille": (1e-3, 0.0)},
    "current": {"A": (1.0, 0.0), "mA": (1e-3, 0.0), "%": (0.01, 0.0), "permille": (1e-3, 0.0)},
    "temperature": {"C": (1.0, 0.0), "K": (1.0, -273.15), "F": (5 / 9, -160 / 9)},
    "number": {"1": (1.0, 0.0)},
}


def factors(kind: str, *units: str) -> dict[str, float]:
    """Return the factors to SI of some units of one quantity."""
    return {unit: UNITS[kind][unit][0] for unit in units}


TIME_UNITS: Final[Mapping[str, float]] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_KIND_OF_UNIT: Final = {
    "rad": "angle",
    "rad/s": "speed",
    "rad/s2": "acceleration",
    "Nm": "torque",
    "A": "current",
    "deg C": "temperature",
}
#: Column of the measured table, `{}` for the axis -> what it measures.
KIND_OF: Final[Mapping[str, str]] = {
    column.name: _KIND_OF_UNIT.get(column.unit, "number")
    for column in COLUMNS
    if column.name not in ("run", "load", "time_s")
}


def pattern_of(column: str) -> str:
    """Return the column pattern of a name: `tau2_nm` becomes `tau{}_nm`; other names are unchanged."""
    axis = AXIS_OF.get(column)
    return column if axis is None else next(each for each in PATTERNS if each.format(axis) == column)


def kind_of(column: str) -> str | None:
    """Return the quantity of a table column; None if a log cannot provide that column."""
    return "number" if column.startswith("x_") else KIND_OF.get(pattern_of(column))


#: Spellings of units in logs, lower case and without blanks.
_SPELLED: Final = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "\N{DEGREE SIGN}": "deg",
    "radian": "rad", "radians": "rad",
    "\N{DEGREE SIGN}/s": "deg/s", "degrees/s": "deg/s", "radians/s": "rad/s", "1/min": "rpm", "u/min": "rpm",
    "rad/s^2": "rad/s2", "deg/s^2": "deg/s2", "\N{DEGREE SIGN}/s^2": "deg/s2",
    "n*m": "Nm", "n\N{MIDDLE DOT}m": "Nm", "n.m": "Nm", "amp": "A", "amps": "A", "ampere": "A", "amperes": "A",
    "percent": "%", "\N{PER MILLE SIGN}": "permille", "0.1%": "permille", "sec": "s", "second": "s", "seconds": "s",
    "\N{MICRO SIGN}s": "us", "\N{GREEK SMALL LETTER MU}s": "us", "msec": "ms", "milliseconds": "ms",
    "\N{DEGREE SIGN}c": "C", "degc": "C",
}  # fmt: skip
_BY_LOWER: Final = {
    unit.lower(): unit for unit in (*(unit for units in UNITS.values() for unit in units), *TIME_UNITS) if unit != "1"
}


def unit_named(text: str) -> str | None:
    """Return the unit that a text in a log names; None if unknown."""
    plain = re.sub(r"[\s\[\]()]", "", text)
    if len(plain) == 1 and plain not in ("%", "\N{DEGREE SIGN}"):
        return plain if plain in (*_BY_LOWER.values(),) else None
    if plain in ("mNm", "kNm", "mA"):  # a capital would be another prefix
        return plain
    return _SPELLED.get(plain.lower()) or (_BY_LOWER.get(plain.lower()) if plain.lower() not in ("mnm", "ma") else None)
