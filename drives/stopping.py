"""Quick stop and disable. No controlword of this module energises an axis or resets a fault.

A drive is disabled only at rest: a holding brake must not stop a moving axis. Standstill is read from the drive, by
SYNC or, where SYNC does not work, by SDO. An axis that does not come to rest stays in its quick stop, and the error
names the emergency stop. An unconfirmed command (no answer, OPERATION ENABLED not left, axis not at rest) ends the
master's heartbeat at once, so that the drives stop themselves.

No error ends the sequence: an exception of one axis or SYNC is stored as a failure, the heartbeat ends, and the other
axes are stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

from drives.cia402 import AT_REST, State, decode_state, disabling_controlword, stopping_controlword
from drives.clock import SyncClock
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, TransitionTimeout, while_stopping
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.scaling import read_resolution
from drives.sdo import ONCE
from drives.standstill import BRAKE_WATCH_S, BrakeDrop, Standstill

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
#: Longest time by wall clock for which positions are monitored after the brakes have closed, `BRAKE_WATCH_S` by SYNCs.
_DROP_WATCH_MAX_S: Final = 1.0
#: Where only SDO is left: time between two readings [s], and the velocity that a drive may report at rest [rad/s].
_SDO_PAUSE_S: Final = 0.02
_SDO_STILL_RAD_S: Final = 1.5
#: Controlwords that lead from OPERATION ENABLED to SWITCH ON DISABLED, and one to spare.
_SDO_WORDS: Final = 4
_EMERGENCY: Final = "use the emergency stop; then check the drive"
#: States without voltage, in which an axis is in its brake.
DOWN: Final = frozenset({State.SWITCH_ON_DISABLED, State.NOT_READY, State.FAULT})
_STOPPED: Final = DOWN | {State.QUICK_STOP_ACTIVE, State.READY_TO_SWITCH_ON, State.SWITCHED_ON}
#: States in which the drive itself holds or brakes the axis.
_HELD: Final = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})


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

    return _run(exchange, _stopping_word, done, RAMP_S + PATIENCE_S)


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
    return _run(
        exchange, _stopping_word, done, _SLOWING_S, note=lambda _epoch: history.append(list(exchange.position_count))
    )


def disable(exchange: SyncExchange) -> list[DriveError]:
    """Bring every axis to SWITCH ON DISABLED, moving axes by their quick stop ramp; a drive in fault stays there.

    An axis that does not come to rest in the time of a ramp is waited for as long as it slows down. One that still
    moves then is not disabled: it stays in its quick stop, without the master's heartbeat.

    Afterwards the positions are watched for a while: `SyncExchange.brake_drop_rad`.

    Returns
    -------
    list of DriveError
        Axes of which it is not known that they are disabled, or that did not stop before; if there are any, the
        master's heartbeat has ended.
    """
    failures = quick_stop(exchange) if _moves(exchange) else []
    failures += _wait_while_slowing(exchange)
    drives, drops = exchange.drives, [BrakeDrop(count) for count in exchange.position_count]
    closing_s = [_closing_s(drive) if exchange.powered else 0.0 for drive in drives]
    syncs_left = [math.ceil(seconds / exchange.timing.period_s) for seconds in closing_s]

    def note(epoch: Epoch) -> None:
        for drop, reading in zip(drops, epoch.readings, strict=True):
            if reading is not None:
                state = decode_state(reading.statusword)
                drop.see(reading.position_count, is_held=state in _HELD, is_off=state in DOWN)

    def word(axis: int, state: State) -> int:
        if _moves_held(exchange, axis):
            return stopping_controlword(state)
        closes = state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE) and syncs_left[axis] > 0
        syncs_left[axis] -= closes
        return disabling_controlword(state, brake_closes=closes)

    leave_s = PATIENCE_S + max(drive.setup.profile.state_machine.transition_timeout_s for drive in drives)
    limit_s = leave_s + max(closing_s)

    def done(axis: int) -> bool:
        return exchange.states[axis] in DOWN

    failures += _run(exchange, word, done, limit_s, leave_s=leave_s, disables=True, note=note)
    if exchange.powered:
        exchange.powered = False
        failures += _watch(exchange, note)
        exchange.brake_drop_rad = tuple(
            drop.most_count * abs(drive.scale.count_rad) for drop, drive in zip(drops, drives, strict=True)
        )
    # of the failures of one kind and node the last one counts: what it says is more recent
    return list({(type(error), error.node): error for error in failures}.values())


def _stopping_word(_axis: int, state: State) -> int:
    return stopping_controlword(state)


def _moves_held(exchange: SyncExchange, axis: int) -> bool:
    """Return whether an axis is held or braked by its drive, and not at rest, by its last answers to SYNC."""
    return exchange.states[axis] in _HELD and not exchange.is_at_rest(axis)


def _moves(exchange: SyncExchange) -> bool:
    """Return whether a responding axis is held by its drive and not at rest; a ramp is waited for only once."""
    return any(
        _moves_held(exchange, axis)
        and (exchange.heartbeat.running or state is State.OPERATION_ENABLED)
        and exchange.unanswered[axis] < _SILENT
        for axis, state in enumerate(exchange.states)
    )


def _watch(exchange: SyncExchange, note: Callable[[Epoch], None]) -> list[DriveError]:
    """Measure the drop of each axis after the brakes have closed; an axis that its drive holds is not disabled."""

    def word(_axis: int, state: State) -> int:
        return stopping_controlword(state) if state in _HELD else disabling_controlword(state)

    until_s = time.monotonic() + _DROP_WATCH_MAX_S
    try:
        for _ in range(math.ceil(BRAKE_WATCH_S / exchange.timing.period_s)):
            note(_cycle(exchange, word))
            if min(exchange.unanswered) >= _SILENT or time.monotonic() > until_s:
                break
    except Exception as error:
        exchange.heartbeat.stop()
        return [while_stopping(error)]
    return []


def _cycle(exchange: SyncExchange, word: Callable[[int, State], int]) -> Epoch:
    """Run one SYNC of the stop sequence: every axis keeps its last target."""
    for drive in exchange.drives:
        drive.hold(drive.target_count)
    return exchange.cycle([word(axis, state or State.UNDEFINED) for axis, state in enumerate(exchange.states)])


def _run(
    exchange: SyncExchange,
    word: Callable[[int, State], int],
    done: Callable[[int], bool],
    limit_s: float,
    *,
    leave_s: float = PATIENCE_S,
    disables: bool = False,
    note: Callable[[Epoch], object] = lambda _epoch: None,
) -> list[DriveError]:
    """Run SYNCs with the controlwords of a step until every axis is done, not responding or out of time; then use
    SDO.

    Parameters
    ----------
    exchange : SyncExchange
    word : callable
        Controlword by axis and state.
    done : callable
        Whether an axis has done the step.
    limit_s, leave_s : float
        Time limit of the step, and how long an axis may stay in OPERATION ENABLED [s].
    disables : bool
        The step ends in SWITCH ON DISABLED.
    note : callable
        Called with the epoch of each SYNC.
    """
    exchange.hurry()
    axes, period_s = range(len(exchange.drives)), exchange.timing.period_s
    failures: list[DriveError] = []
    try:
        for number in range(1, math.ceil(limit_s / period_s) + 2):
            note(_cycle(exchange, word))
            gone = [exchange.unanswered[axis] >= _SILENT for axis in axes]
            late = number * period_s > leave_s and State.OPERATION_ENABLED in exchange.states
            if late or any(gone):
                exchange.heartbeat.stop()
            if all(gone[axis] or (done(axis) and not exchange.unanswered[axis]) for axis in axes):
                break
    except Exception as error:
        failures.append(while_stopping(error))
    broken = bool(failures)
    rest = [axis for axis in axes if exchange.unanswered[axis] or not done(axis) or broken]
    if rest:
        exchange.heartbeat.stop()
    for axis in rest:
        drive, without_sync = exchange.drives[axis], broken or exchange.unanswered[axis] > 0
        turn_count = drive.scale.revolutions(1.0) if without_sync else None
        try:
            if disables and not without_sync and _moves_held(exchange, axis):
                raise _still_moving(drive, "; it was not disabled")
            if disables:
                _lead_down(drive, turn_count, exchange.clock)
            else:
                still_moves = exchange.states[axis] in _STOPPED and not done(axis)
                _stop_by_sdo(drive, turn_count, exchange.clock, still_moves=still_moves)
        except Exception as error:
            failures.append(_unknown(while_stopping(error, drive.node_id)))
    return failures


def _stop_by_sdo(drive: Cia402Drive, turn_count: float | None, clock: SyncClock, *, still_moves: bool) -> None:
    """Stop a drive by SDO and wait until its standstill was read.

    Parameters
    ----------
    drive : Cia402Drive
    turn_count, clock
        As `_lead_down`.
    still_moves : bool
        It has answered SYNC, is stopped and not at rest.

    Raises
    ------
    TransitionTimeout
        It does not come to rest, or stays in another state.
    """
    for _ in range(_SDO_WORDS):
        state = _state(drive)
        if state in _STOPPED:
            if still_moves if turn_count is None else not _wait_for_rest(drive, turn_count, clock):
                raise _still_moving(drive)
            return
        drive.send_controlword(stopping_controlword(state))
    raise _stays(drive)


def _unknown(failure: DriveError) -> DriveError:
    """Add to a failure of an axis, of which nothing more can be read, what a person has to do."""
    if "emergency stop" not in failure.advice:
        failure.what += "; it is not known whether the axis is at rest"
        failure.advice = f"{_EMERGENCY}; {failure.advice}" if failure.advice else _EMERGENCY
    return failure


def _lead_down(drive: Cia402Drive, turn_count: float | None, clock: SyncClock) -> None:
    """Bring a drive to SWITCH ON DISABLED by SDO, once its standstill has been read.

    Parameters
    ----------
    drive : Cia402Drive
    turn_count : float or None
        Position counts of one motor revolution; None = standstill was read by SYNC.
    clock : SyncClock
        In whose time the axis moves: in lockstep it goes on only with SYNC.

    Raises
    ------
    TransitionTimeout
        It does not come to rest, or stays in another state. An axis that moves is not disabled.
    """
    for _ in range(_SDO_WORDS):
        state = _state(drive)
        if state in DOWN:
            return
        if state in _HELD:
            if state is State.OPERATION_ENABLED:
                drive.send_controlword(stopping_controlword(state))
            if turn_count is not None and not _wait_for_rest(drive, turn_count, clock):
                raise _still_moving(drive, "; it was not disabled")
            state = _state(drive)
        if state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE):
            clock.pause(_closing_s(drive))
        drive.send_controlword(disabling_controlword(state))
    if _state(drive) not in DOWN:
        raise _stays(drive)


def take_down(drive: Cia402Drive, clock: SyncClock) -> str:
    """Disable a drive that an interrupted run left energised, by SDO: quick stop, standstill, brake time, voltage off.

    Parameters
    ----------
    drive : Cia402Drive
        Connected; it need not be configured.
    clock : SyncClock
        As `_lead_down`.

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
        _lead_down(drive, read_resolution(drive.setup.profile, drive.access.read, drive.node_id), clock)
        after = drive.access.read(position, ONCE)
    except Exception as error:
        raise _unknown(while_stopping(error, drive.node_id)) from error
    text = f"node {drive.node_id}: was in {found} at {before} counts; at rest and in {_state(drive)}"
    return f"{text} at {after} counts, read from the drive"


