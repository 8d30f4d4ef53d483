"""SYNC epochs: the TPDOs that respond to one SYNC, complete or marked incomplete, never filled with older values.

TPDOs carry no SYNC number, but each node responds in order. A missing TPDO may still be in transit, and would be taken
for the answer to the next SYNC. Its frames are not assigned until as many have come as SYNCs were sent, or until three
SYNCs in a row have brought exactly one frame each, as soon as usual: then the missing one is lost.

In lockstep simulated time does not pass while a second frame is waited for, so a frame that stays alone is assigned.
The missing one counts as lost after more SYNCs, because they are sent faster.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from drives.bus import Bus, Frame
from drives.sdo import Posted, SdoClient
from drives.values import DriveReading, InstrumentReading

#: SYNCs in a row with exactly one frame, in the usual time, after which a missing frame counts as lost: in real time,
#: and in lockstep, where they take half a second.
_AS_USUAL: Final = 3
_AS_USUAL_LOCKSTEP: Final = 200
#: What the usual time of an answer is multiplied with, and what is added, for an answer to be as soon as usual.
_SLOW: Final = 4.0
_SLACK_S: Final = 0.001
#: In lockstep: shortest time in which a second frame of an unassigned TPDO is waited for [s].
_SECOND_S: Final = 0.002
#: Share of a new row in the usual time.
_NEW: Final = 0.1


@dataclass(slots=True)
class _Unassigned:
    """State of one TPDO whose frames cannot be assigned to a SYNC at present.

    Attributes
    ----------
    owed : int
        SYNCs since the first unanswered one, less the frames that have come.
    came : int
        Frames since the last SYNC.
    usual : bool
        Whether all of these came as soon as usual.
    in_a_row : int
        SYNCs in a row with exactly one frame as soon as usual.
    """

    owed: int
    came: int = 0
    usual: bool = True
    in_a_row: int = 0


class Alignment:
    """Tracks for each TPDO whether its next frame responds to the last SYNC.

    Parameters
    ----------
    lockstep : bool
    """

    def __init__(self, *, lockstep: bool = False) -> None:
        #: By slot, those of which it is not known.
        self.unassigned: dict[int, _Unassigned] = {}
        self._usual_s: float | None = None
        self._lost_after = _AS_USUAL_LOCKSTEP if lockstep else _AS_USUAL

    @property
    def second_s(self) -> float:
        """Return how long a second frame is waited for in lockstep [s]."""
        return max(_SECOND_S, _SLOW * (self._usual_s or 0.0))

    def learn(self, row_s: float) -> None:
        """Record the time from a SYNC until all its TPDOs were received [s]."""
        self._usual_s = row_s if self._usual_s is None else self._usual_s + _NEW * (row_s - self._usual_s)

    def came(self, slot: int, after_s: float) -> None:
        """Record a frame of an unassigned TPDO and its time after the last SYNC [s] (negative = before it)."""
        state = self.unassigned[slot]
        state.came += 1
        state.usual &= 0.0 <= after_s <= _SLOW * (self._usual_s or 0.0) + _SLACK_S

    def end(self, frames: Sequence[object | None]) -> None:
        """Evaluate the responses to the last SYNC, delayed ones included, before the next SYNC is sent."""
        for slot, state in tuple(self.unassigned.items()):
            state.owed += 1 - state.came
            state.in_a_row = state.in_a_row + 1 if state.came == 1 and state.usual else 0
            if state.owed <= 0 or state.in_a_row >= self._lost_after:
                del self.unassigned[slot]
            else:
                state.came, state.usual = 0, True
        if None in frames:
            for slot, data in enumerate(frames):
                if data is None and slot not in self.unassigned:
                    self.unassigned[slot] = _Unassigned(owed=1)


#: Largest plausible age of a time stamp [s]; a larger one means that a clock was set.
_CLOCK_SET_S: Final = 10.0
#: A process that wakes with this delay was itself stalled, and answers received meanwhile are still to be read [s].
_OVERSLEPT_S: Final = 0.001
#: Where the answers on another bus were waited for first: what those on this one are given at least [s].
_BESIDE_S: Final = 0.002
#: In lockstep: share of the time-out that a drive is waited for once others have answered.
_OTHERS: Final = 0.4
#: In lockstep: interval at which a drive is queried again, and at which it is looked whether it has answered [s].
_ASK_AGAIN_S: Final = 0.1
_LOOK_S: Final = 0.001


class Epoch(NamedTuple):
    """Readings of all axes at one SYNC; a tuple, as `DriveReading`.

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


