"""Formats of answers: typed text or value of an answer file, for all axes or for each."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from typing import Any, Final, cast

from drives.draft.questions import Form
from drives.toml_text import parse_toml
from gateway.formats.log_map import factors

#: Keys of a constant with its source in an answer file.
VALUE, SOURCE = "value", "source"


def with_source(reply: Any, form: Form) -> tuple[Any, str]:
    """Return value and source of a reply, typed or of an answer file: `101; plate`, or a table of both."""
    value = typed(reply) if isinstance(reply, str) else reply
    source = ""
    if isinstance(value, dict) and set(cast("dict[str, Any]", value)) == {VALUE, SOURCE}:
        reply, source = cast("dict[str, Any]", value)[VALUE], str(cast("dict[str, Any]", value)[SOURCE])
    elif isinstance(reply, str):
        reply, _, source = reply.partition(";")
    if isinstance(reply, str):
        reply = unquoted(reply) if form is text else typed(reply)
    return reply, source.strip()


def unquoted(line: str) -> str:
    """Return a text as typed, or within the quotes of TOML."""
    value = typed(line)
    return value if isinstance(value, str) else line.strip()


def plain_text(reply: Any) -> str:
    """Return a reply, typed or of an answer file, as text without its quotes."""
    return unquoted(reply) if isinstance(reply, str) else json.dumps(reply, default=str)


def typed(line: str) -> Any:
    """Return the value of a typed line: TOML value, `1, 2, 3` as a list, anything else as text."""
    line = line.strip()
    for text in (line, f"[{line}]"):
        try:
            return parse_toml(f"x = {text}")["x"]
        except (tomllib.TOMLDecodeError, KeyError):
            continue
    parts = [part.strip() for part in line.replace("[", "").replace("]", "").split(",")]
    if len(parts) == 1:
        return line
    unit = _NUMBER.fullmatch(parts[-1])
    if unit and unit["unit"] and all(_DIGITS.fullmatch(part) for part in parts[:-1]):
        parts[:-1] = [f"{part} {unit['unit']}" for part in parts[:-1]]
    return parts


_DIGITS: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?")
_NUMBER: Final = re.compile(rf"(?P<number>{_DIGITS.pattern})\s*(?P<unit>[A-Za-z%][\w/%]*)?")
_RATIO: Final = re.compile(r"(?P<sign>[-+]?)\s*(?P<first>\d+\.?\d*)\s*:\s*(?P<second>\d+\.?\d*)")
_RANGE: Final = re.compile(r"(\d+)\s*-\s*(\d+)")


def text(value: Any, _axes: int) -> str:
    """Read a word, a name or a path."""
    if not isinstance(value, str) or not value:
        raise ValueError("is not text")
    return value


def flag(value: Any, _axes: int) -> bool:
    """Read true or false."""
    if not isinstance(value, bool):
        raise ValueError("is neither true nor false")
    return value


def table(value: Any, _axes: int) -> Mapping[str, Any]:
    """Read a table of an answer file."""
    if not isinstance(value, dict):
        raise ValueError("is not a table")
    return cast("Mapping[str, Any]", value)


def words(value: Any, axes: int) -> tuple[str, ...]:
    """Read one text for all axes, or one per axis."""
    parts = _parts(value, axes)
    if not parts or not all(isinstance(part, str) and part for part in parts):
        raise ValueError("is neither a text nor a list of texts")
    return tuple(parts)


#: Allowed units of answers, with factors.
ANGLES: Final = factors("angle", "rad", "deg", "mrad")
SPEEDS: Final = factors("speed", "rad/s", "deg/s", "rpm")
TORQUES: Final = factors("torque", "Nm", "mNm", "kNm")
CONSTANTS: Final = {"Nm/A": 1.0, "mNm/A": 1e-3}
MASSES: Final = {"kg": 1.0, "g": 1e-3, "t": 1e3}
LENGTHS: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
TIMES: Final = {"s": 1.0, "ms": 1e-3}
PERCENT: Final = {"%": 0.01, "percent": 0.01}

#: No unit: the number is in that of the key.
PLAIN: Final[Mapping[str, float]] = {}


def per_axis(units: Mapping[str, float] = PLAIN, *, for_all: bool = True, ratio: bool = False) -> Form:
    """Return the form of one number per axis, or (`for_all`) one for all axes; `ratio` allows 1:160."""
    return lambda value, axes: tuple(_number(part, units, ratio=ratio) for part in _parts(value, axes, for_all=for_all))


def node_ids(value: Any, axes: int) -> tuple[Any, ...]:
    """Read the node id of each axis; `1-6` counts up."""
    parts: list[Any] = []
    for part in _listed(value):
        ends = _RANGE.fullmatch(part.strip()) if isinstance(part, str) else None
        parts += [part] if ends is None else range(int(ends[1]), min(int(ends[2]), 127) + 1)
    try:
        numbers = [_number(part, PLAIN) for part in _parts(parts, axes, for_all=False)]
        return tuple(int(number) if number.is_integer() else number for number in numbers)
    except ValueError as error:
        raise ValueError(f"{error}; example: 1-6, or 11, 12, 13, 14, 15, 16") from error


def pairs(units: Mapping[str, float] = PLAIN) -> Form:
    """Return the form of lower and upper limits for all axes, or per axis."""

    def read(value: Any, axes: int) -> tuple[tuple[float, float], ...]:
        rows = _listed(value)
        if len(rows) == 2 and not any(isinstance(row, list) for row in rows):
            rows = [rows] * max(axes, 1)
        if not rows or (axes and len(rows) != axes) or not all(isinstance(row, list) and len(row) == 2 for row in rows):
            raise ValueError("is neither a pair [low, high] nor one pair per axis, [[low, high], ...]")
        return tuple((_number(low, units), _number(high, units)) for low, high in rows)

    return read


def place(units: Mapping[str, float] = PLAIN, **named: tuple[float, ...]) -> Form:
    """Return the form of three numbers, or a name for them."""

    def read(value: Any, _axes: int) -> tuple[float, ...]:
        if isinstance(value, str) and value in named:
            return named[value]
        parts = _listed(value)
        if len(parts) != 3:
            raise ValueError(" or ".join(["is not a list of three numbers", *(f"no `{word}`" for word in named)]))
        return tuple(_number(part, units) for part in parts)

    return read


def one_number(units: Mapping[str, float] = PLAIN, *, none: bool = False) -> Form:
    """Return the form of a single number, or (`none`) the word none."""
    return lambda value, axes: None if none and value == "none" else _number(value, units)


def _listed(value: Any) -> list[Any]:
    """Return the parts of an answer."""
    return cast("list[Any]", value) if isinstance(value, list) else [value]


def _parts(value: Any, axes: int, *, for_all: bool = True) -> list[Any]:
    """Split an answer into one part per axis; with `for_all` a single value applies to all axes."""
    parts = _listed(value)
    if for_all and len(parts) == 1:
        parts = parts * max(axes, 1)
    if axes and len(parts) != axes:
        some = "one for all or " if for_all else ""
        raise ValueError(f"has {len(parts)} values but the arm has {axes} axes; give {some}one per axis")
    return parts


def _number(value: Any, units: Mapping[str, float], *, ratio: bool = False) -> float:
    number = _written(value, units, ratio=ratio) if isinstance(value, str) else value
    if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
        examples = [f"1 {unit}" for unit in units] + ["1:160"] * ratio
        said = f"; give a number, for example {', '.join(examples)}" if examples else ""
        raise ValueError(f"holds {value!r}, which is not a number{said}")
    return float(number)


def _written(text: str, units: Mapping[str, float], *, ratio: bool) -> float | None:
    """Return a number with its unit, or a ratio: 1:160 and 160:1 give 160. None if neither."""
    turns = _RATIO.fullmatch(text.strip()) if ratio else None
    if turns is not None:
        ends = sorted((float(turns["first"]), float(turns["second"])))
        return None if ends[0] == 0 else (-1 if turns["sign"] == "-" else 1) * ends[1] / ends[0]
    found = _NUMBER.fullmatch(text.strip())
    factor = None if found is None else units.get(found["unit"] or "", 1.0 if found["unit"] is None else None)
    return None if found is None or factor is None else float(found["number"]) * factor
