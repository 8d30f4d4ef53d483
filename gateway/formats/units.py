"""Units of logs by quantity, relative to the units of the measured table."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final

from gateway.data.csv_text import AXIS_OF, COLUMNS, PATTERNS

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
