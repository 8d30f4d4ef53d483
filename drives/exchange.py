"""The SYNC exchange: commands out, SYNC, one row of answers in."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from drives.bus import SYNC_ID, Bus
from drives.busload import cycle_bits_worst
from drives.cia402 import State, decode_state
from drives.clock import SyncClock, spare_collections
from drives.decode import Decoder
from drives.drive import Cia402Drive
from drives.epoch import Epoch, EpochCollector
from drives.heartbeat import HeartbeatProducer
from drives.instrument import Instrument
from drives.sdo import SdoClient
from drives.values import DriveReading, InstrumentReading

Pacing = Literal["lockstep", "real"]

#: Longest wait for a silent drive while the others have to be stopped.
_HURRY_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Timing:
    """When SYNCs are sent and answers count.

    Attributes
    ----------
    period_s : float
        Time between two SYNCs; in lockstep the time that a SYNC stands for.
    pacing : "lockstep" or "real"
        Next SYNC as soon as all have answered, or by the clock.
    answer_timeout_s : float
        Lockstep: longest wait for a drive that answers neither the SYNC nor the question whether it is there.
    gap_timeout_s : float
        Lockstep: longest wait for the next answer until that question is asked, and before the next SYNC for what is
        missing.
    window : float
        By the clock: share of the SYNC period in which an answer counts.
    """

    period_s: float
    pacing: Pacing = "lockstep"
    answer_timeout_s: float = 1.0
    gap_timeout_s: float = 0.02
    window: float = 0.9


class _Inquiry:
    """Asks nodes by SDO."""

    def __init__(self, sdo_of_slot: Sequence[SdoClient]) -> None:
        self._sdo = tuple(sdo_of_slot)

    def ask(self, slots: Sequence[int]) -> None:
        """Ask the nodes that these slots belong to, each once."""
        for sdo in {id(self._sdo[slot]): self._sdo[slot] for slot in slots}.values():
            sdo.ask()

    def answered(self, slot: int) -> bool:
        """Whether the node of a slot has answered the question."""
        return not self._sdo[slot].asked


class SyncExchange:
    """One SYNC after the other.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
    timing : Timing
    producer : HeartbeatProducer
        The master's heartbeat goes out before the commands, when it is due.
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
        producer: HeartbeatProducer,
        first_index: int = 0,
        instruments: Sequence[Instrument] = (),
    ) -> None:
        self.drives = tuple(drives)
        self.timing = timing
        self.sync_index = first_index
        #: State of each axis by its last answer; None before the first.
        self.states: list[State | None] = [None] * len(self.drives)
        #: SYNCs in a row that each axis left unanswered.
        self.silent = [0] * len(self.drives)
        self.cycles = 0
        self.incomplete = 0
        self.started_s: float | None = None
        #: Monotonic time of the last SYNC.
        self.sent_s = 0.0
        self.clock = SyncClock(bus, timing.period_s)
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
        self.collector = EpochCollector(bus, slots, _Inquiry(owners))
        #: Worst-case bits of one cycle.
        commands = [plan.size_bytes for drive in self.drives for plan in drive.commands]
        self.cycle_bits = cycle_bits_worst([0, *(size for _, size in slots), *commands])
        self._feeding = tuple(drive for drive in self.drives if drive.setup.feedforward)
        self._decoders: tuple[Decoder, ...] = ()
        self._answer_timeout_s = timing.answer_timeout_s
        self._bus = bus
        self._producer = producer
        self._sync_frame = bus.prepare(SYNC_ID, 0)

    def close(self) -> None:
        """Stop listening."""
        self.collector.close()
        if self.timing.pacing == "real":
            gc.unfreeze()

    @property
    def sync_time_s(self) -> float:
        """Time that the SYNCs so far stand for."""
        return self.sync_index * self.timing.period_s

    def restart(self) -> None:
        """Begin a new run with configured drives: rhythm, silence and patience start afresh."""
        self._decoders = tuple(drive.decoder(slot) for drive, slot in zip(self.drives, self._first_slots, strict=True))
        self.clock.restart()
        self.silent = [0] * len(self.drives)
        self._answer_timeout_s = self.timing.answer_timeout_s
        if self.timing.pacing == "real":
            spare_collections()

    def hurry(self) -> None:
        """From now on wait less for a drive that may only be slow: something has to be stopped."""
        self._answer_timeout_s = min(_HURRY_S, self.timing.answer_timeout_s)

    def cycle(self, words: Sequence[int] | None) -> Epoch:
        """One SYNC with these controlwords and what each drive has staged; None = the SYNC alone.

        Raises
        ------
        BusError
            A frame could not be sent.
        """
        timing, collector = self.timing, self.collector
        with self._bus.receive_lock:
            self._producer.tick(self.sync_time_s)
            if timing.pacing == "lockstep":
                collector.settle(timing.gap_timeout_s)
                self._send_commands(words)
                now = self._send_sync(time.monotonic())
                time_s = self.sync_time_s
                frames = collector.collect(self._answer_timeout_s, timing.gap_timeout_s)
            else:
                self._send_commands(words)
                now = self.clock.wait()
                collector.settle(0.0)
                self._send_sync(now)
                time_s = now - (now if self.started_s is None else self.started_s)
                frames = collector.collect(timing.window * timing.period_s, None)
        if self.started_s is None:
            self.started_s = now
        self.cycles += 1
        return Epoch(self.sync_index, time_s, self._row(frames), self._beside(frames))

    def _send_commands(self, words: Sequence[int] | None) -> None:
        if words is not None:
            send = self._bus.send_frame
            for drive, word in zip(self.drives, words, strict=True):
                send(drive.frame(word))
            for drive in self._feeding:
                frame = drive.offset_frame()
                if frame is not None:
                    send(frame)

    def _send_sync(self, now_s: float) -> float:
        self.sync_index += 1
        self._bus.send_frame(self._sync_frame)
        self.sent_s = time.monotonic()
        return now_s

    def _beside(self, frames: list[bytes | bytearray | None]) -> tuple[InstrumentReading | None, ...]:
        index = self.sync_index
        return tuple(instrument.decode(index, frames, slot) for instrument, slot in self._instruments)

    def _row(self, frames: list[bytes | bytearray | None]) -> tuple[DriveReading | None, ...]:
        index, states, silent = self.sync_index, self.states, self.silent
        row: list[DriveReading | None] = []
        missing = False
        for axis, decode in enumerate(self._decoders):
            reading = decode(index, frames)
            row.append(reading)
            if reading is None:
                silent[axis] += 1
                missing = True
            else:
                silent[axis] = 0
                states[axis] = decode_state(reading.statusword)
        self.incomplete += missing
        return tuple(row)
