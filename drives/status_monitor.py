"""Monitor emergencies, statusword bits and repeated identical answers of the drives.

Each of them stops all axes. The readings of a drive are invalid when it limits the torque, has a following error, is
controlled by its panel or repeats old values.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from drives.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, INTERNAL_LIMIT, REMOTE
from drives.emcy import EmcyLog
from drives.epoch import Epoch
from drives.errors import DriveError, raise_failures
from drives.exchange import SyncExchange
from drives.reactions import DRIVE_RULES
from drives.sdo import Posted
from drives.values import DriveReading

#: SYNCs in a row that a bit has to be set, in lockstep: a single one may be a transition.
BITS_IN_A_ROW: Final = DRIVE_RULES["internal_limit"].count
#: SYNCs in a row with an identical answer before the drive is queried by SDO.
SAME_IN_A_ROW: Final = DRIVE_RULES["stale"].count
#: Largest difference between SDO and the repeated answer, in motor revolutions.
SAME_REVOLUTIONS: Final = 0.002
#: Real time: number of queries before a missing answer counts as an error.
ATTEMPTS: Final = 2
#: Real time: SYNCs that the answer to SYNC has to stay the same after SDO has reported another value.
SETTLED_SYNCS: Final = 2

_MASK: Final = INTERNAL_LIMIT | FOLLOWING_ERROR | REMOTE
_GOOD: Final = REMOTE
_BITS: Final = (
    (INTERNAL_LIMIT, INTERNAL_LIMIT, DRIVE_RULES["internal_limit"]),
    (FOLLOWING_ERROR, FOLLOWING_ERROR, DRIVE_RULES["following_error"]),
    (REMOTE, 0, DRIVE_RULES["not_remote"]),
    (FOLLOWS_COMMAND, 0, DRIVE_RULES["not_following"]),
)


class StatusMonitor:
    """Monitor of EMCY messages, statusword bits and repeated values while the axes are enabled.

    Parameters
    ----------
    exchange : SyncExchange
    emcy : EmcyLog
    """

    def __init__(self, exchange: SyncExchange, emcy: EmcyLog) -> None:
        self._exchange = exchange
        self._emcy = emcy
        self._seen_count = 0
        timing = exchange.timing
        self._bits_in_a_row = DRIVE_RULES["internal_limit"].syncs(timing.period_s, timing.pacing)
        self._odd: list[int] = []
        #: Expected bits by axis. Not every drive sets bit 12 in a cyclic mode: it is expected once it was seen.
        self._good: list[int] = []
        self._same: list[int] = []
        self._last: list[tuple[int, int] | None] = []
        #: Real time: pending SDO queries, and the number of queries.
        self._open: dict[int, tuple[Posted, Posted, int]] = {}
        self._waited: dict[int, int] = {}
        self.forgive()

    def forgive(self) -> None:
        """Reset the monitor for a new run."""
        self._seen_count = self._emcy.count
        axes = len(self._exchange.drives)
        self._odd, self._same, self._last = [0] * axes, [0] * axes, [None] * axes
        self._good = [_GOOD] * axes
        self._open.clear()

    def forgive_cleared(self) -> None:
        """Forgive emergencies since the start if every node that sent one has reported the error as cleared."""
        new = self._emcy.count - self._seen_count
        if new and all(each.is_reset for each in {each.node_id: each for each in self._emcy.messages[-new:]}.values()):
            self._seen_count = self._emcy.count

    def forget(self, axis: int) -> None:
        """Reset the monitoring of one axis (from 0): its drive is going to leave OPERATION ENABLED."""
        self._odd[axis], self._same[axis], self._last[axis], self._good[axis] = 0, 0, None, _GOOD
        self._open.pop(axis, None)

    def check(self, epoch: Epoch) -> None:
        """Check the epoch of one SYNC.

        Raises
        ------
        DriveFault, SeveralFailures
            An emergency, a statusword bit, or a stale answer.
        SdoError
            A drive does not confirm its answer.
        """
        if self._emcy.count != self._seen_count:
            self._check_emergencies()
        for axis, reading in enumerate(epoch.readings):
            if reading is None:
                continue
            good = self._good[axis]
            if reading.statusword & (_MASK | good) != good:
                self._odd[axis] += 1
                if self._odd[axis] >= self._bits_in_a_row:
                    raise_failures(_odd_bits(epoch, self._good))
            elif self._odd[axis]:
                self._odd[axis] = 0
            self._good[axis] |= reading.statusword & FOLLOWS_COMMAND
            answer = (reading.position_count, reading.torque_word)
            if answer != self._last[axis]:
                self._last[axis] = answer
                self._same[axis] = 0
                self._open.pop(axis, None)
            else:
                self._same[axis] += 1
                if axis in self._open:
                    self._look_up(axis, reading)
                elif self._same[axis] % SAME_IN_A_ROW == 0:
                    self._confirm(axis, reading)

    def _check_emergencies(self) -> None:
        new, self._seen_count = self._emcy.count - self._seen_count, self._emcy.count
        rule = DRIVE_RULES["emergency"]
        first = {each.node_id: each for each in reversed(self._emcy.messages[-new:]) if not each.is_reset}
        raise_failures(
            [
                rule.raised(f"sent an emergency: {each.what}", node=node_id, code=each.code)
                for node_id, each in sorted(first.items())
            ]
        )

    def _confirm(self, axis: int, reading: DriveReading) -> None:
        """Query by SDO the value that a drive keeps answering; PDO and SDO are independent paths.

        In real time there is no wait for the answer: SYNC goes on, and the answer is read at the following SYNCs.
        """
        if self._exchange.timing.pacing == "real":
            self._ask(axis, 1)
            return
        drive = self._exchange.drives[axis]
        profile = drive.setup.profile
        position, torque = drive.access.read(profile.position.object), drive.access.read(profile.torque.object)
        self._compare(axis, reading, position, torque)

    def _ask(self, axis: int, attempt: int) -> None:
        drive = self._exchange.drives[axis]
        profile, post = drive.setup.profile, drive.access.sdo.post
        position, torque = (
            post(entry.index, entry.subindex, entry.type) for entry in (profile.position.object, profile.torque.object)
        )
        self._open[axis] = (position, torque, attempt)
        self._waited[axis] = 0

    def _look_up(self, axis: int, reading: DriveReading) -> None:
        position, torque, attempt = self._open[axis]
        if position.value is not None and torque.value is not None:
            # An axis that has just begun to move shows it by SDO before it shows it at the next SYNCs.
            self._waited[axis] += 1
            if self._waited[axis] > SETTLED_SYNCS:
                del self._open[axis]
                self._compare(axis, reading, position.value, torque.value)
        elif time.monotonic() > torque.until_s or position.answered and torque.answered:
            del self._open[axis]
            if attempt < ATTEMPTS:
                self._ask(axis, attempt + 1)
                return
            raise DRIVE_RULES["stale"].raised(
                f"gives the same answer since {self._same[axis]} SYNCs, and does not confirm it by SDO",
                node=self._exchange.drives[axis].node_id,
                code=reading.statusword,
            )

    def _compare(self, axis: int, reading: DriveReading, position: int, torque: int) -> None:
        drive = self._exchange.drives[axis]
        allowed = drive.scale.revolutions(SAME_REVOLUTIONS) + 1.0
        if abs(position - reading.position_count) <= allowed and torque == reading.torque_word:
            return
        if abs(position - reading.position_count) <= allowed and self._same[axis] < 2 * SAME_IN_A_ROW:
            return
        raise DRIVE_RULES["stale"].raised(
            f"repeats position {reading.position_count}, torque {reading.torque_word} since {self._same[axis]} SYNCs; "
            f"SDO reports position {position}, torque {torque}",
            node=drive.node_id,
            index=drive.plans[1].mapping,
            code=reading.statusword,
        )


def _odd_bits(epoch: Epoch, expected: Sequence[int]) -> list[DriveError]:
    failures: list[DriveError] = []
    for reading, good in zip(epoch.readings, expected, strict=True):
        if reading is None or reading.statusword & (_MASK | good) == good:
            continue
        bits = [each for each in _BITS if each[0] & (_MASK | good)]
        first, *others = [rule for mask, value, rule in bits if reading.statusword & mask == value]
        what = "; ".join(rule.what for rule in (first, *others))
        more = "; ".join(rule.advice for rule in others)
        failures.append(first.raised(what, node=reading.node_id, index=0x6041, code=reading.statusword, more=more))
    return failures
