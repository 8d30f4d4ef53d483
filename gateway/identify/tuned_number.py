"""Tuned numbers with meaning, unit and origin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, field, fields
from typing import Any, Final, TypeVar

T = TypeVar("T")

#: Origin of values chosen by the scores of the development seeds of `make blind`.
BLIND: Final = "development seeds of `make blind`"
#: The same for moving runs: chosen on one run, checked on those of other robots.
RUNS: Final = "simulated runs of the tests, then the first measured run of each robot"


def threshold(value: T, unit: str, meaning: str, origin: str) -> T:
    """Return a field of a frozen class of thresholds; `unit` is empty for counts, shares and odds."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "origin": origin})  # type: ignore[return-value]


def described(thresholds: object) -> Iterator[tuple[str, Any, str, str, str]]:
    """Return name, value, unit, meaning and origin of every threshold of a class."""
    listed: tuple[Field[Any], ...] = fields(thresholds)  # type: ignore[arg-type]
    for each in listed:
        about = each.metadata
        yield each.name, getattr(thresholds, each.name), about["unit"], about["meaning"], about["origin"]
