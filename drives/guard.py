"""Monitor the drives at every SYNC while axes are enabled; each finding is a typed error that names the node."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from drives.bus import NMT_ID, SYNC_ID, Bus
from drives.cia402 import ENABLED_PATTERN, STATE_MASK, State, decode_state, describe
from drives.emcy import EmcyLog
from drives.epoch import Epoch
from drives.errors import (
    DriveError,
    DriveFault,
    SeveralFailures,
    raise_failures,
)
from drives.exchange import SyncExchange
from drives.heartbeat import HeartbeatWatch
from drives.reactions import DRIVE_RULES
from drives.status_monitor import StatusMonitor

_EVERY: Final = 16
_BUSY: Final = "end other work on this computer, lower the bus load, or raise sync_period_s"
_SECOND: Final = frozenset({SYNC_ID, NMT_ID})


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits above which a disturbance stops all axes.

    Attributes
    ----------
    unanswered_syncs : int
        SYNCs in a row that an axis may leave unanswered.
    foreign_frames : int
        SDO requests or setpoints of another master with one id; of SYNC and NMT commands one frame is enough.
    """

    unanswered_syncs: int = DRIVE_RULES["silent"].count
    foreign_frames: int = DRIVE_RULES["foreign_master"].count


class Guard:
    """Monitoring of drives and bus after each SYNC.

    Parameters
    ----------
    bus : Bus
    exchange : SyncExchange
    watch : HeartbeatWatch
    emcy : EmcyLog
    limits : Limits
    """

    def __init__(self, bus: Bus, exchange: SyncExchange, watch: HeartbeatWatch, emcy: EmcyLog, limits: Limits) -> None:
        self.limits = limits
        self._bus = bus
        self._exchange = exchange
        self.watch = watch
        self.emcy = emcy
        self._symptoms = StatusMonitor(exchange, emcy)
        #: Axes (from 0) that may leave OPERATION ENABLED because they were commanded to.
        self.excused: frozenset[int] = frozenset()
        self._foreign_before: dict[int, int] = {}
        self._foreign_seen = 0
        self.forgive()

    def forgive(self) -> None:
        """Reset the monitoring for a new run: boot-ups, heartbeat timers and frames of other masters are cleared."""
        self.watch.forgive()
        self._symptoms.forgive()
        self.excused = frozenset()
        self._foreign_before, self._foreign_seen = dict(self._bus.foreign), self._bus.foreign_count

    def forgive_cleared(self) -> None:
        """Every node has started: reset its recorded state, and drop emergencies that were reported as cleared."""
        self._symptoms.forgive_cleared()
        self.watch.left.clear()

    def excuse(self, axes: frozenset[int]) -> None:
        """From now on these axes (from 0) and no others may leave OPERATION ENABLED."""
        for axis in axes - self.excused:
            self._symptoms.forget(axis)
        self.excused = axes

    def check(self, epoch: Epoch) -> None:
        """Run all checks of a SYNC in which every axis must be enabled.

        Raises
        ------
        DriveFault, DriveRebooted, NotOperational, HeartbeatLost, IncompleteEpochs, ForeignMaster, BusOff,
        SeveralFailures
        """
        if self.watch.left:
            self.check_operational()
        if self.watch.booted or self._bus.bus_off or self._bus.foreign_count != self._foreign_seen:
            self.check_bus()
        if self.excused:
            kept = (None if axis in self.excused else each for axis, each in enumerate(epoch.readings))
            epoch = replace(epoch, readings=tuple(kept))
        for axis, reading in enumerate(epoch.readings):
            if reading is None:
                self.check_unanswered()
                self._check_unassigned(axis)
            elif reading.statusword & STATE_MASK != ENABLED_PATTERN:
                raise_failures(self._not_enabled(epoch))
        self._symptoms.check(epoch)
        if epoch.sync_index % _EVERY == 0:
            self.check_bus()

    def _check_unassigned(self, axis: int) -> None:
        """Check the CiA 402 state in responses that cannot be assigned to their SYNC."""
        statusword = self._exchange.unassigned[axis]
        if statusword is not None and axis not in self.excused and statusword & STATE_MASK != ENABLED_PATTERN:
            raise _left_enabled(self._exchange.drives[axis].node_id, statusword)

    def _not_enabled(self, epoch: Epoch) -> list[DriveError]:
        return [
            _left_enabled(reading.node_id, reading.statusword)
            for reading in epoch.readings
            if reading is not None and decode_state(reading.statusword) is not State.OPERATION_ENABLED
        ]

    def explain(self, error: DriveError) -> None:
        """Add to each fault the emergency message of the drive."""
        for failure in error.failures if isinstance(error, SeveralFailures) else (error,):
            if isinstance(failure, DriveFault) and failure.node is not None:
                clause = self.emcy.last_clause(failure.node)
                failure.what += "" if clause in failure.what else clause

    def check_operational(self) -> None:
        """Raise an error for nodes that left the NMT state OPERATIONAL."""
        states, rule = self.watch.states, DRIVE_RULES["left_operational"]
        raise_failures(
            [
                rule.raised(f"left OPERATIONAL: its heartbeat shows {str(states[node]).upper()}", node=node)
                for node in sorted(self.watch.left)
            ]
        )

    def check_unanswered(self) -> None:
        """Raise an error for axes that left too many SYNCs unanswered."""
        if max(self._exchange.unanswered) < self.limits.unanswered_syncs:
            return
        raise_failures(
            [
                self._unanswered_error(axis, count)
                for axis, count in enumerate(self._exchange.unanswered)
                if count >= self.limits.unanswered_syncs
            ]
        )

    def _unanswered_error(self, axis: int, count: int) -> DriveError:
        """Return the error for an axis whose responses are missing or arrived after the response window."""
        node, delayed = self._exchange.drives[axis].node_id, self._exchange.delayed_answers(axis)
        rule = DRIVE_RULES["silent"]
        if not delayed:
            return rule.raised(f"left {count} SYNCs in a row unanswered", node=node)
        what = f"left {count} SYNCs in a row unanswered in time: {delayed} answers were delayed"
        return replace(rule, advice=_BUSY).raised(what, node=node)

    def check_bus(self) -> None:
        """Raise an error for bus-off, boot-ups, stopped heartbeats and frames of another master."""
        self._bus.check()
        booted, lost = DRIVE_RULES["booted"], DRIVE_RULES["heartbeat_lost"]
        raise_failures([booted.raised("booted during the run", node=node) for node in sorted(self.watch.booted)])
        raise_failures([lost.raised("its heartbeat stopped", node=node) for node in sorted(self.watch.lost())])
        if self._bus.foreign_count != self._foreign_seen:
            self._check_foreign()

    def _check_foreign(self) -> None:
        second, foreign = DRIVE_RULES["second_master"], DRIVE_RULES["foreign_master"]
        self._foreign_seen = self._bus.foreign_count
        for can_id, number in self._bus.foreign.items():
            new = number - self._foreign_before.get(can_id, 0)
            rule, limit = (second, second.count) if can_id in _SECOND else (foreign, self.limits.foreign_frames)
            if new >= limit:
                frames = "a frame" if new == 1 else f"{new} frames"
                raise rule.raised(f"{frames} with id {can_id:03X} on {self._bus.spec} came from another master")


def _left_enabled(node_id: int, statusword: int) -> DriveError:
    what = f"left OPERATION ENABLED: {describe(statusword)}"
    return DRIVE_RULES["left_enabled"].raised(what, node=node_id, index=0x6041, code=statusword)
