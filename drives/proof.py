"""Stop tests of the drives: loss of the master's heartbeat, quick stop, and holding brake of one axis.

CiA 301 7.2.8.3.2.2 (heartbeat consumer, 0x1016) and CiA 402-2 (abort connection option, 0x6007) define the required
reaction. The test shows whether this drive, with this firmware and wiring, has it.

A test neither sends nor waits. It returns the controlwords of the next SYNC and reads the answers, while the motion
loop sends its setpoints as in any other motion (`DriveGroup.exchange` and `hold`). Stop requests and limits are
therefore checked at every SYNC of a test too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final, Protocol

from drives.cia402 import (
    AT_REST,
    ENABLE_OPERATION,
    NoRoute,
    State,
    decode_state,
    disabling_controlword,
    enabling_controlword,
    stopping_controlword,
)
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, DriveFault, TransitionTimeout
from drives.exchange import SyncExchange
from drives.sdo import ONCE
from drives.standstill import BRAKE_WATCH_S, BrakeDrop, Standstill
from drives.stopping import DOWN, PATIENCE_S, RAMP_S

#: SYNCs without an answer after which an axis is asked by SDO: a drive may leave NMT state OPERATIONAL (0x1029).
_SILENT: Final = 2
#: SYNCs after which a drive that was commanded to hold its axis again gets the position that it has reached meanwhile.
_ENABLE_SYNCS: Final = 3
#: States from which one controlword each leads to OPERATION ENABLED.
_LADDER: Final = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)


class DriveTest(Protocol):
    """Interface of a stop test, called by the drive group at every SYNC.

    Attributes
    ----------
    excused : frozenset of int
        Axes (from 0) that may leave OPERATION ENABLED.
    guards : bool
        The other axes are monitored as in any motion; else only the bus is.
    """

    @property
    def excused(self) -> frozenset[int]: ...

    @property
    def guards(self) -> bool: ...

    def controlwords(self) -> list[int]:
        """Return the controlwords of the next SYNC; called once per SYNC."""
        ...

    def held_count(self, axis: int) -> int | None:
        """Return the commanded position of an axis [counts]; None = the setpoint of the motion."""
        ...

    def see(self, epoch: Epoch) -> None:
        """Process the readings of one SYNC."""
        ...


@dataclass(frozen=True, slots=True)
class StopTrace:
    """Stop of one drive after the master's last heartbeat, or after the quick stop controlword.

    Attributes
    ----------
    node_id : int
    stated_s : float
        By when it shall have left OPERATION ENABLED: heartbeat time and one SYNC; two SYNCs after the word.
    enabled_s : float
        Last SYNC in OPERATION ENABLED, s after the last heartbeat or the controlword.
    left_s : float or None
        First SYNC in another state; None = it stayed enabled until the master stopped it.
    state : State
        Which state it went to.
    moved_rad, coast_rad : float
        Largest motor angle travelled since the last heartbeat or the controlword, and since it was last enabled.
    stood : bool
        Whether it came to rest.
    rest_s : float
        Last SYNC with motion, s after the last heartbeat or the quick stop controlword.
    samples : tuple of (float, int, bool)
        Every position read: time of its SYNC [s] from the first one of the test, and position [counts]. False: it was
        read by SDO after that SYNC. The samples of a quick stop begin with the SYNC before the test.
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
    samples: tuple[tuple[float, int, bool], ...] = field(default=(), repr=False)

    @property
    def in_time(self) -> bool:
        """Return whether the drive left OPERATION ENABLED within the stated time, to the resolution of a SYNC."""
        return self.left_s is not None and self.enabled_s <= self.stated_s


