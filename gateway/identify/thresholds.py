"""A tuned number with its meaning, its unit and where its value comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, field, fields
from typing import Any, Final, TypeVar

T = TypeVar("T")

#: Where a value comes from that no rule gives: it is the one that served the development seeds of `make blind` best.
BLIND: Final = "development seeds of `make blind`"
#: The same of moving runs, of which there are few: one of them chose, and those of other robots were looked at after.
RUNS: Final = "simulated runs of the tests, then the first measured run of each robot"


def threshold(value: T, unit: str, meaning: str, origin: str) -> T:
    """A field of a frozen class of thresholds; `unit` is empty for counts, shares and odds."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "origin": origin})  # type: ignore[return-value]


def described(thresholds: object) -> Iterator[tuple[str, Any, str, str, str]]:
    """Name, value, unit, meaning and origin of every threshold of a class."""
    listed: tuple[Field[Any], ...] = fields(thresholds)  # type: ignore[arg-type]
    for each in listed:
        about = each.metadata
        yield each.name, getattr(thresholds, each.name), about["unit"], about["meaning"], about["origin"]
