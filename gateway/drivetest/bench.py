"""SYNC to drives that are NMT OPERATIONAL and disabled: answers to SYNC and to controlwords that energise nothing."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drives.bus import SYNC_ID, Bus
from drives.cia402 import DISABLE_VOLTAGE, SHUTDOWN, State, decode_state
from drives.clock import SyncClock
from drives.drive import Cia402Drive
from drives.errors import TransitionTimeout
from drives.heartbeat import NmtCommand, send_nmt
from drives.objects import OBJECTS
from drives.realtime import RealTime
from drives.sdo import ONCE
from gateway.drivetest.frames import FrameRecord

#: A SYNC counts if the next one follows within this share of the period: another one was delayed by this computer.
_REGULAR_SHARE: Final = 0.2
#: SYNCs that most drives do not answer in time are left out up to this share.
_DISTURBED_SHARE: Final = 0.1
#: How long a controlword may take to show in the statusword [s].
REACTION_LIMIT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class SentSync:
    """Monotonic times [s] between which the bus took a SYNC."""

    before_s: float
    after_s: float


@dataclass(frozen=True, slots=True)
class SyncSeries:
    """SYNCs with one period, and the answers of one drive to each.

    Attributes
    ----------
    period_s : float
    delays_s : tuple of (float, float)
        Bounds of the time from each SYNC to its answer, where there is one.
    missed, delayed, counted : int
        SYNCs without an answer; with one after 0.9 periods; all that were sent on time.
    surplus : int
        Answers beyond one per SYNC.
    """

    period_s: float
    delays_s: tuple[tuple[float, float], ...]
    missed: int
    delayed: int
    counted: int
    surplus: int


#: Share of the period after which an answer counts as delayed.
DELAYED_SHARE: Final = 0.9


class SyncBench:
    """SYNC and controlwords to disabled drives.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
        Configured, disabled.
    record : FrameRecord
    """

    def __init__(self, bus: Bus, drives: Sequence[Cia402Drive], record: FrameRecord) -> None:
        self.drives, self.record = tuple(drives), record
        self._bus, self._frame = bus, bus.prepare(SYNC_ID, 0)

    def command(self, command: NmtCommand, wait_s: float) -> float:
        """Send an NMT command to every drive and listen; return when it was sent (monotonic)."""
        at_s = time.monotonic()
        for drive in self.drives:
            send_nmt(self._bus, command, drive.node_id)
        self._bus.listen(wait_s)
        return at_s

    def sync(self) -> SentSync:
        """Send one SYNC."""
        before_s = time.monotonic()
        self._bus.send_frame(self._frame)
        return SentSync(before_s, time.monotonic())

    def series(self, period_s: float, count: int) -> list[SyncSeries]:
        """Send SYNCs in real time and gather the answers; one series per drive."""
        clock, sent = SyncClock(self._bus, period_s), list[SentSync]()
        with RealTime():
            for _ in range(count):
                due_s = clock.wait()
                sent.append(self.sync())
                clock.sent(due_s)
        self._bus.listen(2.0 * period_s)
        return count_answers([self._answers(drive, sent) for drive in self.drives], sent, period_s)

    def _answers(self, drive: Cia402Drive, sent: Sequence[SentSync]) -> list[list[float]]:
        """Return the times of the answers of a drive to each SYNC [s]."""
        came = [frame.at_s for frame in self.record.of(drive.answers[0][0], sent[0].before_s)]
        ends = [*(sync.before_s for sync in sent[1:]), math.inf]
        windows = [[at for at in came if sync.before_s <= at < end] for sync, end in zip(sent, ends, strict=True)]
        for own, following in zip(windows, windows[1:], strict=False):
            if not own and len(following) > 1:  # two answers to the next SYNC: the first belongs to this one
                own.append(following.pop(0))
        return windows

    def reaction(self, drive: Cia402Drive, trials: int) -> list[tuple[float, float]]:
        """Measure the time from the SYNC that makes a controlword effective until the statusword shows its state.

        The commands are SHUTDOWN and DISABLE VOLTAGE in turn: neither energises the axis.

        Returns
        -------
        list of (float, float)
            Bounds of each trial [s]: the last poll that showed the old state, the first that showed the new one.

        Raises
        ------
        TransitionTimeout
            The statusword does not follow.
        """
        bounds: list[tuple[float, float]] = []
        try:
            for number in range(trials):
                shuts = number % 2 == 0
                target = State.READY_TO_SWITCH_ON if shuts else State.SWITCH_ON_DISABLED
                self._send(drive, SHUTDOWN if shuts else DISABLE_VOLTAGE)
                bounds.append(self._until(drive, target, self.sync()))
        finally:
            self._send(drive, DISABLE_VOLTAGE)
            self.sync()
            self._bus.listen(0.005)
        return bounds

    def _send(self, drive: Cia402Drive, controlword: int) -> None:
        drive.hold(drive.access.read(drive.setup.profile.position.object))
        self._bus.send_frame(drive.frame(controlword))

    def _until(self, drive: Cia402Drive, target: State, sync: SentSync) -> tuple[float, float]:
        """Poll the statusword by SDO until it shows a state."""
        least_s = 0.0
        while (asked_s := time.monotonic()) < sync.after_s + REACTION_LIMIT_S:
            if decode_state(drive.access.read(OBJECTS["statusword"], ONCE)) is target:
                return least_s, time.monotonic() - sync.before_s
            least_s = max(0.0, asked_s - sync.after_s)
        what = f"does not reach {target} within {REACTION_LIMIT_S} s of the controlword"
        raise TransitionTimeout(what, node=drive.node_id, index=0x6041, advice="read its error history 0x1003")


def count_answers(answers: Sequence[list[list[float]]], sent: Sequence[SentSync], period_s: float) -> list[SyncSeries]:
    """Return the series of each drive.

    Parameters
    ----------
    answers : sequence of lists of lists of float
        Of each drive and SYNC, the times of the answers [s].
    sent : sequence of SentSync
    period_s : float
    """
    on_time = _regular(sent, period_s) & _undisturbed(answers, sent, period_s)
    return [_counted(each, sent, period_s, on_time) for each in answers]


def _regular(sent: Sequence[SentSync], period_s: float) -> frozenset[int]:
    """Return the SYNCs that the next one followed after one period: no delay of this computer between them."""
    gaps = [after.before_s - sync.before_s for sync, after in zip(sent, sent[1:], strict=False)]
    return frozenset(
        number for number, gap_s in enumerate([*gaps, period_s]) if abs(gap_s - period_s) <= _REGULAR_SHARE * period_s
    )


def _is_delayed(own: Sequence[float], sync: SentSync, period_s: float) -> bool:
    return bool(own) and own[0] - sync.after_s > DELAYED_SHARE * period_s


def _undisturbed(answers: Sequence[list[list[float]]], sent: Sequence[SentSync], period_s: float) -> frozenset[int]:
    """Return the SYNCs that were not disturbed on the bus or in this computer.

    A SYNC is disturbed if more than half of the drives answer it with a delay or not at all. Where that happens often,
    it is a property of the drives, and no SYNC is left out.
    """
    bad = [
        number
        for number, sync in enumerate(sent)
        if sum(not own[number] or _is_delayed(own[number], sync, period_s) for own in answers) > len(answers) / 2
    ]
    often = len(bad) > _DISTURBED_SHARE * len(sent)
    return frozenset(range(len(sent))) - frozenset(() if often or len(answers) == 1 else bad)


def _counted(
    windows: Sequence[Sequence[float]], sent: Sequence[SentSync], period_s: float, regular: frozenset[int]
) -> SyncSeries:
    """Return the series of one drive from its answers to each SYNC."""
    answered = [(sync, own[0]) for sync, own in zip(sent, windows, strict=True) if own]
    return SyncSeries(
        period_s,
        tuple((at_s - sync.after_s, at_s - sync.before_s) for sync, at_s in answered),
        missed=sum(not windows[number] for number in regular),
        delayed=sum(_is_delayed(windows[number], sent[number], period_s) for number in regular),
        counted=len(regular),
        surplus=sum(max(0, len(own) - 1) for own in windows),
    )
