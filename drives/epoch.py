"""SYNC epochs: the TPDOs of one SYNC in one row, complete or marked incomplete, never filled from a cache."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drives.bus import Bus
from drives.values import DriveReading

#: How long an answer that stayed away is reckoned with.
_ASTRAY_S: Final = 0.5
_PATIENCE_S: Final = 0.002


@dataclass(frozen=True, slots=True)
class Epoch:
    """One row.

    Attributes
    ----------
    sync_index : int
        Number of the SYNC, from 1.
    time_s : float
        Lockstep: SYNC index times period; by the clock: when this SYNC was sent, from the first one on.
    readings : tuple of DriveReading or None
        One per axis; None = this axis gave no answer, or one that cannot be assigned to this SYNC.
    """

    sync_index: int
    time_s: float
    readings: tuple[DriveReading | None, ...]

    @property
    def complete(self) -> bool:
        """Whether every axis answered this SYNC."""
        return all(reading is not None for reading in self.readings)

    @property
    def missing(self) -> tuple[int, ...]:
        """Axes (from 0) without a reading."""
        return tuple(axis for axis, reading in enumerate(self.readings) if reading is None)


@dataclass(slots=True)
class EpochCounts:
    """What was not as it should be, in frames."""

    late: int = 0
    duplicate: int = 0
    ambiguous: int = 0
    wrong_length: int = 0


class EpochCollector:
    """Gathers the TPDOs that answer one SYNC.

    TPDOs carry no number, so what arrives outside `collect` belongs to an earlier SYNC: it is counted and dropped, and
    the next SYNC waits in `settle` until nothing of the last one should be under way any more. A frame that stays away
    even longer could pass for the answer to a later SYNC: for half a second that slot is watched for a second frame,
    and two different frames of one TPDO within one SYNC contradict each other: the slot stays empty.

    Parameters
    ----------
    bus : Bus
    slots : sequence of (int, int)
        CAN id and length of each expected TPDO.
    """

    def __init__(self, bus: Bus, slots: Sequence[tuple[int, int]]) -> None:
        self.counts = EpochCounts()
        self.frames: list[bytes | bytearray | None] = [None] * len(slots)
        self._bus = bus
        self._slot_of = {can_id: slot for slot, (can_id, _) in enumerate(slots)}
        self._sizes = tuple(size for _, size in slots)
        self._contradicted: set[int] = set()
        self._unsettled = False
        #: Slots whose answer to an earlier SYNC may still come, and until when.
        self._astray: dict[int, float] = {}
        self._usual_s = 0.0
        for can_id in self._slot_of:
            bus.subscribe(can_id, self._on_stray)

    def close(self) -> None:
        """Stop listening."""
        for can_id in self._slot_of:
            self._bus.unsubscribe(can_id, self._on_stray)

    def collect(self, timeout_s: float, gap_s: float | None) -> list[bytes | bytearray | None]:
        """Wait for the answers to the SYNC that was just sent; the caller holds the bus's receive lock.

        Parameters
        ----------
        timeout_s : float
            Longest wait for the first answer; with `gap_s` None, for all of them.
        gap_s : float or None
            Once one has answered: longest wait for the next.

        Returns
        -------
        list of bytes or None
            One per slot, in the order of `slots`; None = none, or two that contradict each other.
        """
        slot_of, sizes, receive, clock = self._slot_of.get, self._sizes, self._bus.receive, time.monotonic
        frames: list[bytes | bytearray | None] = [None] * len(sizes)
        self.frames = frames
        if self._contradicted:
            self._contradicted.clear()
        left = len(sizes)
        start = clock()
        deadline = start + timeout_s
        self._unsettled = True
        while left:
            frame = receive(timeout_s)
            if frame is not None:
                slot = slot_of(frame.arbitration_id)
                if slot is None:
                    self._bus.dispatch(frame)
                elif len(frame.data) != sizes[slot]:
                    self.counts.wrong_length += 1
                elif frames[slot] is None:
                    frames[slot] = frame.data
                    left -= 1
                    if gap_s is not None:
                        deadline = clock() + gap_s
                        timeout_s = gap_s
                        continue
                else:
                    self._again(slot, frame.data)
            timeout_s = deadline - clock()
            if timeout_s <= 0:
                break
        if left == 0:
            self._usual_s += 0.1 * (clock() - start - self._usual_s)
        if self._astray:
            self._listen_for_strays(deadline if gap_s is None else clock() + self._patience_s(gap_s))
        self._unsettled = left > 0 or bool(self._contradicted)
        if self._contradicted:
            return [None if slot in self._contradicted else data for slot, data in enumerate(frames)]
        return frames

    def _patience_s(self, gap_s: float) -> float:
        """How long after a row is full the true answer may follow one that was astray."""
        return min(gap_s, max(_PATIENCE_S, 4.0 * self._usual_s))

    def _listen_for_strays(self, deadline_s: float) -> None:
        """The row is full, but an answer to an earlier SYNC may be in it: does a second one come?"""
        now = time.monotonic()
        self._astray = {slot: until_s for slot, until_s in self._astray.items() if until_s > now}
        while self._astray and (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._bus.receive(left_s)
            if frame is None:
                continue
            slot = self._slot_of.get(frame.arbitration_id)
            if slot is None or len(frame.data) != self._sizes[slot]:
                self._bus.dispatch(frame)
            elif self.frames[slot] is None:
                self.frames[slot] = frame.data
            else:
                self._again(slot, frame.data)
                self._astray.pop(slot, None)

    def _again(self, slot: int, data: bytes | bytearray) -> None:
        """A second frame of one TPDO within one SYNC."""
        self.counts.duplicate += 1
        if self.frames[slot] != data:
            self.counts.ambiguous += 1
            self._contradicted.add(slot)

    def _on_stray(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        """A TPDO that arrives while no SYNC is being answered."""
        slot = self._slot_of[can_id]
        if len(data) != self._sizes[slot]:
            self.counts.wrong_length += 1
        elif self.frames[slot] is None:
            self.frames[slot] = data
            self.counts.late += 1
        else:
            self.counts.duplicate += 1
            if self.frames[slot] != data:
                self.counts.ambiguous += 1
                self._unsettled = True
                self._astray.pop(slot, None)

    def settle(self, quiet_s: float) -> None:
        """Before the next SYNC: take in what has arrived; after a gap also wait until what is missing is here or gone.

        Parameters
        ----------
        quiet_s : float
            Longest wait for a missing frame; 0 = only what has arrived.
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