class _Axis:
    """Observations of one drive."""

    def __init__(self, drive: Cia402Drive, stated_s: float) -> None:
        self.drive = drive
        self.stated_s = stated_s
        self.state = State.OPERATION_ENABLED
        self.enabled_s = 0.0
        self.left_s: float | None = None
        self._standstill = Standstill(drive.scale.revolutions(1.0))
        #: The axis has left OPERATION ENABLED and is at rest.
        self.stood = False
        self._samples: list[tuple[float, int, bool]] = []
        self._at_leaving = 0

    def see(self, time_s: float, state: State, count: int, is_answer: bool = True) -> None:
        """Process one reading: the answer to a SYNC, or read by SDO after it."""
        self._standstill.see(time_s, count)
        self._samples.append((time_s, count, is_answer))
        self.state = state
        if state is State.OPERATION_ENABLED and self.left_s is None:
            self.enabled_s = time_s
            self._at_leaving = len(self._samples) - 1
        elif self.left_s is None:
            self.left_s = time_s
        self.stood |= self.left_s is not None and self._standstill.at_rest(self.left_s)

    def trace(self) -> StopTrace:
        """Return the result of this drive."""
        rad, counts = self.drive.scale.count_rad, [count for _, count, _ in self._samples]
        moved = max((abs(count - counts[0]) for count in counts), default=0)
        coast = max((abs(count - counts[self._at_leaving]) for count in counts[self._at_leaving :]), default=0)
        left_s = self.left_s if self.state in AT_REST or self.state is State.QUICK_STOP_ACTIVE else None
        return StopTrace(
            node_id=self.drive.node_id,
            stated_s=self.stated_s,
            enabled_s=self.enabled_s,
            left_s=left_s,
            state=self.state,
            moved_rad=abs(rad) * moved,
            coast_rad=abs(rad) * coast,
            stood=self.stood,
            rest_s=max(0.0, self._standstill.moving_s),
            samples=tuple(self._samples),
        )


class StopTest:
    """Test that every axis leaves OPERATION ENABLED and comes to rest, until all have or the time limit has passed.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled.
    stated_s : sequence of float
        By when each axis shall have left OPERATION ENABLED.

    Attributes
    ----------
    done : bool
        The test has ended. An axis that has not left OPERATION ENABLED is commanded to stop from now on.
    """

    guards = False
    #: A drive that leaves several SYNCs unanswered is read by SDO; else `_over` ends the test.
    _reads_by_sdo = True

    def __init__(self, exchange: SyncExchange, stated_s: Sequence[float]) -> None:
        self.done = False
        self.excused = frozenset(range(len(exchange.drives)))
        self._exchange = exchange
        self._axes = [_Axis(drive, stated) for drive, stated in zip(exchange.drives, stated_s, strict=True)]
        self._begin_s: float | None = None

    @property
    def left(self) -> frozenset[int]:
        """Axes (from 0) that have left OPERATION ENABLED."""
        return frozenset(number for number, axis in enumerate(self._axes) if axis.left_s is not None)

    def controlwords(self) -> list[int]:
        """As `DriveTest.controlwords`."""
        return [
            ENABLE_OPERATION if axis.left_s is None and not self._stops(axis) else stopping_controlword(axis.state)
            for axis in self._axes
        ]

    def held_count(self, axis: int) -> int | None:
        """As `DriveTest.held_count`: an axis that has left, or is commanded to stop, keeps its last target."""
        seen = self._axes[axis]
        return seen.drive.target_count if seen.left_s is not None or self._stops(seen) else None

    def see(self, epoch: Epoch) -> None:
        """As `DriveTest.see`."""
        if self.done:
            return
        self._begin_s = epoch.time_s if self._begin_s is None else self._begin_s
        passed_s = epoch.time_s - self._begin_s
        for axis, reading, silent in zip(self._axes, epoch.readings, self._exchange.unanswered, strict=True):
            if reading is not None:
                axis.see(passed_s, decode_state(reading.statusword), reading.position_count)
            elif silent >= _SILENT and self._reads_by_sdo:
                with suppress(DriveError):
                    status, count, _ = axis.drive.read_axis(ONCE)
                    axis.see(passed_s, decode_state(status), count, is_answer=False)
        self.done = all(axis.stood for axis in self._axes) or self._over(passed_s)

    def traces(self) -> tuple[StopTrace, ...]:
        """Return the result of each axis."""
        return tuple(axis.trace() for axis in self._axes)

    def _stops(self, axis: _Axis) -> bool:
        """Return whether an axis is commanded to stop."""
        return self.done and axis.left_s is None

    def _over(self, passed_s: float) -> bool:
        """Return whether the time limit has passed."""
        longest_s = max(axis.stated_s for axis in self._axes) + PATIENCE_S
        return passed_s >= longest_s + RAMP_S or (
            passed_s > longest_s and any(axis.left_s is None for axis in self._axes)
        )


