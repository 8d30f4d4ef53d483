"""How the drives stop, tried out: without the master's heartbeat, by the quick stop word, by the brake of one axis.

CiA 301 7.2.8.3.2.2 (heartbeat consumer, 0x1016) and CiA 402-2 (abort connection option, 0x6007) say what has to happen;
whether this drive, with this firmware and wiring, does it is only known once it was seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from drives.cia402 import (
    AT_REST,
    DISABLE_OPERATION,
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    QUICK_STOP,
    State,
    decode_state,
)
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, TransitionTimeout
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.sdo import ONCE
from drives.values import DriveCommand

#: How long after the stated time the drives are watched before the master stops them itself.
PATIENCE_S: Final = 0.2
#: Longest stop ramp that is waited for.
_RAMP_S: Final = 2.0
#: SYNCs without an answer after which an axis is asked by SDO: a drive may leave NMT state OPERATIONAL (0x1029).
_SILENT: Final = 2
#: Motor revolutions between two SYNCs that count as standing: a braked axis shakes while others are stopped.
_STILL_REVOLUTIONS: Final = 0.003
_STILL_SYNCS: Final = 3


@dataclass(frozen=True, slots=True)
class StopTrace:
    """One drive after the master's last heartbeat, or after the quick stop word.

    Attributes
    ----------
    node_id : int
    stated_s : float
        By when it shall have left OPERATION ENABLED: heartbeat time and one SYNC; two SYNCs after the word.
    enabled_s : float
        When it was last seen in OPERATION ENABLED, s after the last heartbeat or the word.
    left_s : float or None
        When it was first seen out of it; None = it went on until the master stopped it.
    state : State
        Which state it went to.
    moved_rad, coast_rad : float
        Largest motor angle travelled from the last heartbeat or the word, and from when it was last seen enabled.
    stood : bool
        Whether it came to rest.
    rest_s : float
        When it was last seen to move, s after the last heartbeat or the quick stop word.
    """

    node_id: int
    stated_s: float
    enabled_s: float
    left_s: float | None
    state: State
    moved_rad: float
    coast_rad: float
    stood: bool
    rest_s: float = 0.0

    @property
    def in_time(self) -> bool:
        """Whether it left OPERATION ENABLED within the stated time, as far as SYNCs can show."""
        return self.left_s is not None and self.enabled_s <= self.stated_s


class _Axis:
    """What is seen of one drive."""

    def __init__(self, drive: Cia402Drive, stated_s: float) -> None:
        self.drive = drive
        self.stated_s = stated_s
        self.state = State.OPERATION_ENABLED
        self.enabled_s = 0.0
        self.left_s: float | None = None
        self._still = 0
        self._moving_s = 0.0
        self._stood = False
        self._counts: list[int] = []
        self._at_leaving = 0
        self._allowed = max(1.0, drive.scale.revolutions(_STILL_REVOLUTIONS))

    @property
    def done(self) -> bool:
        """Out of operation, and come to rest."""
        return self._stood

    def see(self, time_s: float, state: State, count: int) -> None:
        """One answer."""
        if self._counts:
            self._still = self._still + 1 if abs(count - self._counts[-1]) <= self._allowed else 0
            self._moving_s = self._moving_s if self._still else time_s
        self._counts.append(count)
        self.state = state
        if state is State.OPERATION_ENABLED and self.left_s is None:
            self.enabled_s = time_s
            self._at_leaving = len(self._counts) - 1
        elif self.left_s is None:
            self.left_s, self._still = time_s, 0
        self._stood |= self.left_s is not None and self._still >= _STILL_SYNCS

    def ask(self, time_s: float) -> None:
        """The same by SDO."""
        access = self.drive.access
        try:
            state = decode_state(access.read(OBJECTS["statusword"], ONCE))
            self.see(time_s, state, access.read(self.drive.setup.profile.position.object, ONCE))
        except DriveError:
            return

    def word(self) -> int:
        """A drive that has stopped is not energised again; its ramp is not cut short."""
        if self.left_s is None:
            return ENABLE_OPERATION
        return QUICK_STOP if self.state is State.QUICK_STOP_ACTIVE else DISABLE_VOLTAGE

    def trace(self) -> StopTrace:
        """What was seen."""
        rad = self.drive.scale.count_rad
        moved = max((abs(count - self._counts[0]) for count in self._counts), default=0)
        coast = max(
            (abs(count - self._counts[self._at_leaving]) for count in self._counts[self._at_leaving :]), default=0
        )
        left_s = self.left_s if self.state in AT_REST or self.state is State.QUICK_STOP_ACTIVE else None
        return StopTrace(
            node_id=self.drive.node_id,
            stated_s=self.stated_s,
            enabled_s=self.enabled_s,
            left_s=left_s,
            state=self.state,
            moved_rad=abs(rad) * moved,
            coast_rad=abs(rad) * coast,
            stood=self.done,
            rest_s=self._moving_s,
        )


def fall_silent(
    exchange: SyncExchange, commands: Sequence[Sequence[DriveCommand]], last_words: Callable[[], None]
) -> tuple[StopTrace, ...]:
    """Send set points and SYNCs without a heartbeat and watch every drive stop.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled.
    commands : sequence of sequences of DriveCommand
        Set points, one row per SYNC; after the last one the axes are held.
    last_words : callable
        Sends the last heartbeat and no other after it.

    Raises
    ------
    DriveError
        A frame could not be sent, or a target is outside the limits.
    """
    period_s = exchange.timing.period_s
    axes = [_Axis(drive, drive.setup.profile.heartbeat.consumer_ms / 1000.0 + period_s) for drive in exchange.drives]
    longest_s = max(axis.stated_s for axis in axes) + PATIENCE_S
    rows: Iterator[Sequence[DriveCommand]] = iter(commands)
    last_words()
    begin_s: float | None = None
    passed_s = 0.0
    while passed_s < longest_s + _RAMP_S and not all(axis.done for axis in axes):
        if passed_s > longest_s and any(axis.left_s is None for axis in axes):
            break
        _stage(axes, next(rows, None))
        epoch = exchange.cycle([axis.word() for axis in axes])
        begin_s = epoch.time_s if begin_s is None else begin_s
        passed_s = epoch.time_s - begin_s
        for axis, reading, silent in zip(axes, epoch.readings, exchange.silent, strict=True):
            if reading is not None:
                axis.see(passed_s, decode_state(reading.statusword), reading.position_count)
            elif silent >= _SILENT:
                axis.ask(passed_s)
    return tuple(axis.trace() for axis in axes)


def _stage(axes: Sequence[_Axis], row: Sequence[DriveCommand] | None) -> None:
    for number, axis in enumerate(axes):
        if row is None or axis.left_s is not None:
            axis.drive.hold(axis.drive.target_count)
        else:
            axis.drive.stage(row[number])


def watch_quick_stop(exchange: SyncExchange) -> tuple[StopTrace, ...]:
    """Tell every axis to stop by its quick stop ramp and watch it come to rest.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled.

    Raises
    ------
    DriveError
        A frame could not be sent.
    """
    axes = [_Axis(drive, 2.0 * exchange.timing.period_s) for drive in exchange.drives]
    for axis, count in zip(axes, exchange.position_count, strict=True):
        if count is not None:
            axis.see(0.0, State.OPERATION_ENABLED, count)
    begin_s: float | None = None
    passed_s = 0.0
    while passed_s < _RAMP_S + PATIENCE_S and not all(axis.done for axis in axes):
        for axis in axes:
            axis.drive.hold(axis.drive.target_count)
        epoch = exchange.cycle([QUICK_STOP if axis.left_s is None else axis.word() for axis in axes])
        begin_s = epoch.time_s if begin_s is None else begin_s
        passed_s = epoch.time_s - begin_s
        for axis, reading in zip(axes, epoch.readings, strict=True):
            if reading is not None:
                axis.see(passed_s, decode_state(reading.statusword), reading.position_count)
        unmoved = passed_s >= PATIENCE_S and any(axis.left_s is None for axis in axes)
        if unmoved or max(exchange.silent) > _SILENT:
            exchange.end_heartbeat()
            break
    return tuple(axis.trace() for axis in axes)


def watch_released(exchange: SyncExchange, axis: int, seconds: float, cycle: Callable[[Sequence[int]], Epoch]) -> float:
    """Disable one axis while all others hold, and watch it.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled, all axes standing.
    axis : int
        From 0.
    seconds : float
        How long it is watched once it has left OPERATION ENABLED.
    cycle : callable
        One guarded SYNC with these controlwords.

    Returns
    -------
    float
        Largest motor angle from where the drive last held the axis, rad.

    Raises
    ------
    TransitionTimeout
        It stays in OPERATION ENABLED.
    DriveError
        As `cycle`.
    """
    drive, period_s = exchange.drives[axis], exchange.timing.period_s
    patience = math.ceil(drive.setup.profile.state_machine.transition_timeout_s / period_s)
    held_count = exchange.position_count[axis] or 0
    most_count, watched, left = 0, 0, False
    while watched * period_s < seconds:
        for each in exchange.drives:
            each.hold(each.target_count)
        state = exchange.states[axis] or State.UNDEFINED
        words = [ENABLE_OPERATION] * len(exchange.drives)
        words[axis] = DISABLE_OPERATION if state is State.OPERATION_ENABLED else DISABLE_VOLTAGE
        reading = cycle(words).readings[axis]
        if reading is not None and decode_state(reading.statusword) is not State.OPERATION_ENABLED:
            left = True
            most_count = max(most_count, abs(reading.position_count - held_count))
        elif reading is not None:
            held_count = reading.position_count
        watched, patience = watched + left, patience - (not left)
        if patience < 0:
            what = f"stays in {State.OPERATION_ENABLED} although it was told to be disabled"
            raise TransitionTimeout(what, node=drive.node_id, index=0x6041, advice="check the drive")
    return most_count * abs(drive.scale.count_rad)
