"""The way down: quick stop and disable. No word of this module energises an axis or resets a fault."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from drives.cia402 import DISABLE_VOLTAGE, NoRoute, State, decode_state, next_controlword, stopping_controlword
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import BusError, DriveError, TransitionTimeout
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.sdo import ONCE

#: SYNCs without an answer after which an axis is asked by SDO instead.
_SILENT: Final = 3
#: An axis stands when it moves less than this between two SYNCs, in motor revolutions.
_STILL_REVOLUTIONS: Final = 0.001
#: Longest quick stop ramp that is waited for.
_RAMP_S: Final = 2.0
_DOWN: Final = frozenset({State.SWITCH_ON_DISABLED, State.NOT_READY, State.FAULT})
_STOPPED: Final = _DOWN | {State.QUICK_STOP_ACTIVE, State.READY_TO_SWITCH_ON, State.SWITCHED_ON}

Word = Callable[[State], int]


def disabling_controlword(state: State) -> int:
    """Controlword on the way to SWITCH ON DISABLED; from a fault the word that does nothing."""
    try:
        return next_controlword(state, State.SWITCH_ON_DISABLED)
    except NoRoute:
        return DISABLE_VOLTAGE


def quick_stop(exchange: SyncExchange) -> list[DriveError]:
    """Stop every axis by its quick stop ramp and wait until it stands.

    Returns
    -------
    list of DriveError
        Axes of which it is not known that they stand.
    """
    still = [0] * len(exchange.drives)
    last: list[int | None] = [None] * len(exchange.drives)

    def note(epoch: Epoch) -> None:
        for axis, (drive, reading) in enumerate(zip(exchange.drives, epoch.readings, strict=True)):
            if reading is None:
                continue
            before, last[axis] = last[axis], reading.position_count
            allowed = max(1.0, _STILL_REVOLUTIONS * 2.0 * math.pi / drive.scale.count_rad)
            moved = before is None or abs(reading.position_count - before) > allowed
            still[axis] = 0 if moved else still[axis] + 1

    def done(axis: int) -> bool:
        state = exchange.states[axis]
        return state in _DOWN or (state in _STOPPED and still[axis] >= 1)

    return _run(exchange, stopping_controlword, done, note)


def disable(exchange: SyncExchange) -> list[DriveError]:
    """Lead every axis to SWITCH ON DISABLED; a drive in fault stays there.

    Returns
    -------
    list of DriveError
        Axes of which it is not known that they are disabled.
    """
    return _run(exchange, disabling_controlword, lambda axis: exchange.states[axis] in _DOWN, lambda epoch: None)


def _run(
    exchange: SyncExchange, word: Word, done: Callable[[int], bool], note: Callable[[Epoch], None]
) -> list[DriveError]:
    """Cycle with `word` until every axis is done, silent or out of time; then ask the rest by SDO."""
    exchange.hurry()
    limit_s = _RAMP_S + max(drive.setup.profile.state_machine.transition_timeout_s for drive in exchange.drives)
    axes = range(len(exchange.drives))
    failures: list[DriveError] = []
    try:
        for _ in range(math.ceil(limit_s / exchange.timing.period_s) + 1):
            for drive in exchange.drives:
                drive.hold(drive.target_count)
            words = [DISABLE_VOLTAGE if state is None else word(state) for state in exchange.states]
            note(exchange.cycle(words))
            if all((done(axis) and not exchange.silent[axis]) or exchange.silent[axis] >= _SILENT for axis in axes):
                break
    except BusError as error:
        failures.append(error)
    for axis in axes:
        if exchange.silent[axis] or not done(axis) or failures:
            failures += _by_sdo(exchange.drives[axis], word)
    return failures


def _by_sdo(drive: Cia402Drive, word: Word) -> list[DriveError]:
    """The same by SDO, for an axis that does not answer SYNC."""
    status, control = OBJECTS["statusword"], OBJECTS["controlword"]
    try:
        for _ in range(4):
            state = decode_state(drive.access.read(status, ONCE))
            if state in _STOPPED and (state in _DOWN or word(state) == stopping_controlword(state)):
                return []
            drive.access.sdo.write(control.index, control.subindex, control.type, word(state))
        what = f"stays in {decode_state(drive.access.read(status, ONCE))}"
        advice = "use the emergency stop; then check the drive"
        return [TransitionTimeout(what, node=drive.node_id, index=0x6041, advice=advice)]
    except DriveError as error:
        return [error]
