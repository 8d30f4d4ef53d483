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


#: Keys of a cell file with which fewer SYNCs are simulated: in longer cycles, at fewer poses; less accurate.
HEAVY = {"sync_period_s": 0.04, "approach_speed_rad_s": 0.2, "samples": 20, "count": 6, "validation": 2}
#: The same of an arm of a few kilograms, which may move faster.
FASTER = {"speed_limit_rad_s": 1.6, "acceleration_limit_rad_s2": 3.0, "jerk_limit_rad_s3": 30.0}
SHORTLY = HEAVY | FASTER


def measured_shortly(text: str, values: dict[str, float] = SHORTLY) -> str:
    """Text of a cell file with half of the poses, each of few SYNCs."""
    for key, value in values.items():
        text = re.sub(rf"(?m)^{key} = .*", f"{key} = {value}", text)
    return text
