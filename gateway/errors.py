"""Typed errors of the gateway; each carries the exit code of the command line.

GatewayError (1)
+-- ConfigError (3)     cell, robot or profile file: what, where (file:key), what to do
+-- InputError (3)      measured table, recording, result file: file:line
+-- PlanRefused (5)     nothing moved, or motion was stopped, and why
|   +-- WrongPlace          it cannot begin at the arm's position; `servo-gateway move` leads away from there
|   +-- LimitExceeded       position, speed, torque or following error left its limit; the arm was stopped
|   +-- PoseNeverSettles    a pose did not come to rest in time (also TimeoutError)
+-- DataUnusable (6)    rank, too few poses, nothing to hold out
+-- FindingFailed (7)   finished, with a failing finding

Bus and drive errors (4) are `drives.errors.DriveError`.
"""

from __future__ import annotations

import signal
from collections.abc import Mapping, Sequence
from typing import Final, Self

#: What each exit code of the command line means.
EXIT_CODES: Final[Mapping[int, str]] = {
    0: "done, a proven physical effect included",
    1: "a defect of the program; the message names a log file: please report it",
    2: "usage: an option or argument that is none",
    3: "a configuration or input file that cannot be used, a file that is there already, a full disk",
    4: "bus or drive",
    5: "plan refused, or motion stopped",
    6: "the data cannot answer: rank, too few poses, nothing to hold out",
    7: "finished with a failing finding: a load refused, not accepted, or not mounted, a commissioning mistake"
    " found, a failed check",
    130: "stopped by a person, a signal or a closed terminal; what was finished is kept; of an arm that was under power"
    " the message states whether all its drives were read as disabled",
}
#: Signals by which a person or a system ends a program; Windows has no SIGHUP.
ENDING_SIGNALS: Final = tuple(
    signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in signal.Signals.__members__
)


class GatewayError(Exception):
    """Base: one paragraph that says what, where, and what to do; `lines` where a file has several problems."""

    exit_code = 1
    lines: tuple[str, ...] = ()

    @classmethod
    def of(cls, lines: Sequence[str]) -> Self:
        """An error with one line per problem."""
        error = cls("; ".join(lines))
        error.lines = tuple(lines)
        return error


class ConfigError(GatewayError, ValueError):
    """A configuration file that cannot be used."""

    exit_code = 3


class InputError(GatewayError, ValueError):
    """A data file that cannot be used."""

    exit_code = 3


class PlanRefused(GatewayError):  # noqa: N818 - reads as what happened
    """A motion that is not allowed, or that had to be stopped."""

    exit_code = 5


class WrongPlace(PlanRefused):
    """What is requested cannot begin at the arm's position; `to` says where `servo-gateway move` may bring it."""

    def __init__(self, message: str, arm: str, to: str = "home") -> None:
        super().__init__(message)
        self.arm = arm
        self.to = to


class LimitExceeded(PlanRefused):
    """A limit was left while the arm moved; `joint` counts from 1."""

    def __init__(self, message: str, joint: int) -> None:
        super().__init__(message)
        self.joint = joint


class PoseNeverSettles(PlanRefused, TimeoutError):  # noqa: N818 - reads as what happened
    """Position or torque did not come to rest in time; `pose` is its number, `joint` counts from 1."""

    def __init__(self, message: str, pose: int, joint: int) -> None:
        super().__init__(message)
        self.pose = pose
        self.joint = joint


class DataUnusable(GatewayError):  # noqa: N818 - reads as what happened
    """Data that are valid but cannot answer the question."""

    exit_code = 6


class FindingFailed(GatewayError):  # noqa: N818 - reads as what happened
    """The command finished; a finding of severity `fail` remains."""

    exit_code = 7
