"""Formats of answers: typed text or value of an answer file, for all axes or for each."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, cast

from drives.toml_text import parse_toml
from gateway.formats.log_map import factors

#: Keys of a constant with its source in an answer file.
VALUE, SOURCE = "value", "source"


#: Format of an answer: (TOML value, number of axes; 0 = unknown) -> the answer; raises ValueError with a message.
Form = Callable[[Any, int], Any]


def typed_answer(line: str) -> Any:
    """Return the answer of a typed line: its value, or with `; source` behind it the table of an answer file."""
    value, _, source = line.partition(";")
    return {VALUE: typed(value), SOURCE: source.strip()} if source.strip() else typed(value)


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
    if unit and unit["unit"] and all(_PLAIN.fullmatch(part) for part in parts[:-1]):
        parts[:-1] = [f"{part} {unit['unit']}" for part in parts[:-1]]
    return parts


_PLAIN: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?")
_NUMBER: Final = re.compile(rf"(?P<number>{_PLAIN.pattern})\s*(?P<unit>[A-Za-z%][\w/%]*)?")
_RATIO: Final = re.compile(r"(?P<sign>[-+]?)\s*(?P<first>\d+\.?\d*)\s*:\s*(?P<second>\d+\.?\d*)")
_RANGE: Final = re.compile(r"(\d+)\s*-\s*(\d+)")


def text(value: Any, _axes: int) -> str:
    """Read a word, a name or a path."""
    if isinstance(value, list):  # INTERFACE:CHANNEL,key=value
        value = ",".join(str(part) for part in cast("list[Any]", value))
    if not isinstance(value, str) or not value.strip():
        raise ValueError("is not text")
    return value.strip()


def pattern(spelled: str, otherwise: str) -> Form:
    """Return the form of a text that matches a regular expression."""

    def read(value: Any, _axes: int) -> str:
        if not isinstance(value, str) or re.fullmatch(spelled, value) is None:
            raise ValueError(f"is {value!r}, which is {otherwise}")
        return value

    return read


def choice(*options: str) -> Form:
    """Return the form of an answer that is one of several words."""

    def read(value: Any, _axes: int) -> str:
        if value not in options:
            raise ValueError(f"is not one of {', '.join(options)}")
        return str(value)

    return read


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


@dataclass(frozen=True, slots=True)
class FormRule:
    """Rule for a number, and the message if it is violated."""

    holds: Callable[[float], bool]
    otherwise: str
    units: Mapping[str, float] = field(default_factory=dict)
    ratio: bool = False

    def of(self, units: Mapping[str, float], *, ratio: bool = False) -> FormRule:
        """Return the same rule for a number with a unit (factors to SI), or a ratio such as 1:160."""
        return replace(self, units=units, ratio=ratio)


#: Allowed units of answers, with factors.
ANGLES: Final = factors("angle", "rad", "deg", "mrad")
SPEEDS: Final = factors("speed", "rad/s", "deg/s", "rpm")
TORQUES: Final = factors("torque", "Nm", "mNm", "kNm")
CONSTANTS: Final = {"Nm/A": 1.0, "mNm/A": 1e-3}
MASSES: Final = {"kg": 1.0, "g": 1e-3, "t": 1e3}
LENGTHS: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
TIMES: Final = {"s": 1.0, "ms": 1e-3}
PERCENT: Final = {"%": 0.01, "percent": 0.01}

ANY: Final = FormRule(math.isfinite, "not finite")
POSITIVE: Final = FormRule(lambda value: value > 0, "not above 0")
NOT_ZERO: Final = FormRule(lambda value: value != 0, "no ratio")
SHARE: Final = FormRule(lambda value: 0 < value <= 1, "not in 0 to 1")
SIGN: Final = FormRule(lambda value: value in (-1, 1), "neither 1 nor -1")
NODE_ID: Final = FormRule(lambda value: value == round(value) and 1 <= value <= 127, "not a node id (1 to 127)")


def per_axis(rule: FormRule = ANY, *, for_all: bool = True) -> Form:
    """Return the form of one number per axis, or (`for_all`) one for all axes."""
    return lambda value, axes: tuple(_kept(part, rule) for part in _parts(value, axes, for_all=for_all))


def node_ids(value: Any, axes: int) -> tuple[int, ...]:
    """Read the node id of each axis; `1-6` counts up."""
    parts: list[Any] = []
    for part in _listed(value):
        ends = _RANGE.fullmatch(part.strip()) if isinstance(part, str) else None
        parts += [part] if ends is None else range(int(ends[1]), min(int(ends[2]), 127) + 1)
    try:
        return tuple(int(_kept(part, NODE_ID)) for part in _parts(parts, axes, for_all=False))
    except ValueError as error:
        raise ValueError(f"{error}; example: 1-6, or 11, 12, 13, 14, 15, 16") from error


def _kept(value: Any, rule: FormRule) -> float:
    number = _number(value, rule)
    if not rule.holds(number):
        raise ValueError(f"holds {number:g}, which is {rule.otherwise}")
    return number


def pairs(rule: FormRule = ANY) -> Form:
    """Return the form of lower and upper limits for all axes, or per axis."""

    def read(value: Any, axes: int) -> tuple[tuple[float, float], ...]:
        rows = _listed(value)
        if len(rows) == 2 and not any(isinstance(row, list) for row in rows):
            rows = [rows] * max(axes, 1)
        if not rows or (axes and len(rows) != axes) or not all(isinstance(row, list) and len(row) == 2 for row in rows):
            raise ValueError("is neither a pair [low, high] nor one pair per axis, [[low, high], ...]")
        found = tuple((_number(low, rule), _number(high, rule)) for low, high in rows)
        for low, high in found:
            if not low < high:
                raise ValueError(f"holds [{low:g}, {high:g}], whose first value is not below the second")
        return found

    return read


def place(rule: FormRule = ANY, **named: tuple[float, ...]) -> Form:
    """Return the form of three numbers, or a name for them."""

    def read(value: Any, _axes: int) -> tuple[float, ...]:
        if isinstance(value, str) and value in named:
            return named[value]
        parts = _listed(value)
        if len(parts) != 3:
            raise ValueError(" or ".join(["is not a list of three numbers", *(f"no `{word}`" for word in named)]))
        return tuple(_number(part, rule) for part in parts)

    return read


def one_number(rule: FormRule = ANY) -> Form:
    """Return the form of a single number."""
    return lambda value, axes: _kept(value, rule)


def number_or_none(rule: FormRule = ANY) -> Form:
    """Return the form of a single number, or `none`."""
    return lambda value, axes: None if value == "none" else _kept(value, rule)


def _listed(value: Any) -> list[Any]:
    """Return the parts of an answer; an answer file may hold several as one text, as they are typed."""
    if isinstance(value, str) and "," in value:
        value = typed(value)
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


def _number(value: Any, rule: FormRule) -> float:
    number = _written(value, rule) if isinstance(value, str) else value
    if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
        examples = [f"1 {unit}" for unit in rule.units] + ["1:160"] * rule.ratio
        said = f"; give a number, for example {', '.join(examples)}" if examples else ""
        raise ValueError(f"holds {value!r}, which is not a number{said}")
    return float(number)


def _written(text: str, rule: FormRule) -> float | None:
    """Return a number with its unit, or a ratio: 1:160 and 160:1 give 160. None if neither."""
    ratio = _RATIO.fullmatch(text.strip()) if rule.ratio else None
    if ratio is not None:
        ends = sorted((float(ratio["first"]), float(ratio["second"])))
        return None if ends[0] == 0 else (-1 if ratio["sign"] == "-" else 1) * ends[1] / ends[0]
    found = _NUMBER.fullmatch(text.strip())
    factor = None if found is None else rule.units.get(found["unit"] or "", 1.0 if found["unit"] is None else None)
    return None if found is None or factor is None else float(found["number"]) * factor
