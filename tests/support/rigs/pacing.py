"""Cells of the examples in lockstep: what tests and benchmarks that are not about the clock run on."""

from __future__ import annotations

import re

_PACING = re.compile(r'^pacing = "\w+"', re.MULTILINE)


def in_lockstep(text: str) -> str:
    """Text of a cell file in which every bus is in lockstep."""
    return _PACING.sub('pacing = "lockstep"', text)


def by_the_clock(text: str) -> str:
    """Text of a cell file in which every bus runs in real time."""
    return _PACING.sub('pacing = "real"', text)