def _state(drive: Cia402Drive) -> State:
    return decode_state(drive.access.read(OBJECTS["statusword"], ONCE))


def _wait_for_rest(drive: Cia402Drive, turn_count: float, clock: SyncClock) -> bool:
    """Wait until SDO readings of position and velocity show that the axis is at rest; return whether they do in time.

    The velocity (0x606C) decides too where the profile states its unit and the drive does not refuse the object.
    """
    velocity = drive.setup.profile.velocity
    unit_rad_s = None if velocity is None else velocity.rad_s(turn_count)
    standstill, until_s, time_s = Standstill(turn_count), clock.now_s() + RAMP_S, 0.0
    while clock.now_s() < until_s:
        _, count, turns = drive.read_axis(ONCE, velocity=unit_rad_s is not None)
        standstill.see(time_s, count)
        if standstill.at_rest() and abs((turns or 0) * (unit_rad_s or 0.0)) <= _SDO_STILL_RAD_S:
            return True
        clock.pause(_SDO_PAUSE_S)
        time_s += _SDO_PAUSE_S  # at least: a reading takes its time too
    return False


def _stays(drive: Cia402Drive) -> TransitionTimeout:
    return TransitionTimeout(f"stays in {_state(drive)}", node=drive.node_id, index=0x6041, advice=_EMERGENCY)


def _still_moving(drive: Cia402Drive, and_so: str = "") -> DriveError:
    advice = "use the emergency stop; then check its quick stop ramp (0x605A, 0x6085) and its brake"
    what = f"still moves {RAMP_S + PATIENCE_S:.1f} s after the stop command{and_so}"
    return TransitionTimeout(what, node=drive.node_id, index=0x6064, advice=advice)
