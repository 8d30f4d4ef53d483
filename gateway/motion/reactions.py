"""Table of all reactions of a cell under power: conditions that stop the arm, repeat a sample, or are counted.

The conditions of the drives are in `drives.reactions`; this module adds those of the arm. `python -m
gateway.motion.reactions` prints the whole table as Markdown.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from drives.errors import IncompleteEpochs
from drives.reactions import DRIVE_RULES, Rule

_ROW: Final = "SYNCs in a row"

ARM_RULES: Final[Mapping[str, Rule]] = MappingProxyType(
    {
        "range": Rule(
            "a joint outside its range",
            "stop",
            1,
            "SYNC",
            "check position_sign, gear_ratio and zero_offset_rad of this axis",
        ),
        "limits": Rule(
            "following error, speed or torque of a joint beyond its limit",
            "stop",
            3,
            _ROW,
            "look for contact, a brake that drags, or a wrong limit or torque constant",
        ),
        "contact": Rule(
            "a jump of the torque that the model and the gear's reversal do not explain",
            "stop",
            3,
            _ROW,
            "look for contact, a load that slips, a cable that is caught",
        ),
        "rhythm": Rule(
            "SYNCs delayed by more than half a period",
            "stop",
            0.2,
            "of those within 2 s",
            "this computer does not keep the SYNC rhythm: end other work on it, or raise sync_period_s",
            IncompleteEpochs,
        ),
        "late_sync": Rule(
            "one delayed SYNC: the drives wait for it and the arm oscillates; contact is not checked",
            "count",
            0.25,
            "s after it",
        ),
        "stays_behind": Rule(
            "a joint that is commanded to move and does not",
            "stop",
            0.04,
            "rad of commanded movement",
            "look for a brake that is engaged, commands that do not reach the drive, position_sign and "
            "gear_ratio of this axis",
        ),
        "sinks": Rule(
            "a joint moves while its brake opens",
            "stop",
            0.02,
            "rad",
            "check the drive's tuning, and gear_ratio and position_sign of this axis",
        ),
        "never_settles": Rule(
            "a pose does not settle within settle_timeout_s",
            "stop",
            1,
            "settle_timeout_s",
            "look for a swinging load, a loose mounting or a hunting position loop, or raise [poses] settle_timeout_s",
        ),
        "repeats": Rule(
            "too many SYNCs of a visit had to be repeated",
            "stop",
            0.5,
            "of the samples, at least 10",
            "the visit was aborted; check cabling, termination and bus load, then record --resume",
        ),
        "urgent": Rule("a second signal (SIGINT, SIGTERM, SIGHUP)", "stop", 1, "signal", "continue with --resume"),
        "asked": Rule(
            "Ctrl-C, a request to terminate, a terminal that was closed, a key that was released, the live page",
            "along the path",
            1,
            "signal",
            "continue with --resume",
        ),
        "disk": Rule(
            "a disk that is too slow for the recording",
            "along the path",
            8,
            "visits that wait for the disk",
            "free the disk",
        ),
        "frame_log": Rule(
            "a frame log (--trace) that cannot be written; it is switched off",
            "along the path",
            1,
            "error",
            "free the disk",
        ),
        "page": Rule(
            "the process of the live page has ended or does not answer: its stop button does not work",
            "along the path",
            2,
            "s without an answer",
            "start again, without --live if it repeats",
        ),
        "force": Rule(
            "two arms: internal force above twice its limit; quick stop if it then rises 2.5 times",
            "along the path",
            0.02,
            "s",
            "release the part before moving on",
        ),
        "force_at_rest": Rule(
            "two arms: internal force significantly above half its limit in a held part while approaching the start",
            "along the path",
            0.02,
            "s",
            "open the grippers and check the grasp of both arms",
        ),
        "sensors": Rule(
            "two arms: a distance sensor does not follow the arms while the gap is closed at the start",
            "along the path",
            3,
            _ROW,
            "swap the sensor channels, or check the sensor's position, direction and wiring",
        ),
        "gap": Rule(
            "two arms: no distance for missing_cycles; quick stop where one is outside its range",
            "along the path",
            5,
            _ROW,
            "check the measuring device",
        ),
    }
)

#: All rules, those of the drives first.
REACTIONS: Final[Mapping[str, Rule]] = MappingProxyType({**DRIVE_RULES, **ARM_RULES})

#: Description of each reaction.
MEANING: Final[Mapping[str, str]] = MappingProxyType(
    {
        "stop": "quick stop of all axes with the next SYNC, standstill, then brakes; nothing resumes by itself",
        "along the path": "time along the path is slowed down to a stop, then brakes; nothing resumes by itself",
        "retry": "the sample is incomplete; it is reported and repeated",
        "count": "counted and reported",
    }
)


def markdown() -> str:
    """Return the table as Markdown, one row per rule."""
    rows = ["| condition | threshold | reaction |", "|---|---|---|"]
    for reaction in MEANING:
        rows += [
            f"| {rule.what} | {rule.limit:g} {rule.unit} | {reaction} |"
            for rule in REACTIONS.values()
            if rule.reaction == reaction
        ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(markdown())  # noqa: T201 - this is what it is for