class HeartbeatLossTest(StopTest):
    """Test with the master's heartbeat withheld: every drive has to stop itself.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled; the last heartbeat is sent before the first SYNC of the test.
    """

    def __init__(self, exchange: SyncExchange) -> None:
        self._is_withheld = False
        super().__init__(exchange, [drive.loss_time_s + exchange.timing.period_s for drive in exchange.drives])

    def controlwords(self) -> list[int]:
        """As `DriveTest.controlwords`."""
        if not self._is_withheld:
            self._exchange.heartbeat.start()  # the last one, from which the drives measure their consumer time
            self._exchange.heartbeat.stop()
            self._is_withheld = True
        return super().controlwords()


class QuickStopTest(StopTest):
    """Test of the quick stop ramp of every axis.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled.
    """

    _reads_by_sdo = False

    def __init__(self, exchange: SyncExchange) -> None:
        super().__init__(exchange, [2.0 * exchange.timing.period_s] * len(exchange.drives))
        for axis, count in zip(self._axes, exchange.position_count, strict=True):
            if count is not None:
                axis.see(-exchange.timing.period_s, State.OPERATION_ENABLED, count)

    def _stops(self, axis: _Axis) -> bool:
        return axis.left_s is None

    def _over(self, passed_s: float) -> bool:
        unmoved = passed_s >= PATIENCE_S and any(axis.left_s is None for axis in self._axes)
        if unmoved or max(self._exchange.unanswered) > _SILENT:
            self._exchange.heartbeat.stop()
            return True
        return passed_s >= RAMP_S + PATIENCE_S


