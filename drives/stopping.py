"""Quick stop and disable. No controlword of this module energises an axis or resets a fault.

A drive is disabled only at rest: a holding brake must not stop a moving axis. An unconfirmed command (no answer,
OPERATION ENABLED not left, axis not at rest) ends the master's heartbeat at once, so that the drives stop themselves.

No error ends the sequence: an exception of one axis or SYNC is stored as a failure, the heartbeat ends, and the other
axes are stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drives.cia402 import (
    DISABLE_OPERATION,
    DISABLE_VOLTAGE,
    QUICK_STOP,
    NoRoute,
    State,
    decode_state,
    next_controlword,
    stopping_controlword,
)
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, TransitionTimeout, while_stopping
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.sdo import ONCE

#: SYNCs without an answer after which an axis is queried by SDO instead.
_SILENT: Final = 3
#: Longest quick stop ramp that is waited for.
_RAMP_S: Final = 2.0
#: What an axis is given beyond the time that a step should take, until the step counts as not confirmed.
_PATIENCE_S: Final = 0.2
#: Time for which positions are monitored after the brakes have closed; by SYNCs, and at most by wall clock.
_DROP_WATCH_S: Final = 0.3
_DROP_WATCH_MAX_S: Final = 1.0
#: Where only SDO is left: time between two readings, and by how much they differ at rest, in motor revolutions.
_SDO_PAUSE_S: Final = 0.02
_SDO_STILL_REVOLUTIONS: Final = 0.005
_DOWN: Final = frozenset({State.SWITCH_ON_DISABLED, State.NOT_READY, State.FAULT})
_STOPPED: Final = _DOWN | {State.QUICK_STOP_ACTIVE, State.READY_TO_SWITCH_ON, State.SWITCHED_ON}
#: States in which the drive itself holds or brakes the axis.
_HELD: Final = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})


@dataclass(frozen=True, slots=True)
class _Step:
    """One step of the stop sequence.

    Attributes
    ----------
    word : callable
        Controlword by axis and state.
    disables : bool
        The step ends in SWITCH ON DISABLED.
    done : callable
        Whether an axis has done it.
    leave_s : float
        How long an axis may stay in OPERATION ENABLED.
    limit_s : float
        Time limit of the step.
    reached : frozenset of State
        States that confirm the step when read by SDO.
    """

    word: Callable[[int, State], int]
    disables: bool
    done: Callable[[int], bool]
    leave_s: float
    limit_s: float
    reached: frozenset[State]


class _BrakeDrop:
    """Measurement of the largest movement of each axis from its last held position.

    Parameters
    ----------
    exchange : SyncExchange
    """

    def __init__(self, exchange: SyncExchange) -> None:
        self._exchange = exchange
        self._held_count = list(exchange.position_count)
        self._most_count = [0] * len(exchange.drives)

    def note(self, epoch: Epoch) -> None:
        """Process the readings of one SYNC."""
        for axis, reading in enumerate(epoch.readings):
            if reading is None:
                continue
            held = self._held_count[axis]
            if held is None or decode_state(reading.statusword) in _HELD:
                self._held_count[axis] = reading.position_count
            else:
                self._most_count[axis] = max(self._most_count[axis], abs(reading.position_count - held))

    def rad(self) -> tuple[float, ...]:
        """Return the largest movement of each axis, motor side."""
        drives = self._exchange.drives
        return tuple(count * abs(drive.scale.count_rad) for drive, count in zip(drives, self._most_count, strict=True))


def disabling_controlword(state: State) -> int:
    """Return the controlword towards SWITCH ON DISABLED; in a fault one without effect."""
    try:
        return next_controlword(state, State.SWITCH_ON_DISABLED)
    except NoRoute:
        return DISABLE_VOLTAGE


class _DisableSequence:
    """Controlwords to SWITCH ON DISABLED; an axis stays in SWITCHED ON until its brake has had its time to close.

    Without the voltage a drive cannot hold the axis while the brake closes.

    Parameters
    ----------
    exchange : SyncExchange
    """

    def __init__(self, exchange: SyncExchange) -> None:
        period_s = exchange.timing.period_s
        #: Longest time that a brake of these axes takes to close; 0 where no brake was opened.
        self.closing_s = max(map(_closing_s, exchange.drives)) if exchange.powered else 0.0
        self._left = [math.ceil(min(_closing_s(drive), self.closing_s) / period_s) for drive in exchange.drives]

    def word(self, axis: int, state: State) -> int:
        """Return the next controlword of an axis; one call per SYNC."""
        if state is State.SWITCHED_ON and self._left[axis] > 0:
            self._left[axis] -= 1
            return DISABLE_OPERATION
        return disabling_controlword(state)


def _closing_s(drive: Cia402Drive) -> float:
    return drive.setup.profile.state_machine.brake_closing_s


def quick_stop(exchange: SyncExchange) -> list[DriveError]:
    """Stop every axis by its quick stop ramp and wait until it is at rest.

    Returns
    -------
    list of DriveError
        Axes that are not confirmed to be at rest; if there are any, the master's heartbeat has ended.
    """

    def done(axis: int) -> bool:
        return exchange.states[axis] in _STOPPED and exchange.is_at_rest(axis)

    def word(_axis: int, state: State) -> int:
        # a brake that is closing is given its time by `disable`
        return DISABLE_OPERATION if state is State.SWITCHED_ON else stopping_controlword(state)

    step = _Step(word, False, done, _PATIENCE_S, _RAMP_S + _PATIENCE_S, _STOPPED)
    return _run(exchange, step, lambda epoch: None)


def disable(exchange: SyncExchange) -> list[DriveError]:
    """Bring every axis to SWITCH ON DISABLED, moving axes by their quick stop ramp; a drive in fault stays there.

    Afterwards the positions are watched for a while: `SyncExchange.brake_drop_rad`.

    Returns
    -------
    list of DriveError
        Axes of which it is not known that they are disabled, or that did not stop before; if there are any, the
        master's heartbeat has ended.
    """
    failures = quick_stop(exchange) if _moves(exchange) else []
    brake_drop, sequence = _BrakeDrop(exchange), _DisableSequence(exchange)
    leave_s = _PATIENCE_S + max(drive.setup.profile.state_machine.transition_timeout_s for drive in exchange.drives)
    limit_s = leave_s + sequence.closing_s
    step = _Step(sequence.word, True, lambda axis: exchange.states[axis] in _DOWN, leave_s, limit_s, _DOWN)
    later = _run(exchange, step, brake_drop.note)
    reported = {(type(error), error.node) for error in failures}
    failures += [error for error in later if (type(error), error.node) not in reported]
    if exchange.powered:
        exchange.powered = False
        failures += _watch(exchange, brake_drop)
        exchange.brake_drop_rad = brake_drop.rad()
    return failures


def _moves(exchange: SyncExchange) -> bool:
    """Return whether a responding axis is held by its drive and not at rest; a ramp is waited for only once."""
    held = _HELD if exchange.heartbeat else {State.OPERATION_ENABLED}
    return any(
        state in held and not exchange.is_at_rest(axis) and exchange.unanswered[axis] < _SILENT
        for axis, state in enumerate(exchange.states)
    )


def _watch(exchange: SyncExchange, brake_drop: _BrakeDrop) -> list[DriveError]:
    """Measure the drop of each axis after the brakes have closed."""
    until_s = time.monotonic() + _DROP_WATCH_MAX_S
    try:
        for _ in range(math.ceil(_DROP_WATCH_S / exchange.timing.period_s)):
            brake_drop.note(_cycle(exchange, lambda _axis, state: disabling_controlword(state)))
            if min(exchange.unanswered) >= _SILENT or time.monotonic() > until_s:
                break
    except Exception as error:
        exchange.end_heartbeat()
        return [while_stopping(error)]
    return []


def _cycle(exchange: SyncExchange, word: Callable[[int, State], int]) -> Epoch:
    """Run one SYNC of the stop sequence: every axis keeps its last target."""
    for drive in exchange.drives:
        drive.hold(drive.target_count)
    states = enumerate(exchange.states)
    return exchange.cycle([DISABLE_VOLTAGE if state is None else word(axis, state) for axis, state in states])


def _run(exchange: SyncExchange, step: _Step, note: Callable[[Epoch], None]) -> list[DriveError]:
    """Run SYNCs with the controlwords of a step until every axis is done, not responding or out of time; then use
    SDO.
    """
    exchange.hurry()
    axes, period_s = range(len(exchange.drives)), exchange.timing.period_s
    failures: list[DriveError] = []
    try:
        for number in range(1, math.ceil(step.limit_s / period_s) + 2):
            note(_cycle(exchange, step.word))
            gone = [exchange.unanswered[axis] >= _SILENT for axis in axes]
            late = number * period_s > step.leave_s and State.OPERATION_ENABLED in exchange.states
            if late or any(gone):
                exchange.end_heartbeat()
            if all(gone[axis] or (step.done(axis) and not exchange.unanswered[axis]) for axis in axes):
                break
    except Exception as error:
        failures.append(while_stopping(error))
    rest = [axis for axis in axes if exchange.unanswered[axis] or not step.done(axis) or failures]
    if rest:
        exchange.end_heartbeat()
    for axis in rest:
        failures += _by_sdo(exchange, axis, step)
    return failures


def _by_sdo(exchange: SyncExchange, axis: int, step: _Step) -> list[DriveError]:
    """Run the step by SDO for an axis that does not respond to SYNC."""
    drive = exchange.drives[axis]
    try:
        for _ in range(4):
            state = _state(drive)
            if state in step.reached:
                return [] if _seen_at_rest(exchange, axis, step) else [_still_moving(drive)]
            if state is State.OPERATION_ENABLED and step.disables:
                _send(drive, QUICK_STOP)
                _wait_for_rest(drive)
                state = _state(drive)
            if state is State.SWITCHED_ON and step.disables:
                time.sleep(_closing_s(drive))
            _send(drive, disabling_controlword(state) if step.disables else step.word(axis, state))
        what = f"stays in {_state(drive)}"
        advice = "use the emergency stop; then check the drive"
        return [TransitionTimeout(what, node=drive.node_id, index=0x6041, advice=advice)]
    except Exception as error:
        return [while_stopping(error, drive.node_id)]


def _send(drive: Cia402Drive, word: int) -> None:
    control = OBJECTS["controlword"]
    drive.access.sdo.write(control.index, control.subindex, control.type, word)


def _state(drive: Cia402Drive) -> State:
    return decode_state(drive.access.read(OBJECTS["statusword"], ONCE))


def _seen_at_rest(exchange: SyncExchange, axis: int, step: _Step) -> bool:
    """Return whether a stopped axis is at rest, by its answers to SYNC or, without any, by SDO."""
    if step.disables or step.done(axis):
        return True
    if not exchange.unanswered[axis]:
        return exchange.states[axis] not in step.reached
    return _wait_for_rest(exchange.drives[axis])


def _wait_for_rest(drive: Cia402Drive) -> bool:
    """Wait until two SDO readings show that the axis is at rest; return whether they do in time."""
    allowed = max(1.0, drive.scale.revolutions(_SDO_STILL_REVOLUTIONS))
    until_s = time.monotonic() + _RAMP_S
    before: int | None = None
    while time.monotonic() < until_s:
        count = drive.access.read(drive.setup.profile.position.object, ONCE)
        if before is not None and abs(count - before) <= allowed:
            return True
        before = count
        time.sleep(_SDO_PAUSE_S)
    return False


def _still_moving(drive: Cia402Drive) -> DriveError:
    advice = "use the emergency stop; then check its quick stop ramp (0x605A, 0x6085) and its brake"
    what = f"still moves {_RAMP_S + _PATIENCE_S:.1f} s after the stop command"
    return TransitionTimeout(what, node=drive.node_id, index=0x6064, advice=advice)
