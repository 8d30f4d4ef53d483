"""Cells of the examples in lockstep or measured shortly: what tests and benchmarks not about the clock run on."""

from __future__ import annotations

import re

_PACING = re.compile(r'^pacing = "\w+"', re.MULTILINE)


def in_lockstep(text: str) -> str:
    """Text of a cell file in which every bus is in lockstep."""
    return _PACING.sub('pacing = "lockstep"', text)


def by_the_clock(text: str) -> str:
    """Text of a cell file in which every bus runs in real time."""
    return _PACING.sub('pacing = "real"', text)


#: Keys of a cell file with values for which fewer SYNCs are simulated; accuracy suffers.
SHORTLY = {"sync_period_s": 0.02, "approach_speed_rad_s": 0.15, "samples": 30, "count": 6, "validation": 2}


def measured_shortly(text: str) -> str:
    """Text of a cell file with half of the poses, each of a third of the SYNCs."""
    for key, value in SHORTLY.items():
        text = re.sub(rf"(?m)^{key} = .*", f"{key} = {value}", text)
    return text