class BrakeTest:
    """Test of the brake of one axis: it is disabled and held by its brake, then enabled again at its position.

    It is enabled again at the first SYNC at which it has moved beyond the limit, or would have at the next one. Until
    the voltage is disabled the axis stays in SWITCHED ON, from where one controlword is enough.

    Parameters
    ----------
    exchange : SyncExchange
        All drives enabled, all axes at rest.
    axis : int
        From 0.
    limit_rad : float
        Largest motor angle that the axis may move.
    disables_voltage : bool
        After the brake's closing time the axis goes on to a state without voltage.

    Attributes
    ----------
    released_syncs : int
        SYNCs at which the axis was seen out of OPERATION ENABLED before it was to be enabled again.
    beyond_limit : bool
        The axis has moved too far.
    held : bool
        It was enabled again, and is at rest.
    """

    guards = True

    def __init__(self, exchange: SyncExchange, axis: int, limit_rad: float, disables_voltage: bool = False) -> None:
        drive = exchange.drives[axis]
        machine, period_s = drive.setup.profile.state_machine, exchange.timing.period_s
        self.released_syncs = 0
        self.beyond_limit = self.held = False
        self._exchange, self._axis, self._drive = exchange, axis, drive
        self._limit_count = limit_rad / abs(drive.scale.count_rad)
        self._closing = math.ceil(machine.brake_closing_s / period_s) if disables_voltage else None
        self._patience = math.ceil(machine.transition_timeout_s / period_s)
        self._off_syncs = math.ceil(BRAKE_WATCH_S / period_s) if disables_voltage else 0
        self._waited = 0
        self._enables = False
        self._enable_syncs, self._rung = 0, -1
        self._target = drive.target_count
        self._drop, self._most_count = BrakeDrop(exchange.position_count[axis]), 0

    @property
    def excused(self) -> frozenset[int]:
        """As `DriveTest.excused`."""
        return frozenset() if self.held else frozenset({self._axis})

    @property
    def is_watched(self) -> bool:
        """Return whether the brake held the axis without voltage for `BRAKE_WATCH_S`, where that was to be disabled."""
        return self._drop.off_syncs >= self._off_syncs

    @property
    def moved_rad(self) -> float:
        """Return the largest motor angle from the last held position while the brake had to hold the axis [rad]."""
        return self._most_count * abs(self._drive.scale.count_rad)

    @property
    def farthest_rad(self) -> float:
        """Return the largest motor angle from the last held position until the drive holds the axis again [rad]."""
        return self._drop.most_count * abs(self._drive.scale.count_rad)

    def enable_again(self) -> None:
        """Enable the drive again, which then holds the axis at its present position."""
        self._enables = True

    def controlwords(self) -> list[int]:
        """As `DriveTest.controlwords`."""
        controlwords = [ENABLE_OPERATION] * len(self._exchange.drives)
        if not self.held:
            state = self._exchange.states[self._axis] or State.UNDEFINED
            closes = self._closing is None or self.released_syncs <= self._closing
            controlwords[self._axis] = (
                self._enable_word(state) if self._enables else disabling_controlword(state, brake_closes=closes)
            )
        return controlwords

    def _enable_word(self, state: State) -> int:
        if self.beyond_limit and self._enable_syncs < _ENABLE_SYNCS and state in _LADDER:
            # it falls: the next word goes out before the state that the last one leads to was read
            self._rung = max(_LADDER.index(state), min(self._rung + 1, len(_LADDER) - 1))
            state = _LADDER[self._rung]
        try:
            word = enabling_controlword(state)
        except NoRoute as error:
            what = f"cannot be enabled again after the brake test: {error}"
            advice = "use the emergency stop if the axis falls; then check the drive and its brake"
            raise DriveFault(what, node=self._drive.node_id, index=0x6041, advice=advice) from None
        self._enable_syncs += word == ENABLE_OPERATION
        return word

    def held_count(self, axis: int) -> int | None:
        """As `DriveTest.held_count`."""
        return self._target if axis == self._axis and not self.held else None

    def see(self, epoch: Epoch) -> None:
        """As `DriveTest.see`.

        Raises
        ------
        TransitionTimeout
            The axis stays in OPERATION ENABLED, or does not come back to it.
        """
        reading = epoch.readings[self._axis]
        if reading is None or self.held:
            return
        state, before = decode_state(reading.statusword), self._drop.moved_count
        enabled = state is State.OPERATION_ENABLED
        is_held = enabled and self.released_syncs == 0 and not self._enables
        self._drop.see(reading.position_count, is_held=is_held, is_off=state in DOWN)
        if is_held:
            self._wait(f"stays in {State.OPERATION_ENABLED} although it was commanded to disable")
            return
        if not self._enables:
            moved, self._most_count = self._drop.moved_count, self._drop.most_count
            self.beyond_limit = self._enables = moved + max(moved - before, 0) > self._limit_count
        if not self._enables:
            self.released_syncs += 1
            self._target = reading.position_count
            if self._closing is not None and self.released_syncs > self._closing and not self._drop.off_syncs:
                self._wait(f"stays in {state} although its voltage was to be disabled")
            else:
                self._waited = 0
        elif enabled:
            self.held = self._exchange.is_at_rest(self._axis)
            self._wait("does not come to rest after the brake test")
        else:
            if not 0 < self._enable_syncs <= _ENABLE_SYNCS:
                self._target = reading.position_count
            self._wait("was commanded to hold its axis again after the brake test, and is not enabled")

    def _wait(self, what: str) -> None:
        self._waited += 1
        if self._waited > self._patience:
            raise TransitionTimeout(what, node=self._drive.node_id, index=0x6041, advice="check the drive")
