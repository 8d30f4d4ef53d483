"""Monitor bus and drives at every SYNC by the table of reactions; each finding is a typed error that names the node.

One loop goes through the rules of `drives.reactions` in the order of the table. The measure of a rule counts how far
each node has come towards its limit; the errors of all nodes that have reached it are raised. A SYNC at which nothing
has changed and every statusword is as expected ends before that loop.

The readings of a drive are invalid when it limits the torque, has a following error, is controlled by its panel or
repeats old values. Therefore each of these stops all axes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import Final

from drives.bus import NMT_ID, SYNC_ID, Bus
from drives.cia402 import ENABLED_PATTERN, FOLLOWS_COMMAND, REMOTE, STATE_MASK, describe
from drives.emcy import EmcyLog
from drives.epoch import Epoch
from drives.errors import DriveError, DriveFault, SeveralFailures, raise_failures
from drives.exchange import SyncExchange
from drives.heartbeat import HeartbeatWatch
from drives.reactions import DRIVE_RULES, Rule, Scope
from drives.sdo import Posted
from drives.values import DriveReading

#: Interval in SYNCs at which the bus is looked at although nothing has come: a heartbeat may have stopped.
_EVERY: Final = 16
_BUSY: Final = "end other work on this computer, lower the bus load, or raise sync_period_s"
#: Frames of which only one master may be the sender.
_SECOND: Final = frozenset({SYNC_ID, NMT_ID})
#: SYNCs in a row with an identical answer before the drive is queried by SDO.
SAME_IN_A_ROW: Final = DRIVE_RULES["stale"].count
#: Largest difference between SDO and the repeated answer, in motor revolutions.
_SAME_REVOLUTIONS: Final = 0.002
#: Number of queries before a missing answer counts as an error.
_ATTEMPTS: Final = 2
#: SYNCs that the answer to SYNC has to stay the same after SDO has reported another value: an axis that has just begun
#: to move shows it by SDO first.
SETTLED_SYNCS: Final = 2
#: Bits of the statusword that not every drive sets in a cyclic mode: each is expected once it was seen.
_LEARNT: Final = FOLLOWS_COMMAND | REMOTE
_WATCHED: Final = reduce(or_, (rule.bits for rule in DRIVE_RULES.values())) & ~_LEARNT
#: Rules of single bits, which one message names together.
_BIT_RULES: Final = [rule for rule in DRIVE_RULES.values() if rule.bits & ~STATE_MASK]
#: Rules that hold as soon as the bus is used, as the drives are started by NMT, as every axis is enabled.
_SCOPES: Final[tuple[Scope, ...]] = ("bus", "started", "enabled")

#: How far each node has come towards the limit of a rule, with the error to raise when it is reached.
Counts = Iterator[tuple[float, DriveError]]


class Monitor:
    """Monitor of the drives that share one SYNC.

    Parameters
    ----------
    bus : Bus
    exchange : SyncExchange
    watch : HeartbeatWatch
    emcy : EmcyLog
    limits : mapping of str to float, optional
        Limits in place of those in the table, by name of the rule; None = as in the table.

    Attributes
    ----------
    excused : frozenset of int
        Axes (from 0) that may leave OPERATION ENABLED because they were commanded to.
    """

    def __init__(
        self,
        bus: Bus,
        exchange: SyncExchange,
        watch: HeartbeatWatch,
        emcy: EmcyLog,
        limits: Mapping[str, float | None] = MappingProxyType({}),
    ) -> None:
        self.watch = watch
        self.emcy = emcy
        self.excused: frozenset[int] = frozenset()
        self._bus = bus
        self._exchange = exchange
        self._readings: tuple[DriveReading | None, ...] = ()
        measures: dict[str, Callable[[Rule], Counts]] = {
            "left_operational": self._left_operational,
            "bus_off": self._bus_off,
            "booted": self._booted,
            "heartbeat_lost": self._heartbeats_lost,
            "second_master": self._foreign_frames,
            "foreign_master": self._foreign_frames,
            "left_enabled": self._left_enabled,
            "silent": self._unanswered,
            "emergency": self._emergencies,
            "stale": self._stale,
        } | {name: self._status_bits for name, rule in DRIVE_RULES.items() if rule in _BIT_RULES}
        timing = exchange.timing
        #: By scope, in the order of the table: rule, its measure, limit.
        self._rules: dict[Scope, list[tuple[Rule, Callable[[Rule], Counts], float]]] = {each: [] for each in _SCOPES}
        for name, rule in DRIVE_RULES.items():
            if rule.scope is not None:
                limit = limits.get(name) or max(rule.limit, rule.syncs(timing.period_s, timing.pacing))
                for scope in _SCOPES[_SCOPES.index(rule.scope) :]:
                    self._rules[scope].append((rule, measures[name], limit))
        self.forgive()

    def forgive(self) -> None:
        """Reset the monitoring for a new run: what has been counted so far is cleared."""
        self.watch.forgive()
        self.excused = frozenset()
        axes = len(self._exchange.drives)
        self._emcy_seen = self.emcy.count
        self._foreign_before, self._foreign_seen = dict(self._bus.foreign), self._bus.foreign_count
        #: By axis: expected bits, SYNCs in a row without each of them, SYNCs in a row with the same answer, and that.
        self._expected = [ENABLED_PATTERN] * axes
        self._meaningful = [~drive.setup.profile.state_machine.ignored_status for drive in self._exchange.drives]
        self._odd: list[dict[int, int]] = [{} for _ in range(axes)]
        self._same = [0] * axes
        self._last: list[tuple[int, int] | None] = [None] * axes
        #: Open SDO queries of position and torque, by axis: how often it was queried, SYNCs since both were answered.
        self._queries: dict[int, tuple[Posted, Posted, int, int]] = {}

    def forgive_cleared(self) -> None:
        """Every node has started: reset its recorded state, and drop emergencies that were reported as cleared."""
        self.watch.contrary.clear()
        new = self.emcy.count - self._emcy_seen
        latest = {each.node_id: each for each in self.emcy.messages[-new:]} if new else {}
        if latest and all(each.is_harmless for each in latest.values()):
            self._emcy_seen = self.emcy.count

    def excuse(self, axes: frozenset[int]) -> None:
        """From now on these axes (from 0) and no others may leave OPERATION ENABLED."""
        for axis in axes - self.excused:
            self._odd[axis], self._same[axis], self._last[axis], self._expected[axis] = {}, 0, None, ENABLED_PATTERN
            self._queries.pop(axis, None)
        self.excused = axes

    def explain(self, error: DriveError) -> None:
        """Add to each fault the emergency message of the drive."""
        for failure in error.failures if isinstance(error, SeveralFailures) else (error,):
            if isinstance(failure, DriveFault) and failure.node is not None:
                clause = self.emcy.last_clause(failure.node)
                failure.what += "" if clause in failure.what else clause

    def check(self, epoch: Epoch) -> None:
        """Run all checks of a SYNC in which every axis must be enabled.

        Raises
        ------
        DriveFault, DriveRebooted, NotOperational, HeartbeatLost, IncompleteEpochs, ForeignMaster, BusOff,
        SeveralFailures
        """
        expected, last, same, excused = self._expected, self._last, self._same, self.excused
        meaningful = self._meaningful
        is_regular = True
        for axis, reading in enumerate(epoch.readings):
            if reading is None:
                is_regular = False
            elif axis not in excused:
                word, good = reading.statusword, expected[axis]
                if odd := (word ^ good) & (_WATCHED | good) & meaningful[axis]:
                    is_regular = False
                if odd or self._odd[axis]:
                    self._odd[axis] = {
                        rule.bits: self._odd[axis].get(rule.bits, 0) + 1 for rule in _BIT_RULES if odd & rule.bits
                    }
                answer = (reading.position_count, reading.torque_word)
                if answer == last[axis]:
                    same[axis] += 1
                    if same[axis] % SAME_IN_A_ROW == 0 or self._queries:
                        is_regular = False
                else:
                    last[axis], same[axis] = answer, 0
                    self._queries.pop(axis, None)
                if word & ~good & _LEARNT:
                    expected[axis] = good | word & _LEARNT
        bus, watch = self._bus, self.watch
        has_counted = bus.foreign_count != self._foreign_seen or self.emcy.count != self._emcy_seen
        if not is_regular or has_counted or watch.contrary or watch.booted or bus.bus_off:
            self._readings = epoch.readings
            self.check_rules("enabled")
        elif epoch.sync_index % _EVERY == 0:
            self.check_rules("bus")

    def check_rules(self, scope: Scope) -> None:
        """Go through the rules of a scope: "bus", "started" by NMT, or axes "enabled"; raises as `check`."""
        for rule, measure, limit in self._rules[scope]:
            raise_failures([error for count, error in measure(rule) if count >= limit])

    # -- measures of the rules ---------------------------------------------------------------------------------------

    def _left_operational(self, rule: Rule) -> Counts:
        for node in sorted(self.watch.contrary):
            state = str(self.watch.states[node]).upper()
            yield 1, rule.raised(f"left OPERATIONAL: its heartbeat shows {state}", node=node)

    def _bus_off(self, rule: Rule) -> Counts:
        if self._bus.bus_off:
            yield 1, rule.raised(f"{self._bus.spec}: the CAN controller is bus-off")

    def _booted(self, rule: Rule) -> Counts:
        for node in sorted(self.watch.booted):
            yield 1, rule.raised("booted during the run", node=node)

    def _heartbeats_lost(self, rule: Rule) -> Counts:
        for node in sorted(self.watch.lost()):
            yield rule.limit, rule.raised("its heartbeat stopped", node=node)

    def _foreign_frames(self, rule: Rule) -> Counts:
        """Count the frames of another master since the run began, of the id with most of them."""
        self._foreign_seen = self._bus.foreign_count
        is_second = rule is DRIVE_RULES["second_master"]
        new = {
            can_id: number - self._foreign_before.get(can_id, 0)
            for can_id, number in self._bus.foreign.items()
            if (can_id in _SECOND) == is_second
        }
        for can_id in sorted(new, key=lambda each: new[each])[-1:]:
            frames = "a frame" if new[can_id] == 1 else f"{new[can_id]} frames"
            what = f"{frames} with id {can_id:03X} on {self._bus.spec} came from another master"
            yield new[can_id], rule.raised(what)

    def _left_enabled(self, rule: Rule) -> Counts:
        """Look at the state in all responses, also in those that cannot be assigned to their SYNC."""
        for axis, (drive, word) in enumerate(zip(self._exchange.drives, self._exchange.statuswords, strict=True)):
            if word is not None and axis not in self.excused and word & STATE_MASK != ENABLED_PATTERN:
                what = f"left OPERATION ENABLED: {describe(word)}"
                yield 1, rule.raised(what, node=drive.node_id, index=0x6041, code=word)

    def _unanswered(self, rule: Rule) -> Counts:
        """Count SYNCs in a row without a response, or with one that arrived after the response window."""
        for axis, count in enumerate(self._exchange.unanswered):
            if not count:
                continue
            what, kind = f"left {count} SYNCs in a row unanswered", rule
            if delayed := self._exchange.delayed_answers(axis):
                what, kind = f"{what} in time: {delayed} answers were delayed", replace(rule, advice=_BUSY)
            yield count, kind.raised(what, node=self._exchange.drives[axis].node_id)

    def _emergencies(self, rule: Rule) -> Counts:
        new, self._emcy_seen = self.emcy.count - self._emcy_seen, self.emcy.count
        sent = self.emcy.messages[-new:] if new else ()
        first = {each.node_id: each for each in reversed(sent) if not each.is_harmless}
        for node, each in sorted(first.items()):
            more = ""
            if each.code and each.register is not None and not each.register & 1:  # CiA 301: no error is present
                more = (
                    f'if the manual calls it a warning, answer `profiles new` with warning_codes = "0x{each.code:04X}"'
                )
            yield 1, rule.raised(f"sent an emergency: {each.what}", node=node, code=each.code, more=more)

    def _status_bits(self, rule: Rule) -> Counts:
        """Count SYNCs in a row with these bits unexpected; the error names all that are."""
        for axis, (reading, odd) in enumerate(zip(self._readings, self._odd, strict=True)):
            if reading is not None and rule.bits in odd and axis not in self.excused:
                rules = [each for each in _BIT_RULES if each.bits in odd]
                what = "; ".join(each.what for each in rules)
                more = "; ".join(each.advice for each in rules if each is not rule)
                node, word = reading.node_id, reading.statusword
                yield odd[rule.bits], rule.raised(what, node=node, index=0x6041, code=word, more=more)

    def _stale(self, rule: Rule) -> Counts:
        """Count identical answers that SDO contradicts; PDO and SDO are independent paths.

        SDO is not waited for: SYNC goes on, and the answer is read at the following SYNCs.
        """
        for axis, reading in enumerate(self._readings):
            if reading is None or axis in self.excused:
                continue
            same, query, drive = self._same[axis], self._queries.get(axis), self._exchange.drives[axis]
            if query is None:
                if same and same % rule.count == 0:
                    self._ask(axis, 1)
                continue
            position, torque, attempt, settled = query
            if position.value is None or torque.value is None:
                is_over = time.monotonic() > torque.until_s or position.answered and torque.answered
                if is_over and attempt < _ATTEMPTS:
                    self._ask(axis, attempt + 1)
                elif is_over:
                    what = f"gives the same answer since {same} SYNCs, and does not confirm it by SDO"
                    yield same, rule.raised(what, node=drive.node_id, code=reading.statusword)
            elif settled < SETTLED_SYNCS:
                self._queries[axis] = (position, torque, attempt, settled + 1)
            else:
                del self._queries[axis]
                allowed = drive.scale.revolutions(_SAME_REVOLUTIONS) + 1.0
                is_elsewhere = abs(position.value - reading.position_count) > allowed
                # the torque of an axis at rest is noisy: it has to differ twice
                if is_elsewhere or torque.value != reading.torque_word and same >= 2 * rule.count:
                    what = (
                        f"repeats position {reading.position_count}, torque {reading.torque_word} since {same} SYNCs; "
                        f"SDO reports position {position.value}, torque {torque.value}"
                    )
                    index, word = drive.plans[1].mapping, reading.statusword
                    yield same, rule.raised(what, node=drive.node_id, index=index, code=word)

    def _ask(self, axis: int, attempt: int) -> None:
        """Query position and torque of a drive by SDO; the answers are kept when they come."""
        access, profile = self._exchange.drives[axis].access, self._exchange.drives[axis].setup.profile
        position, torque = (
            access.sdo.post(entry.index, entry.subindex, entry.type)
            for entry in (profile.position.object, profile.torque.object)
        )
        self._queries[axis] = (position, torque, attempt, 0)
