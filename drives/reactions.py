"""Table of the conditions monitored on the bus and in the drives while axes are enabled, and of the reactions.

`drives.monitor` goes through the rules in this order; rules without a scope are raised or counted where they are seen.

`stop`: every axis is stopped by its quick stop ramp, then disabled, and nothing resumes by itself. `along the path`
(requested by the motion loop): time along the path is slowed down to a stop, then the axes are disabled. `retry`: the
SYNC is marked incomplete and the sample is taken again. `count`: it is counted in the statistics and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

from drives.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, INTERNAL_LIMIT, REMOTE, STATE_MASK
from drives.errors import (
    BusError,
    BusOff,
    DriveError,
    DriveFault,
    DriveRebooted,
    ForeignMaster,
    HeartbeatLost,
    IncompleteEpochs,
    MasterStalled,
    NotOperational,
)

Reaction = Literal["stop", "along the path", "retry", "count"]
Scope = Literal["bus", "started", "enabled"]


@dataclass(frozen=True, slots=True)
class Rule:
    """Monitored condition with its limit and reaction.

    Attributes
    ----------
    what : str
        The condition.
    reaction : "stop", "along the path", "retry" or "count"
    limit : float
        Threshold of the reaction.
    unit : str
        Of the limit.
    advice : str
        Remedy.
    error : class of DriveError or None
        What is raised; None where nothing is, or not by the drives.
    least_s : float
        In real time: shortest duration [s], because an operating system may pause the sender or the receiver.
    scope : "bus", "started", "enabled" or None
        Since when the monitor looks at it: always, since the drives were started by NMT, while every axis is enabled.
    bits : int
        Bits of the statusword that differ from those of an enabled drive where the condition holds.
    """

    what: str
    reaction: Reaction
    limit: float
    unit: str
    advice: str = ""
    error: type[DriveError] | None = None
    least_s: float = 0.0
    scope: Scope | None = None
    bits: int = 0

    @property
    def count(self) -> int:
        """Return the limit as an integer count."""
        return int(self.limit)

    def syncs(self, period_s: float, pacing: str) -> int:
        """Return the limit as a number of SYNCs at this period."""
        return self.count if pacing == "lockstep" else max(self.count, math.ceil(self.least_s / period_s))

    def raised(
        self, what: str, *, node: int | None = None, index: int | None = None, code: int | None = None, more: str = ""
    ) -> DriveError:
        """Return the error of this rule for a node or the whole bus; `more` is appended to the remedy."""
        advice = "; ".join(part for part in (self.advice, more) if part)
        return (self.error or DriveError)(what, node=node, index=index, code=code, advice=advice)


_ONE: Final = "SYNC"
_ROW: Final = "SYNCs in a row"
_FIND: Final = "find and remove the cause before enabling again"

DRIVE_RULES: Final[Mapping[str, Rule]] = MappingProxyType(
    {
        "left_operational": Rule(
            "a drive's heartbeat shows that it left the NMT state OPERATIONAL",
            "stop",
            1,
            "heartbeat",
            "see its error register 0x1001, and look for another master that sends NMT commands",
            NotOperational,
            scope="started",
        ),
        "bus_off": Rule(
            "the CAN controller is bus-off",
            "stop",
            1,
            "error frame",
            "check wiring, termination and bit rate, then bring the interface up again",
            BusOff,
            scope="bus",
        ),
        "booted": Rule(
            "a boot-up in the middle of a run",
            "stop",
            1,
            "message",
            "it lost power or was reset, and its configuration is gone: connect() and configure() again",
            DriveRebooted,
            scope="bus",
        ),
        "heartbeat_lost": Rule(
            "a drive's heartbeat is missing for three of its periods, by wall clock and by SYNCs",
            "stop",
            0.5,
            "s at least",
            "check power and cabling of this drive",
            HeartbeatLost,
            scope="bus",
        ),
        "second_master": Rule(
            "SYNC or NMT commands of another master",
            "stop",
            1,
            "frame",
            "stop the other master before enabling again",
            ForeignMaster,
            scope="bus",
        ),
        "foreign_master": Rule(
            "SDO requests or setpoints of another master",
            "stop",
            3,
            "frames",
            "stop the other master before enabling again",
            ForeignMaster,
            scope="bus",
        ),
        "left_enabled": Rule(
            "a drive leaves OPERATION ENABLED by itself",
            "stop",
            1,
            _ONE,
            "find the cause before enabling again: fault, STO, enable input, power supply",
            DriveFault,
            scope="enabled",
            bits=STATE_MASK,
        ),
        "silent": Rule(
            "a drive leaves SYNCs unanswered",
            "stop",
            5,
            _ROW,
            "check power and cabling of this drive",
            IncompleteEpochs,
            0.1,
            scope="started",
        ),
        "emergency": Rule(
            "an emergency message",
            "stop",
            1,
            "message",
            _FIND,
            DriveFault,
            scope="enabled",
        ),
        "internal_limit": Rule(
            "a limit inside the drive acts (statusword bit 11)",
            "stop",
            2,
            _ROW,
            "see its torque, current, speed and position limits; where only a warning sets the bit, set "
            "ignored_status = 0x0800 in [state_machine] of its profile",
            DriveFault,
            0.03,
            scope="enabled",
            bits=INTERNAL_LIMIT,
        ),
        "following_error": Rule(
            "following error in the drive (statusword bit 13)",
            "stop",
            2,
            _ROW,
            "look for contact, a brake that drags, the tuning",
            DriveFault,
            0.03,
            scope="enabled",
            bits=FOLLOWING_ERROR,
        ),
        "not_remote": Rule(
            "no longer under remote control (statusword bit 9, which it showed before, is cleared)",
            "stop",
            2,
            _ROW,
            "a panel or tool has taken it: release it there",
            DriveFault,
            0.03,
            scope="enabled",
            bits=REMOTE,
        ),
        "not_following": Rule(
            "a drive does not follow its target (statusword bit 12, which it showed before, is cleared)",
            "stop",
            2,
            _ROW,
            "see what in the drive overrides the target: halt, limit switch, its own mode",
            DriveFault,
            0.03,
            scope="enabled",
            bits=FOLLOWS_COMMAND,
        ),
        "stale": Rule(
            "the same answer again and again, and SDO says otherwise",
            "stop",
            25,
            _ROW,
            "its answers to SYNC are not fresh: restart the drive, check its firmware",
            DriveFault,
            scope="enabled",
        ),
        "stalled": Rule(
            "in real time: this computer stalls while the axes move; the overdue setpoint is not sent",
            "stop",
            2,
            "SYNC periods late",
            "end other work on this computer, give it a real-time scheduler, or raise sync_period_s",
            MasterStalled,
        ),
        "queue_full": Rule(
            "the transmit queue stays full",
            "stop",
            0.02,
            "s",
            "check that the bus is up, that a powered drive acknowledges, and that txqueuelen is at least 1000",
            BusError,
        ),
        "unanswered": Rule("a drive leaves one SYNC unanswered", "retry", 1, _ONE),
        "ambiguous": Rule("two different answers of a drive to one SYNC", "retry", 1, _ONE),
        "wrong_length": Rule("an answer shorter or longer than mapped", "retry", 1, _ONE),
        "unsure": Rule("an answer that may belong to an earlier SYNC that was left unanswered", "retry", 1, _ONE),
        "late": Rule("an answer after its SYNC was closed", "retry", 1, _ONE),
        "duplicate": Rule("the same answer twice", "count", 1, "frame"),
        "overrun": Rule("a SYNC that the clock could not send in time", "count", 1, _ONE),
        "emergency_reset": Rule("an emergency message that reports an error reset", "count", 1, "message"),
        "emergency_warning": Rule(
            "an emergency message that the profile of the drive lists as a warning", "count", 1, "message"
        ),
        "warning": Rule("warning (statusword bit 7)", "count", 1, _ONE),
        "error_frames": Rule("error frames, error passive", "count", 1, "frame"),
        "strange_frames": Rule("extended and remote frames, unused ids", "count", 1, "frame"),
    }
)