class EpochCollector:
    """Collects the TPDOs that respond to one SYNC.

    TPDOs carry no number, so what arrives outside `collect` belongs to an earlier SYNC: it is counted and dropped. So
    is a frame with a time stamp before its SYNC. Other frames that may answer an earlier SYNC are not assigned
    (`Alignment`). Of two different frames of one TPDO after one SYNC neither is assigned. The slot then stays
    empty, and `frames` holds the frame.

    In lockstep simulated time does not pass while an answer is missing, so the window is extended. A drive that has not
    answered in it is queried by SDO, until it has answered by TPDO or SDO. The window passes again before the next
    SYNC. For a frame that is delayed even longer, the SYNCs that follow are listened to for some time more: where it
    contradicts the answer to that SYNC, neither is assigned.

    Parameters
    ----------
    bus : Bus
    slots : sequence of (int, int)
        CAN id and length of each expected TPDO.
    window_s : float
        How long an answer counts after the SYNC; in lockstep until the drive is queried.
    lockstep : sequence of SdoClient, optional
        In lockstep the SDO client of each slot's node; without them in real time.
    """

    def __init__(
        self, bus: Bus, slots: Sequence[tuple[int, int]], window_s: float, lockstep: Sequence[SdoClient] = ()
    ) -> None:
        #: Irregular TPDO frames by kind: late, duplicate, ambiguous, wrong_length, unsure.
        self.counts: Counter[str] = Counter()
        #: Answers that came after their SYNC was closed, or may have, by slot.
        self.delayed_count_by_slot = [0] * len(slots)
        #: What came since the last SYNC, assigned or not.
        self.frames: list[bytes | bytearray | None] = [None] * len(slots)
        #: In lockstep: longest wait for a drive that answers neither SYNC nor the SDO query [s].
        self.answer_timeout_s = 0.0
        self._alignment = Alignment(lockstep=bool(lockstep))
        self._bus = bus
        self._window_s = window_s
        self._lockstep = tuple(lockstep)
        self._slot_of = {can_id: slot for slot, (can_id, _) in enumerate(slots)}
        self._sizes = tuple(size for _, size in slots)
        self._contradicted: set[int] = set()
        #: A SYNC was sent whose answers `sweep` has not evaluated.
        self._open = False
        #: Wall clock time of the last SYNC: frames stamped before it are older; -inf = unknown.
        self._sent_s = -math.inf
        self._sent_wall_s = -math.inf
        for can_id in self._slot_of:
            bus.subscribe(can_id, self._on_stray)

    def close(self) -> None:
        """Stop listening."""
        for can_id in self._slot_of:
            self._bus.unsubscribe(can_id, self._on_stray)

    def restart(self) -> None:
        """Reset the state for a new run, in which no TPDO is in transit."""
        self._alignment.unassigned.clear()
        self._open = False

    def sweep(self) -> None:
        """Read, before the next SYNC, the frames that have arrived; in lockstep wait for those that are missing."""
        self._bus.drain()
        if not self._open:
            return
        self._open = False
        if self._lockstep and None in self.frames:
            until_s = time.monotonic() + self._window_s
            while None in self.frames and (left_s := until_s - time.monotonic()) > 0:
                frame = self._bus.receive(left_s)
                if frame is not None:
                    self._bus.dispatch(frame)
        if self._alignment.unassigned or None in self.frames:
            self._alignment.end(self.frames)

    def collect(self, sent_s: float, sent_wall_s: float) -> list[bytes | bytearray | None]:
        """Collect the answers to the SYNC that was just sent; the caller holds the bus's receive lock.

        Parameters
        ----------
        sent_s, sent_wall_s : float
            When that was sent, by the monotonic clock, and read before it was sent by the wall clock.

        Returns
        -------
        list of bytes or None
            One per slot, in the order of `slots`; None = none, or one that cannot be assigned to this SYNC.
        """
        self._sent_s = sent_s
        self._sent_wall_s = sent_wall_s if self._bus.stamped else -math.inf
        self.frames = [None] * len(self._sizes)
        self._contradicted.clear()
        self._open = True
        alignment, window_s = self._alignment, self._window_s
        until_s = max(sent_s + window_s, time.monotonic() + min(window_s, _BESIDE_S))
        left = self._gather(len(self._sizes), until_s)
        slept_s = time.monotonic() - until_s
        if left and slept_s > _OVERSLEPT_S:
            left = self._gather(left, time.monotonic() + min(slept_s, window_s))
        if left and self._lockstep:
            left = self._pursue(left)
        if alignment.unassigned:
            if self._lockstep:  # one more than are empty, so that the whole time is listened to
                self._gather(left + 1, time.monotonic() + alignment.second_s)
        elif not left and slept_s < 0.0:
            alignment.learn(time.monotonic() - sent_s)
        if not self._contradicted and not alignment.unassigned:
            return self.frames
        dropped = set(self._contradicted)
        if not self._lockstep:
            dropped |= alignment.unassigned.keys()
            for slot, state in alignment.unassigned.items():
                self.counts["unsure"] += state.came
                self.delayed_count_by_slot[slot] += state.came
        return [None if slot in dropped else data for slot, data in enumerate(self.frames)]

    def _gather(self, left: int, deadline_s: float) -> int:
        """Fill the slots until all are filled or the deadline passes; return how many are empty."""
        slot_of, sizes, receive, clock = self._slot_of.get, self._sizes, self._bus.receive, time.monotonic
        frames, unassigned, sent_wall_s = self.frames, self._alignment.unassigned, self._sent_wall_s
        timeout_s = max(deadline_s - clock(), 0.0)  # the process may have slept past it
        while left:
            frame = receive(timeout_s)
            if frame is not None:
                slot = slot_of(frame.arbitration_id)
                if slot is None:
                    self._bus.dispatch(frame)
                elif len(frame.data) != sizes[slot]:
                    self.counts["wrong_length"] += 1
                elif frames[slot] is None and frame.timestamp >= sent_wall_s and not unassigned:
                    frames[slot] = frame.data
                    left -= 1
                else:
                    left -= self._take_irregular(slot, frame)
            timeout_s = deadline_s - clock()
            if timeout_s <= 0:
                break
        return left

    def _take_irregular(self, slot: int, frame: Frame) -> bool:
        """Handle a frame that may be a second one, or respond to an earlier SYNC; return whether it fills its slot."""
        after_s = frame.timestamp - self._sent_wall_s
        is_older = -_CLOCK_SET_S <= after_s < 0.0
        is_unassigned = slot in self._alignment.unassigned
        if is_unassigned:
            is_stamped = abs(after_s) < _CLOCK_SET_S
            self._alignment.came(slot, after_s if is_stamped else time.monotonic() - self._sent_s)
        elif is_older:
            self._count_delayed(slot)
        if not is_older and self.frames[slot] is None:
            self.frames[slot] = frame.data
            return True
        if not is_older and (self._lockstep or not is_unassigned):
            self._take_again(slot, frame.data)
        return False

    def _count_delayed(self, slot: int) -> None:
        self.counts["late"] += 1
        self.delayed_count_by_slot[slot] += 1

    def _take_again(self, slot: int, data: bytes | bytearray) -> None:
        """Handle a second frame of one TPDO after one SYNC."""
        self.counts["duplicate"] += 1
        if self.frames[slot] != data:
            self.counts["ambiguous"] += 1
            self._contradicted.add(slot)

    def _pursue(self, left: int) -> int:
        """Query the drives that have not answered, and wait until each has answered by TPDO or SDO.

        A drive that has answered the query has sent its TPDO before: it was lost. One that has not may only be slow.
        Only time in which this process was ready to receive counts: simulated drives may be stalled with it.
        """
        patience_s = self.answer_timeout_s * (1.0 if left == len(self._sizes) else _OTHERS)
        now, ask_s = time.monotonic(), 0.0
        asked: dict[SdoClient, Posted] = {}
        while left and patience_s > 0.0:
            missing = {sdo for sdo, data in zip(self._lockstep, self.frames, strict=True) if data is None}
            if now >= ask_s:
                asked = {sdo: sdo.ask() for sdo in missing}
                ask_s = now + _ASK_AGAIN_S
            elif all(asked[sdo].answered for sdo in missing):
                break
            wait_s = min(_LOOK_S, ask_s - now, patience_s)
            left = self._gather(left, now + wait_s)
            before, now = now, time.monotonic()
            patience_s -= min(now - before, wait_s)
        return left

    def _on_stray(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        """Count a TPDO that arrives outside the response window of a SYNC."""
        slot = self._slot_of[can_id]
        if len(data) != self._sizes[slot]:
            self.counts["wrong_length"] += 1
        elif slot in self._alignment.unassigned:
            self._count_delayed(slot)
            self._alignment.came(slot, math.inf)
            self.frames[slot] = self.frames[slot] or data
        elif self.frames[slot] is None:
            self.frames[slot] = data
            self._count_delayed(slot)
        else:
            self._take_again(slot, data)
