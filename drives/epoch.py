"""SYNC epochs: the TPDOs that respond to one SYNC, complete or marked incomplete, never filled with older values."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from drives.alignment import Alignment
from drives.bus import Bus, Frame
from drives.values import DriveReading, InstrumentReading

#: How long an answer that stayed away is reckoned with.
_ASTRAY_S: Final = 0.5
#: How soon after a stray answer the true one follows at the latest, s, or in usual times of a row.
_SECOND_S: Final = 0.002
_SLOW: Final = 4.0
_ASK_AGAIN_S: Final = 0.1
#: Largest plausible age of a time stamp [s]; a larger one means that a clock was set.
_CLOCK_SET_S: Final = 10.0
#: In real time: a process that wakes with this delay was itself stalled, and answers received meanwhile are still to be
#: read [s].
_OVERSLEPT_S: Final = 0.001
#: Where the answers on another bus were waited for first: what those on this one are given at least [s].
_BESIDE_S: Final = 0.002
#: Share of the time-out that a drive is waited for once others have answered.
_OTHERS: Final = 0.4


class Inquiry(Protocol):
    """Interface of an SDO query to drives whose TPDO is missing."""

    def ask(self, slots: Sequence[int]) -> None:
        """Send the query to the drives of these slots."""
        ...

    def answered(self, slot: int) -> bool:
        """Return whether the drive of a slot has responded to the query."""
        ...


@dataclass(frozen=True, slots=True)
class Epoch:
    """Readings of all axes at one SYNC.

    Attributes
    ----------
    sync_index : int
        Number of the SYNC, from 1.
    time_s : float
        Lockstep: SYNC index times period; real time: when this SYNC was sent, counted from the first one.
    readings : tuple of DriveReading or None
        One per axis; None = this axis gave no answer, or one that cannot be assigned to this SYNC.
    instruments : tuple of InstrumentReading or None
        The same, one per measuring device beside the drives.
    """

    sync_index: int
    time_s: float
    readings: tuple[DriveReading | None, ...]
    instruments: tuple[InstrumentReading | None, ...] = ()

    @property
    def complete(self) -> bool:
        """Return whether every axis responded to this SYNC."""
        return all(reading is not None for reading in self.readings)

    @property
    def missing(self) -> tuple[int, ...]:
        """Return the axes (from 0) without a reading."""
        return tuple(axis for axis, reading in enumerate(self.readings) if reading is None)


@dataclass(slots=True)
class EpochCounts:
    """Numbers of irregular TPDO frames."""

    late: int = 0
    duplicate: int = 0
    ambiguous: int = 0
    wrong_length: int = 0
    unsure: int = 0


class EpochCollector:
    """Collects the TPDOs that respond to one SYNC.

    TPDOs carry no number, so what arrives outside `collect` belongs to an earlier SYNC: it is counted and dropped.

    In lockstep the next SYNC waits in `settle` until no answer to the last one should be in transit. A frame that is
    delayed even longer could be taken for the answer to a later SYNC. For half a second that slot is therefore checked
    for a second frame; two different frames of one TPDO within one SYNC leave the slot empty.

    In real time there is no wait. A frame with a time stamp before its SYNC answers an earlier SYNC. Other frames that
    may do so are not assigned (`drives.alignment`): the slot stays empty, `frames` holds the frame.

    Parameters
    ----------
    bus : Bus
    slots : sequence of (int, int)
        CAN id and length of each expected TPDO.
    inquiry : Inquiry, optional
        How to ask a drive that has not answered.
    """

    def __init__(self, bus: Bus, slots: Sequence[tuple[int, int]], inquiry: Inquiry | None = None) -> None:
        self._inquiry = inquiry
        self.counts = EpochCounts()
        #: Answers that came after their SYNC was closed, or may have, by slot.
        self.delayed_count_by_slot = [0] * len(slots)
        #: What came since the last SYNC, assigned or not.
        self.frames: list[bytes | bytearray | None] = [None] * len(slots)
        self.alignment = Alignment()
        self._bus = bus
        self._slot_of = {can_id: slot for slot, (can_id, _) in enumerate(slots)}
        self._sizes = tuple(size for _, size in slots)
        self._contradicted: set[int] = set()
        self._unsettled = False
        #: Slots whose answer to an earlier SYNC may still come, and until when.
        self._astray: dict[int, float] = {}
        self._usual_s = 0.0
        #: Wall clock time of the last SYNC: frames stamped before it are older; -inf = unknown.
        self._sent_s = -math.inf
        self._sent_wall_s = -math.inf
        for can_id in self._slot_of:
            bus.subscribe(can_id, self._on_stray)

    def close(self) -> None:
        """Stop listening."""
        for can_id in self._slot_of:
            self._bus.unsubscribe(can_id, self._on_stray)

    def collect(self, timeout_s: float, gap_s: float) -> list[bytes | bytearray | None]:
        """In lockstep: answers to the SYNC that was just sent; the caller holds the bus's receive lock.

        A drive whose answer is missing is queried by SDO. If it answers, its TPDO was lost; if not, it may only be slow
        and the wait goes on.

        Parameters
        ----------
        timeout_s : float
            Longest wait after the SYNC.
        gap_s : float
            Longest wait for the next answer until the missing drives are queried.

        Returns
        -------
        list of bytes or None
            One per slot, in the order of `slots`; None = none, or two that contradict each other.
        """
        start = time.monotonic()
        left = self._begin()
        gap_s = max(gap_s, _SLOW * self._usual_s)
        left = self._gather(left, start + gap_s, gap_s)
        if left:
            left = self._pursue(left, timeout_s if left == len(self._sizes) else _OTHERS * timeout_s)
        else:
            self._usual_s += 0.1 * (time.monotonic() - start - self._usual_s)
        if self._astray:
            self._listen_for_strays(time.monotonic() + max(_SECOND_S, _SLOW * self._usual_s))
        return self._end(left)

    def collect_within(self, window_s: float, sent_s: float, sent_wall_s: float) -> list[bytes | bytearray | None]:
        """Collect in real time the answers to the SYNC that was just sent; the caller holds the bus's receive lock.

        Parameters
        ----------
        window_s : float
            How long an answer counts after the SYNC.
        sent_s, sent_wall_s : float
            When that was sent, by the monotonic clock, and read before it was sent by the wall clock.

        Returns
        -------
        list of bytes or None
            One per slot, in the order of `slots`; None = none, or one that cannot be assigned to this SYNC.
        """
        self._sent_s = sent_s
        self._sent_wall_s = sent_wall_s if self._bus.stamped else -math.inf
        left = self._begin()
        self.alignment.begin()
        until_s = max(sent_s + window_s, time.monotonic() + min(window_s, _BESIDE_S))
        left = self._gather(left, until_s, None)
        slept_s = time.monotonic() - until_s
        if left and slept_s > _OVERSLEPT_S:
            left = self._gather(left, time.monotonic() + min(slept_s, window_s), None)
        astray = self.alignment.astray
        if not left and not astray and slept_s < 0.0:
            self.alignment.learn(time.monotonic() - sent_s)
        row = self._end(left)
        return [None if slot in astray else data for slot, data in enumerate(row)] if astray else row

    def sweep(self) -> None:
        """Read in real time, before the next SYNC, the frames that have arrived."""
        self._bus.drain()
        self.alignment.end(self.frames)

    def _begin(self) -> int:
        self.frames = [None] * len(self._sizes)
        if self._contradicted:
            self._contradicted.clear()
        self._unsettled = True
        return len(self._sizes)

    def _end(self, left: int) -> list[bytes | bytearray | None]:
        self._unsettled = left > 0 or bool(self._contradicted)
        if self._contradicted:
            return [None if slot in self._contradicted else data for slot, data in enumerate(self.frames)]
        return self.frames

    def _gather(self, left: int, deadline_s: float, gap_s: float | None) -> int:
        """Fill the slots until all are filled or the deadline passes; `gap` extends the deadline with each answer."""
        slot_of, sizes, receive, clock = self._slot_of.get, self._sizes, self._bus.receive, time.monotonic
        frames, astray, sent_wall_s = self.frames, self.alignment.astray, self._sent_wall_s
        timeout_s = max(deadline_s - clock(), 0.0)  # the process may have slept past it
        while left:
            frame = receive(timeout_s)
            if frame is not None:
                slot = slot_of(frame.arbitration_id)
                if slot is None:
                    self._bus.dispatch(frame)
                elif len(frame.data) != sizes[slot]:
                    self.counts.wrong_length += 1
                elif frame.timestamp < sent_wall_s and self._is_older(slot, frame.timestamp):
                    self._count_delayed(slot)
                elif frames[slot] is None:
                    frames[slot] = frame.data
                    left -= 1
                    if astray:
                        self._hold_unassigned(slot, frame.timestamp)
                    if gap_s is not None:
                        deadline_s = clock() + gap_s
                        timeout_s = gap_s
                        continue
                elif slot not in astray:
                    self._again(slot, frame.data)
                else:
                    self._hold_unassigned(slot, frame.timestamp)
            timeout_s = deadline_s - clock()
            if timeout_s <= 0:
                break
        return left

    def _is_older(self, slot: int, stamp_s: float) -> bool:
        """Return whether a frame with a time stamp before the SYNC responds to an earlier one (no clock was set)."""
        if stamp_s < self._sent_wall_s - _CLOCK_SET_S:
            return False
        if slot in self.alignment.astray:
            self.alignment.came(slot, stamp_s - self._sent_wall_s)
        return True

    def _count_delayed(self, slot: int) -> None:
        self.counts.late += 1
        self.delayed_count_by_slot[slot] += 1

    def _hold_unassigned(self, slot: int, stamp_s: float) -> None:
        """Store a frame that may respond to an earlier SYNC if its slot is unassigned."""
        if slot in self.alignment.astray:
            self.counts.unsure += 1
            self.delayed_count_by_slot[slot] += 1
            after_s = stamp_s - self._sent_wall_s
            if not 0.0 <= after_s < _CLOCK_SET_S:
                after_s = time.monotonic() - self._sent_s
            self.alignment.came(slot, after_s)

    def _pursue(self, left: int, patience_s: float) -> int:
        """Query the drives that have not answered, and wait until each has answered by TPDO or SDO.

        Only time in which this process was ready to receive counts: simulated drives may be stalled with it.
        """
        inquiry = self._inquiry
        if inquiry is None:
            return self._gather(left, time.monotonic() + patience_s, None)
        now, ask_s = time.monotonic(), 0.0
        while left and patience_s > 0.0:
            missing = [slot for slot, data in enumerate(self.frames) if data is None]
            if now >= ask_s:
                inquiry.ask(missing)
                ask_s = now + _ASK_AGAIN_S
            elif all(inquiry.answered(slot) for slot in missing):
                break
            wait_s = min(ask_s - now, patience_s)
            frame = self._bus.receive(wait_s)
            if frame is not None and self._take(frame):
                left -= 1
            before, now = now, time.monotonic()
            patience_s -= min(now - before, wait_s)
        return left

    def _take(self, frame: Frame) -> bool:
        """Assign a frame to its slot; return whether it filled one."""
        slot = self._slot_of.get(frame.arbitration_id)
        if slot is None:
            self._bus.dispatch(frame)
        elif len(frame.data) != self._sizes[slot]:
            self.counts.wrong_length += 1
        elif self.frames[slot] is None:
            self.frames[slot] = frame.data
            return True
        else:
            self._again(slot, frame.data)
            self._astray.pop(slot, None)
        return False

    def _listen_for_strays(self, deadline_s: float) -> None:
        """Watch for a second frame, because this epoch may contain a response to an earlier SYNC."""
        now = time.monotonic()
        self._astray = {slot: until_s for slot, until_s in self._astray.items() if until_s > now}
        while self._astray and (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._bus.receive(left_s)
            if frame is not None:
                self._take(frame)

    def _again(self, slot: int, data: bytes | bytearray) -> None:
        """Handle a second frame of one TPDO within one SYNC."""
        self.counts.duplicate += 1
        if self.frames[slot] != data:
            self.counts.ambiguous += 1
            self._contradicted.add(slot)

    def _on_stray(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        """Count a TPDO that arrives outside the response window of a SYNC."""
        slot = self._slot_of[can_id]
        if len(data) != self._sizes[slot]:
            self.counts.wrong_length += 1
        elif slot in self.alignment.astray:
            self._count_delayed(slot)
            self.alignment.came(slot, math.inf)
            self.frames[slot] = self.frames[slot] or data
        elif self.frames[slot] is None:
            self.frames[slot] = data
            self._count_delayed(slot)
        else:
            self.counts.duplicate += 1
            if self.frames[slot] != data:
                self.counts.ambiguous += 1
                self._unsettled = True
                self._astray.pop(slot, None)

    def settle(self, quiet_s: float) -> None:
        """In lockstep, before the next SYNC: after a missing answer, wait until it has arrived or counts as lost.

        Parameters
        ----------
        quiet_s : float
            Longest wait for a missing frame.
        """
        self._bus.drain()
        if not self._unsettled:
            return
        deadline = time.monotonic() + quiet_s
        with self._bus.receive_lock:
            while (left := deadline - time.monotonic()) > 0:
                frame = self._bus.receive(left)
                if frame is not None:
                    self._bus.dispatch(frame)
                if not self._contradicted and None not in self.frames:
                    break
        now = time.monotonic()
        self._astray |= {slot: now + _ASTRAY_S for slot, data in enumerate(self.frames) if data is None}
        self._unsettled = False
