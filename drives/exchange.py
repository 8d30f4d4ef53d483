"""Cyclic SYNC exchange: send the RPDOs, send SYNC, and collect the TPDOs of all drives as one epoch."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from drives.bus import SYNC_ID, Bus, Frame
from drives.busload import LOAD_LIMIT_PERCENT
from drives.cia402 import ENABLE_OPERATION, WARNING, State, decode_state
from drives.clock import LockstepClock, SyncClock, spare_collections
from drives.drive import Cia402Drive
from drives.epoch import Epoch, EpochCollector
from drives.heartbeat import HeartbeatProducer
from drives.instrument import Instrument, InstrumentSetup
from drives.reactions import DRIVE_RULES
from drives.scaling import Decoder, Frames, reading_decoder
from drives.standstill import Standstill
from drives.values import DriveReading

Pacing = Literal["lockstep", "real"]

#: Longest wait for a drive that does not respond while the others have to be stopped.
_HURRY_S: Final = 0.1
#: Real time: share of the SYNC period in which an answer counts.
_WINDOW: Final = 0.9
#: SYNCs in a row with unassigned answers until the axis counts as not responding.
_MAX_UNASSIGNABLE: Final = 10


@dataclass(frozen=True, slots=True)
class GroupOptions:
    """Times and limits of a group; the defaults suit six drives.

    Attributes
    ----------
    ledger_path : Path, optional
        File of the write ledger, for a restore after a crash.
    answer_timeout_s : float
        Lockstep: longest wait for a drive that answers neither SYNC nor the SDO query.
    gap_timeout_s : float
        Lockstep: how long answers are waited for until that query is sent, and again before the next SYNC.
    unanswered_syncs : int or None
        SYNCs in a row that an axis may leave unanswered; None = as the table of reactions says.
    load_limit_percent : float
        Real time: largest planned worst-case bus load.
    instruments : tuple of InstrumentSetup
        Measuring devices on the same bus, read at each SYNC.
    allow_real_drive : bool
        A real drive may be driven over a network interface (udp_multicast, virtual, socketcand), although any computer
        there can send frames. Lockstep stays refused.
    """

    ledger_path: Path | None = None
    answer_timeout_s: float = 1.0
    gap_timeout_s: float = 0.02
    unanswered_syncs: int | None = None
    load_limit_percent: float = LOAD_LIMIT_PERCENT
    instruments: tuple[InstrumentSetup, ...] = ()
    allow_real_drive: bool = False


@dataclass(frozen=True, slots=True)
class Timing:
    """Period and pacing of the SYNC exchange.

    Attributes
    ----------
    period_s : float
        Time between two SYNCs; in lockstep the simulated time of one SYNC.
    pacing : "lockstep" or "real"
        Next SYNC as soon as all have answered, or in real time.
    options : GroupOptions
        Its time-outs.
    """

    period_s: float
    pacing: Pacing = "lockstep"
    options: GroupOptions = GroupOptions()

    def clock(self, bus: Bus) -> SyncClock:
        """Return a clock of this pacing, whose SYNC has not begun."""
        return (SyncClock if self.pacing == "real" else LockstepClock)(bus, self.period_s)


class SyncExchange:
    """Sender of SYNC cycles, and state of the drives as last reported.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
    timing : Timing
    heartbeat : HeartbeatProducer
        The master's heartbeat goes out before the commands, when it is due; a command that is not confirmed stops it.
    first_index : int
        SYNC index before the first one.
    instruments : sequence of Instrument
        Measuring devices whose TPDOs answer the same SYNC; an epoch is complete without them.
    """

    def __init__(
        self,
        bus: Bus,
        drives: Sequence[Cia402Drive],
        timing: Timing,
        heartbeat: HeartbeatProducer,
        first_index: int = 0,
        instruments: Sequence[Instrument] = (),
    ) -> None:
        self.drives = tuple(drives)
        self.timing = timing
        self.sync_index = first_index
        #: State of each axis by its last answer; None before the first.
        self.states: list[State | None] = [None] * len(self.drives)
        #: SYNCs in a row that each axis left unanswered.
        self.unanswered = [0] * len(self.drives)
        #: Statusword of each axis in what came since the last SYNC, assigned to it or not; None = nothing came.
        self.statuswords: list[int | None] = [None] * len(self.drives)
        #: Tests of rest of each axis.
        self.standstills: list[Standstill] = []
        #: Last known position of each axis, counts; None before the first.
        self.position_count: list[int | None] = [None] * len(self.drives)
        #: An axis was commanded to enable since this was last reset.
        self.powered = False
        #: How far each axis moved after it was last disabled, motor rad.
        self.brake_drop_rad = (0.0,) * len(self.drives)
        self.cycles = 0
        self.incomplete = 0
        #: Answers in which a drive warns.
        self.warnings = 0
        self.started_s: float | None = None
        #: Monotonic time of the last SYNC.
        self.sent_s = 0.0
        slots: list[tuple[int, int]] = []
        self._first_slots = []
        for drive in self.drives:
            self._first_slots.append(len(slots))
            slots += drive.answers
            for plan in drive.commands:
                bus.watch_master_id(plan.cob_id)
        owners = [drive.access.sdo for drive in self.drives for _ in drive.answers]
        self._instruments: list[tuple[Instrument, int]] = []
        for instrument in instruments:
            self._instruments.append((instrument, len(slots)))
            slots += instrument.answers
            owners += [instrument.access.sdo] * len(instrument.answers)
        self.clock = timing.clock(bus)
        if timing.pacing == "real":
            self.collector = EpochCollector(bus, slots, _WINDOW * timing.period_s)
        else:
            self.collector = EpochCollector(bus, slots, timing.options.gap_timeout_s, owners)
        self._decoders: tuple[Decoder, ...] = ()
        self._unassignable = [0] * len(self.drives)
        #: Delayed answers of each axis when it began to leave SYNCs unanswered.
        self._delayed_before = [0] * len(self.drives)
        #: Whether the SYNC before has moved an axis; of the cycle that was begun, whether this one will, or both.
        self._moved = self._moves = self._moving = False
        #: Of the cycle that was begun: by which thread, whether its answers are assigned, when its SYNC was due and
        #: when the bus took it.
        self._begun_by: int | None = None
        self._certain = True
        self._due_s = self._began_s = self._wall_s = 0.0
        #: Targets of the last SYNC, while those of the next one are being sent; empty = nothing is being sent.
        self._recall: list[int] = []
        #: RPDO1 of all axes, then the second ones.
        self._frames: list[Frame] = [frame for each in self.drives for frame in each.frames]
        self._frames.sort(key=lambda frame: frame.arbitration_id >> 8)
        self._bus = bus
        self.heartbeat = heartbeat
        self._sync_frame = bus.prepare(SYNC_ID, 0)

    def close(self) -> None:
        """Stop listening."""
        self.collector.close()
        if self.timing.pacing == "real":
            gc.unfreeze()

    @property
    def sync_time_s(self) -> float:
        """Return the number of SYNCs times the period [s]."""
        return self.sync_index * self.timing.period_s

    def restart(self) -> None:
        """Reset phase and counters for a new run with configured drives."""
        self._decoders = tuple(
            reading_decoder(drive.setup, drive.scale, slot)
            for drive, slot in zip(self.drives, self._first_slots, strict=True)
        )
        self.clock.restart()
        self.collector.restart()
        self.collector.answer_timeout_s = self.timing.options.answer_timeout_s
        axes = len(self.drives)
        self.unanswered, self._unassignable, self._moved = [0] * axes, [0] * axes, False
        self.position_count = [None] * axes
        self.standstills = [Standstill(drive.scale.revolutions(1.0)) for drive in self.drives]
        if self.timing.pacing == "real":
            spare_collections()

    def delayed_answers(self, axis: int) -> int:
        """Return the number of delayed answers of an axis (from 0) since it began to leave SYNCs unanswered."""
        return self._delayed(axis) - self._delayed_before[axis]

    def _delayed(self, axis: int) -> int:
        first = self._first_slots[axis]
        return sum(self.collector.delayed_count_by_slot[first : first + len(self.drives[axis].answers)])

    def is_at_rest(self, axis: int) -> bool:
        """Return whether an axis (from 0) was at rest at the last SYNCs."""
        return self.standstills[axis].at_rest()

    def hurry(self) -> None:
        """Shorten the time-outs for missing responses from now on, because the axes have to be stopped."""
        self.collector.answer_timeout_s = min(_HURRY_S, self.timing.options.answer_timeout_s)

    def cycle(self, words: Sequence[int] | None) -> Epoch:
        """Run one SYNC cycle with these controlwords and the staged setpoints; None = SYNC without RPDOs.

        Raises
        ------
        BusError
            A frame could not be sent.
        MasterStalled
            In real time: the axes move, and the SYNC would be sent more than two periods after it was due. It was not
            sent; the last targets are those of the SYNC before, and the next SYNC is due at once.
        """
        try:
            self.begin(words)
            self.prepare()
            self.sync()
            return self.gather()
        finally:
            self.abandon()

    def begin(self, words: Sequence[int] | None) -> None:
        """First part of a cycle: send the staged commands; parameters and errors as `cycle`.

        `prepare`, `sync` and `gather` follow in this thread, or `abandon` if anything fails; no other thread receives
        until then.
        """
        self._bus.receive_lock.acquire()
        self._begun_by = threading.get_ident()
        self.heartbeat.tick()
        self._recall = recall = []
        self._moves = self._moving = False
        for drive, word, state in () if words is None else zip(self.drives, words, self.states, strict=True):
            before = drive.target_count
            recall.append(before)
            drive.pack(word, state)
            if word == ENABLE_OPERATION:
                self.powered = True
                self._moves |= drive.target_count != before and state is State.OPERATION_ENABLED
                self._moving = self._moves or self._moved
        self._refuse_overdue()
        for frame in () if words is None else self._frames:
            self._bus.send_frame(frame)

    def prepare(self, due_s: float | None = None) -> float:
        """Second part: wait until the SYNC is due, and read delayed answers.

        Parameters
        ----------
        due_s : float, optional
            As another exchange that sends its SYNC at the same time has returned it [monotonic s].

        Returns
        -------
        float
            When it was due [monotonic s].

        Raises
        ------
        MasterStalled
            As `cycle`.
        """
        if due_s is None:
            due_s = self.clock.wait()
        else:
            self.clock.follow(due_s)
        self.collector.sweep()
        self._refuse_overdue()
        self._certain = self.clock.paused_s <= self.timing.period_s
        self._due_s = due_s
        return due_s

    def sync(self) -> None:
        """Third part: send the SYNC; raises `BusError`."""
        self._wall_s = time.time()
        self.sync_index += 1
        began_s = time.monotonic()
        delay_s = self._bus.send_frame(self._sync_frame)
        self._recall = []
        self.sent_s = time.monotonic()
        self.clock.sent(self._due_s, delay_s)
        self._began_s = began_s + delay_s
        self._wall_s += delay_s
        self._moved = self._moves

    def gather(self) -> Epoch:
        """Fourth part: collect the responses as an epoch; raises `BusError` if the adapter fails."""
        frames: Frames = self.collector.collect(self.sent_s, self._wall_s)
        if not self._certain:
            frames = [None] * len(frames)
        if self.started_s is None:
            self.started_s = self._due_s
        index = self.sync_index
        time_s = self.clock.time_s(index, self._began_s - self.started_s)
        beside = tuple([instrument.decode(index, frames, slot) for instrument, slot in self._instruments])
        epoch = Epoch(index, time_s, self._row(frames), beside)
        self.cycles += 1
        self.abandon()
        return epoch

    def abandon(self) -> None:
        """Abandon a cycle that this thread has begun: commands not yet sent with a SYNC are discarded."""
        if self._begun_by != threading.get_ident():
            return
        for drive, count in zip(self.drives, self._recall, strict=False):  # fewer, if one could not be packed
            drive.target_count = count
        self._recall = []
        self._begun_by = None
        self._bus.receive_lock.release()

    def _refuse_overdue(self) -> None:
        """Refuse an overdue setpoint while axes move, because it would be a jump; at rest it is accepted."""
        if not self._moving:
            return
        rule, paused_s = DRIVE_RULES["stalled"], self.clock.paused_s
        if paused_s > rule.limit * self.timing.period_s:
            self.clock.restart()
            raise rule.raised(f"this computer stalled for {paused_s:.3f} s while the arm moved")

    def _row(self, frames: Frames) -> tuple[DriveReading | None, ...]:
        index, unanswered, time_s = self.sync_index, self.unanswered, self.sync_time_s
        statuswords, counts, unassignable = self.statuswords, self.position_count, self._unassignable
        row: list[DriveReading | None] = []
        missing = False
        for axis, (decode, standstill) in enumerate(zip(self._decoders, self.standstills, strict=True)):
            reading = decode(index, frames)
            row.append(reading)
            if reading is None:
                missing = True
                self._without(axis, decode)
                continue
            word, count = reading.statusword, reading.position_count
            unanswered[axis] = unassignable[axis] = 0
            if word != statuswords[axis]:
                self._see_statusword(axis, word)
            if word & WARNING:
                self.warnings += 1
            counts[axis] = count
            standstill.see(time_s, count)
        self.incomplete += missing
        return tuple(row)

    def _see_statusword(self, axis: int, word: int) -> None:
        self.statuswords[axis], self.states[axis] = word, decode_state(word)

    def _without(self, axis: int, decode: Decoder) -> None:
        """Count a SYNC without an assigned answer: as missing, or as received but not assignable."""
        if not self.unanswered[axis]:
            self._delayed_before[axis] = self._delayed(axis)
        came = decode(self.sync_index, self.collector.frames)
        if came is None:
            self.statuswords[axis] = None
            self.unanswered[axis] += 1
            return
        self._see_statusword(axis, came.statusword)
        self._unassignable[axis] += 1
        self.unanswered[axis] = self.unanswered[axis] + 1 if self._unassignable[axis] > _MAX_UNASSIGNABLE else 0
