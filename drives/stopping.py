"""Quick stop and disable. No controlword of this module energises an axis or resets a fault.

A drive is disabled only at rest: a holding brake must not stop a moving axis. Standstill is read from the drive, by
SYNC or, where SYNC does not work, by SDO. An axis that answers SYNC and does not slow down in its quick stop is
disabled although it moves. An unconfirmed command (no answer, OPERATION ENABLED not left, axis not at rest) ends the
master's heartbeat at once, so that the drives stop themselves.

No error ends the sequence: an exception of one axis or SYNC is stored as a failure, the heartbeat ends, and the other
axes are stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drives.cia402 import AT_REST, State, decode_state, disabling_controlword, stopping_controlword
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, TransitionTimeout, while_stopping
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.scaling import read_resolution
from drives.sdo import ONCE
from drives.standstill import Standstill

#: SYNCs without an answer after which an axis is queried by SDO instead.
_SILENT: Final = 3
#: Longest quick stop ramp that is waited for.
RAMP_S: Final = 2.0
#: An axis that still slows down after that is waited for: longest time, and time over which its movement is compared.
_SLOWING_S: Final = 10.0
_SLOWING_STEP_S: Final = 0.25
#: Movement in that time, as a share of that in the time before, from which an axis does not slow down.
_SLOWING_SHARE: Final = 0.99
#: What an axis is given beyond the time that a step should take, until the step counts as not confirmed.
PATIENCE_S: Final = 0.2
#: Time for which positions are monitored after the brakes have closed; by SYNCs, and at most by wall clock.
_DROP_WATCH_S: Final = 0.3
_DROP_WATCH_MAX_S: Final = 1.0
#: Where only SDO is left: time between two readings [s], and the velocity that a drive may report at rest [rad/s].
_SDO_PAUSE_S: Final = 0.02
_SDO_STILL_RAD_S: Final = 1.5
#: Controlwords that lead from OPERATION ENABLED to SWITCH ON DISABLED, and one to spare.
_SDO_WORDS: Final = 4
_EMERGENCY: Final = "use the emergency stop; then check the drive"
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

    step = _Step(
        lambda _axis, state: stopping_controlword(state), False, done, PATIENCE_S, RAMP_S + PATIENCE_S, _STOPPED
    )
    return _run(exchange, step, lambda epoch: None)


def _wait_while_slowing(exchange: SyncExchange) -> list[DriveError]:
    """Go on with the quick stop while an axis that moves in QUICK STOP ACTIVE still slows down."""
    span = math.ceil(_SLOWING_STEP_S / exchange.timing.period_s)
    history: list[list[int | None]] = []

    def slows(axis: int) -> bool:
        counts = [row[axis] or 0 for row in history[::-span][:3]]
        return len(counts) < 3 or abs(counts[0] - counts[1]) < _SLOWING_SHARE * abs(counts[1] - counts[2])

    def done(axis: int) -> bool:
        return exchange.states[axis] is not State.QUICK_STOP_ACTIVE or exchange.is_at_rest(axis) or not slows(axis)

    if all(map(done, range(len(exchange.drives)))):
        return []
    step = _Step(lambda _axis, state: stopping_controlword(state), False, done, PATIENCE_S, _SLOWING_S, _STOPPED)
    return _run(exchange, step, lambda _epoch: history.append(list(exchange.position_count)))


def disable(exchange: SyncExchange) -> list[DriveError]:
    """Bring every axis to SWITCH ON DISABLED, moving axes by their quick stop ramp; a drive in fault stays there.

    An axis that does not come to rest in the time of a ramp is waited for as long as it slows down.

    Afterwards the positions are watched for a while: `SyncExchange.brake_drop_rad`.

    Returns
    -------
    list of DriveError
        Axes of which it is not known that they are disabled, or that did not stop before; if there are any, the
        master's heartbeat has ended.
    """
    failures = quick_stop(exchange) if _moves(exchange) else []
    _add_new(failures, _wait_while_slowing(exchange))
    brake_drop, drives = _BrakeDrop(exchange), exchange.drives
    closing_s = [_closing_s(drive) if exchange.powered else 0.0 for drive in drives]
    syncs_left = [math.ceil(seconds / exchange.timing.period_s) for seconds in closing_s]

    def word(axis: int, state: State) -> int:
        closes = state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE) and syncs_left[axis] > 0
        syncs_left[axis] -= closes
        return disabling_controlword(state, brake_closes=closes)

    leave_s = PATIENCE_S + max(drive.setup.profile.state_machine.transition_timeout_s for drive in drives)
    limit_s = leave_s + max(closing_s)
    step = _Step(word, True, lambda axis: exchange.states[axis] in _DOWN, leave_s, limit_s, _DOWN)
    _add_new(failures, _run(exchange, step, brake_drop.note))
    if exchange.powered:
        exchange.powered = False
        failures += _watch(exchange, brake_drop)
        exchange.brake_drop_rad = brake_drop.rad()
    return failures


def _add_new(failures: list[DriveError], later: list[DriveError]) -> None:
    """Append failures of a later step, except those of the same kind and node."""
    reported = {(type(error), error.node) for error in failures}
    failures += [error for error in later if (type(error), error.node) not in reported]


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
    return exchange.cycle([word(axis, state or State.UNDEFINED) for axis, state in enumerate(exchange.states)])


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
    broken = bool(failures)
    rest = [axis for axis in axes if exchange.unanswered[axis] or not step.done(axis) or broken]
    if rest:
        exchange.end_heartbeat()
    for axis in rest:
        failures += _by_sdo(exchange, axis, step, broken or exchange.unanswered[axis] > 0)
    return failures


def _by_sdo(exchange: SyncExchange, axis: int, step: _Step, without_sync: bool) -> list[DriveError]:
    """Run the step by SDO for an axis that does not respond to SYNC, or has not done the step."""
    drive = exchange.drives[axis]
    try:
        if step.disables:
            _lead_down(drive, drive.scale.revolutions(1.0) if without_sync else None, time.sleep)
            return []
        for _ in range(_SDO_WORDS):
            state = _state(drive)
            if state in step.reached:
                return [] if _seen_at_rest(exchange, axis, step, without_sync) else [_still_moving(drive)]
            drive.send_controlword(step.word(axis, state))
        return [_stays(drive)]
    except Exception as error:
        return [_unknown(while_stopping(error, drive.node_id))]


def _unknown(failure: DriveError) -> DriveError:
    """Add to a failure of an axis, of which nothing more can be read, what a person has to do."""
    if "emergency stop" not in failure.advice:
        failure.what += "; it is not known whether the axis is at rest"
        failure.advice = f"{_EMERGENCY}; {failure.advice}" if failure.advice else _EMERGENCY
    return failure


def _lead_down(drive: Cia402Drive, turn_count: float | None, pause: Callable[[float], None]) -> None:
    """Bring a drive to SWITCH ON DISABLED by SDO, once its standstill has been read.

    Parameters
    ----------
    drive : Cia402Drive
    turn_count : float or None
        Position counts of one motor revolution; None = standstill was read, or waited for, by SYNC.
    pause : callable
        Waits for a number of seconds.

    Raises
    ------
    TransitionTimeout
        It does not come to rest, or stays in another state. An axis that moves is not disabled.
    """
    for _ in range(_SDO_WORDS):
        state = _state(drive)
        if state in _DOWN:
            return
        if state in _HELD:
            if state is State.OPERATION_ENABLED:
                drive.send_controlword(stopping_controlword(state))
            if turn_count is not None and not _wait_for_rest(drive, turn_count, pause):
                raise _still_moving(drive, "; it was not disabled")
            state = _state(drive)
        if state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE):
            pause(_closing_s(drive))
        drive.send_controlword(disabling_controlword(state))
    if _state(drive) not in _DOWN:
        raise _stays(drive)


def take_down(drive: Cia402Drive, pause: Callable[[float], None]) -> str:
    """Disable a drive that an interrupted run left energised, by SDO: quick stop, standstill, brake time, voltage off.

    Parameters
    ----------
    drive : Cia402Drive
        Connected; it need not be configured.
    pause : callable
        Waits for a number of seconds.

    Returns
    -------
    str
        What was read, and what was done; empty where the drive was disabled.

    Raises
    ------
    DriveError
        It does not come to rest or cannot be read; then it is not disabled.
    """
    found = _state(drive)
    if found in AT_REST and found is not State.SWITCHED_ON:
        return ""
    position = drive.setup.profile.position.object
    try:
        before = drive.access.read(position, ONCE)
        _lead_down(drive, read_resolution(drive.access), pause)
        after = drive.access.read(position, ONCE)
    except Exception as error:
        raise _unknown(while_stopping(error, drive.node_id)) from error
    text = f"node {drive.node_id}: was in {found} at {before} counts; at rest and in {_state(drive)}"
    return f"{text} at {after} counts, read from the drive"


def _state(drive: Cia402Drive) -> State:
    return decode_state(drive.access.read(OBJECTS["statusword"], ONCE))


def _seen_at_rest(exchange: SyncExchange, axis: int, step: _Step, without_sync: bool) -> bool:
    """Return whether a stopped axis is at rest, by its answers to SYNC or, without any, by SDO."""
    if without_sync:
        drive = exchange.drives[axis]
        return _wait_for_rest(drive, drive.scale.revolutions(1.0), time.sleep)
    return step.done(axis) or exchange.states[axis] not in step.reached


def _wait_for_rest(drive: Cia402Drive, turn_count: float, pause: Callable[[float], None]) -> bool:
    """Wait until SDO readings of position and velocity show that the axis is at rest; return whether they do in time.

    The velocity (0x606C) decides too where the profile states its unit and the drive does not refuse the object.
    """
    position, velocity = drive.setup.profile.position.object, drive.setup.profile.velocity
    unit_rad_s = None if velocity is None else velocity.rad_s(turn_count)
    standstill, until_s, time_s = Standstill(turn_count), time.monotonic() + RAMP_S, 0.0
    while time.monotonic() < until_s:
        standstill.see(time_s, drive.access.read(position, ONCE))
        turns = None if velocity is None else drive.access.read_readable(velocity.object, ONCE)
        speed = abs(turns * unit_rad_s) if turns is not None and unit_rad_s is not None else 0.0
        if standstill.at_rest() and speed <= _SDO_STILL_RAD_S:
            return True
        pause(_SDO_PAUSE_S)
        time_s += _SDO_PAUSE_S  # at least: a reading takes its time too
    return False


def _stays(drive: Cia402Drive) -> TransitionTimeout:
    return TransitionTimeout(f"stays in {_state(drive)}", node=drive.node_id, index=0x6041, advice=_EMERGENCY)


def _still_moving(drive: Cia402Drive, and_so: str = "") -> DriveError:
    advice = "use the emergency stop; then check its quick stop ramp (0x605A, 0x6085) and its brake"
    what = f"still moves {RAMP_S + PATIENCE_S:.1f} s after the stop command{and_so}"
    return TransitionTimeout(what, node=drive.node_id, index=0x6064, advice=advice)
