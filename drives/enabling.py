"""Enable all axes: from SWITCH ON DISABLED to an open brake, each axis holding its present position."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from drives.cia402 import NoRoute, State, next_controlword
from drives.epoch import Epoch
from drives.errors import DriveFault, StopRequested, TransitionTimeout, raise_failures
from drives.exchange import SyncExchange
from drives.guard import Guard

#: Largest movement of an axis until its brake is open, in motor revolutions: behind a gear of 100 it is 0.016 rad of
#: the joint. A drive that holds its position stays far below; one that lets its axis drop is stopped here.
BRAKE_DROP_REVOLUTIONS: Final = 0.25
#: From SWITCH ON DISABLED to OPERATION ENABLED.
_TRANSITIONS: Final = 3
#: States of the enabling sequence in ascending order.
_LADDER: Final = (
    State.NOT_READY,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
)


class EnableSequence:
    """Sequence from SWITCH ON DISABLED to an open brake, checked at every SYNC.

    No axis is enabled twice: an axis that falls back to a lower state ends the sequence. The target of each axis is its
    position before the first controlword, so that an axis that drops is pulled back.

    Parameters
    ----------
    exchange : SyncExchange
    guard : Guard
    stop_requested : callable
        Whether a person has requested a stop.
    """

    def __init__(self, exchange: SyncExchange, guard: Guard, stop_requested: Callable[[], bool]) -> None:
        machines = [drive.setup.profile.state_machine for drive in exchange.drives]
        #: Longest time that a brake takes to open.
        self.brake_s = max(machine.brake_delay_s for machine in machines)
        self._limit_s = _TRANSITIONS * max(machine.transition_timeout_s for machine in machines) + self.brake_s
        self._exchange, self._guard, self._stop_requested = exchange, guard, stop_requested
        self._since_s = 0.0
        self._held: tuple[int, ...] = ()

    def check_stop(self) -> None:
        """Raise if a person has requested a stop.

        Raises
        ------
        StopRequested
        """
        if self._stop_requested():
            raise StopRequested("a stop was requested while the drives were being enabled")

    def walk(self, start: Epoch) -> Epoch:
        """Command the transitions to OPERATION ENABLED, and return the first epoch with every axis enabled.

        Parameters
        ----------
        start : Epoch
            The last one, complete.

        Returns
        -------
        Epoch
            Complete, every axis enabled.

        Raises
        ------
        DriveFault, TransitionTimeout, IncompleteEpochs, DriveRebooted, StopRequested, SeveralFailures
        """
        exchange, epoch = self._exchange, start
        states = exchange.states
        self._since_s = self._now_s()
        self._held = tuple(reading.position_count for reading in start.readings if reading is not None)
        waited = [0] * len(states)
        while True:
            self.check_stop()
            raise_failures(_stuck(exchange, waited))
            for drive, count in zip(exchange.drives, self._held, strict=True):
                drive.hold(count)
            words = _enable_controlwords(exchange, self._guard)
            before = list(states)
            epoch = exchange.cycle(words)
            self._guard.check_bus()
            self._guard.check_operational()
            self._guard.check_unanswered()
            self._refuse_backward(before)
            self.check(epoch)
            if epoch.complete and all(state is State.OPERATION_ENABLED for state in states):
                return epoch
            for axis, state in enumerate(states):
                unchanged = state is before[axis] and state is not State.OPERATION_ENABLED
                waited[axis] = waited[axis] + 1 if unchanged else 0

    def check(self, epoch: Epoch) -> None:
        """Check the epoch of one SYNC while the brakes open.

        Raises
        ------
        DriveFault
            An axis moves away from its position.
        TransitionTimeout
            The sequence exceeds its time limit.
        StopRequested
            A person requested a stop.
        """
        self.check_stop()
        raise_failures(self._moved(epoch))
        if self._now_s() - self._since_s > self._limit_s:
            raise_failures(self._overdue(epoch))

    def _now_s(self) -> float:
        """Return the time for the limits [s]: SYNC time in lockstep, else the monotonic clock."""
        exchange = self._exchange
        return exchange.sync_time_s if exchange.timing.pacing == "lockstep" else time.monotonic()

    def _refuse_backward(self, before: Sequence[State | None]) -> None:
        failures = []
        for drive, was, now in zip(self._exchange.drives, before, self._exchange.states, strict=True):
            if was in _LADDER and now in _LADDER and _LADDER.index(now) < _LADDER.index(was):
                what = f"fell back from {was} to {now} while being enabled{self._guard.emcy.last_clause(drive.node_id)}"
                advice = "check power stage, STO and enable input; it is not enabled again automatically"
                failures.append(DriveFault(what, node=drive.node_id, index=0x6041, advice=advice))
        raise_failures(failures)

    def _moved(self, epoch: Epoch) -> list[DriveFault]:
        failures = []
        for drive, reading, held in zip(self._exchange.drives, epoch.readings, self._held, strict=True):
            if reading is None:
                continue
            turns = abs(reading.position_count - held) / drive.scale.revolutions(1.0)
            if turns > BRAKE_DROP_REVOLUTIONS:
                what = f"moves while its brake opens: {turns:.2f} motor revolutions from its position"
                advice = "check the brake, the load and the torque limit 0x6072; the axis may drop when it is enabled"
                failures.append(DriveFault(what, node=drive.node_id, index=0x6064, advice=advice))
        return failures

    def _overdue(self, epoch: Epoch) -> list[TransitionTimeout]:
        advice = "check power stage, STO and enable input, and the drive's display"
        what = f"after {self._limit_s:.1f} s not all axes are enabled and responding"
        slow = [
            TransitionTimeout(f"{what}: it is in {state}", node=drive.node_id, index=0x6041, advice=advice)
            for drive, state, reading in zip(self._exchange.drives, self._exchange.states, epoch.readings, strict=True)
            if state is not State.OPERATION_ENABLED or reading is None
        ]
        return slow or [TransitionTimeout(what, advice=advice)]


def _enable_controlwords(exchange: SyncExchange, guard: Guard) -> list[int]:
    words: list[int] = []
    failures = []
    for drive, state in zip(exchange.drives, exchange.states, strict=True):
        try:
            words.append(0 if state is None else next_controlword(state, State.OPERATION_ENABLED))
        except NoRoute as error:
            what = f"{error}: {drive.fault_text()}{guard.emcy.last_clause(drive.node_id)}"
            advice = "find and remove the cause; nothing is reset automatically"
            failures.append(DriveFault(what, node=drive.node_id, index=0x6041, advice=advice))
    raise_failures(failures)
    return words


def _stuck(exchange: SyncExchange, waited: list[int]) -> list[TransitionTimeout]:
    failures = []
    for drive, state, cycles in zip(exchange.drives, exchange.states, waited, strict=True):
        limit_s = drive.setup.profile.state_machine.transition_timeout_s
        if cycles * exchange.timing.period_s > limit_s:
            what = f"stays in {state} for more than {limit_s} s in the transition to OPERATION ENABLED"
            advice = "check power stage, STO and enable input, and the drive's display"
            failures.append(TransitionTimeout(what, node=drive.node_id, index=0x6041, advice=advice))
    return failures
