"""Differences between two result files of the same data, one stored and one recomputed (`replay`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

#: Numbers that differ by no more, relative to the larger of 1 and the number, are equal: rounding of another computer.
TOLERANCE: Final = 1e-9
#: What is of the moment or of the program that computed it, not of the measurement.
_OF_THE_MOMENT: Final = frozenset({"sha256", "truth", "data.created", "data.software"})
#: Findings on a calibration speak of its age today.
_OF_TODAY: Final = "calibration"


@dataclass(frozen=True, slots=True)
class Difference:
    """One differing value: key path, stored value, recomputed value; None if missing."""

    where: str
    stored: Any
    again: Any


def differences(stored: Mapping[str, Any], again: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Return every value of two result files that differs beyond `TOLERANCE`."""
    return tuple(_differ("", _lasting(stored), _lasting(again)))


def _lasting(plain: Mapping[str, Any]) -> dict[str, Any]:
    findings = [item for item in plain.get("findings", ()) if _place(item) != _OF_TODAY]
    return {**plain, "findings": findings}


def _place(finding: Any) -> Any:
    return finding.get("where") if isinstance(finding, Mapping) else None


def _differ(where: str, stored: Any, again: Any) -> Iterator[Difference]:
    if where in _OF_THE_MOMENT:
        return
    if isinstance(stored, Mapping) and isinstance(again, Mapping):
        for key in dict.fromkeys((*stored, *again)):
            yield from _differ(f"{where}.{key}" if where else str(key), stored.get(key), again.get(key))
    elif _is_list(stored) and _is_list(again) and len(stored) == len(again):
        for index, pair in enumerate(zip(stored, again, strict=True)):
            yield from _differ(f"{where}[{index}]", *pair)
    elif not _equal(stored, again):
        yield Difference(where, stored, again)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _equal(stored: Any, again: Any) -> bool:
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (stored, again)):
        return type(stored) is type(again) and stored == again
    return math.isclose(stored, again, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
