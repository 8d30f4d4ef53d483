"""The way up: from whatever state the drives are in to OPERATION ENABLED, each axis holding the place it is at."""

from __future__ import annotations

import math
from typing import Final

from drives.cia402 import (
    AT_REST,
    DISABLE_VOLTAGE,
    FAULT_RESET,
    FAULTED,
    NoRoute,
    State,
    decode_state,
    describe,
    next_controlword,
)
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import ConfigurationRefused, DriveFault, IncompleteEpochs, TransitionTimeout, raise_failures
from drives.exchange import SyncExchange
from drives.guard import Guard
from drives.objects import OBJECTS
from drives.values import DriveReading

_FIRST_TRIES: Final = 10
#: How far the first TPDO may be from SDO at standstill, in motor revolutions.
_AGREEMENT_REVOLUTIONS: Final = 0.01


def refuse_fault(drive: Cia402Drive, guard: Guard) -> None:
    """Make sure that a drive may be enabled.

    Raises
    ------
    DriveFault
        It is in FAULT, which nobody here resets, or enabled already.
    """
    status = drive.statusword()
    state = decode_state(status)
    if state in FAULTED:
        what = f"is in {describe(status)}: {drive.fault_words()}{guard.last_words(drive.node_id)}"
        advice = "find and remove the cause, then reset the fault by hand; it is never reset automatically"
    elif state not in AT_REST:
        what, advice = f"is in {describe(status)} before it was enabled", "disable it first"
    else:
        return
    raise DriveFault(what, node=drive.node_id, index=0x6041, code=status, advice=advice)


def reset_fault(drive: Cia402Drive) -> None:
    """Reset a fault by SDO; only ever called because a person asked for it.

    Raises
    ------
    DriveFault
        The fault is still there.
    """
    control = OBJECTS["controlword"]
    if decode_state(drive.statusword()) is State.FAULT:
        for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):
            drive.access.sdo.write(control.index, control.subindex, control.type, word)
    status = drive.statusword()
    if decode_state(status) in FAULTED:
        what = f"is still in {describe(status)}: {drive.fault_words()}"
        raise DriveFault(what, node=drive.node_id, index=0x6041, code=status, advice="its cause is still there")


def first_epoch(exchange: SyncExchange) -> Epoch:
    """SYNC alone, until every drive answers: no command is sent before the position is known.

    Raises
    ------
    IncompleteEpochs, SeveralFailures
        Some do not.
    """
    epoch = exchange.cycle(None)
    for _ in range(_FIRST_TRIES - 1):
        if epoch.complete:
            return epoch
        epoch = exchange.cycle(None)
    advice = "check that its TPDOs are synchronous and that it is in NMT state OPERATIONAL"
    what = f"does not answer SYNC ({_FIRST_TRIES} sent)"
    raise_failures(
        [IncompleteEpochs(what, node=exchange.drives[axis].node_id, advice=advice) for axis in epoch.missing]
    )
    return epoch


def compare_with_sdo(drive: Cia402Drive, reading: DriveReading) -> None:
    """The first TPDO must say what SDO says of the same objects: a shifted mapping shows here.

    Raises
    ------
    ConfigurationRefused
        It does not.
    """
    position = drive.access.read(drive.setup.profile.position.object)
    status = drive.access.read(OBJECTS["statusword"])
    allowed = _AGREEMENT_REVOLUTIONS * 2.0 * math.pi / drive.scale.count_rad + 1.0
    same_state = decode_state(status) is decode_state(reading.statusword)
    if abs(position - reading.position_count) > allowed or not same_state:
        raise ConfigurationRefused(
            f"TPDO1 says {describe(reading.statusword)} at {reading.position_count} counts, "
            f"SDO says {describe(status)} at {position} counts",
            node=drive.node_id,
            index=drive.plans[1].mapping,
            advice="the PDO mapping is shifted, or the axis moves although nobody enabled it",
        )


def walk_up(exchange: SyncExchange, guard: Guard, epoch: Epoch) -> Epoch:
    """Transitions to OPERATION ENABLED; until it is there, an axis is told to stay where it is.

    Parameters
    ----------
    exchange : SyncExchange
    guard : Guard
    epoch : Epoch
        The last one, complete.

    Returns
    -------
    Epoch
        Complete, every axis enabled.

    Raises
    ------
    DriveFault, TransitionTimeout, IncompleteEpochs, DriveRebooted, SeveralFailures
    """
    states = exchange.states
    waited = [0] * len(states)
    while True:
        raise_failures(_stuck(exchange, waited))
        for drive, reading, state in zip(exchange.drives, epoch.readings, states, strict=True):
            if reading is not None and state is not State.OPERATION_ENABLED:
                drive.hold(reading.position_count)
        words = _words_up(exchange, guard)
        before = list(states)
        epoch = exchange.cycle(words)
        guard.check_bus()
        guard.check_silence()
        if epoch.complete and all(state is State.OPERATION_ENABLED for state in states):
            return epoch
        for axis, state in enumerate(states):
            stands = state is before[axis] and state is not State.OPERATION_ENABLED
            waited[axis] = waited[axis] + 1 if stands else 0


def _words_up(exchange: SyncExchange, guard: Guard) -> list[int]:
    words: list[int] = []
    failures = []
    for drive, state in zip(exchange.drives, exchange.states, strict=True):
        try:
            words.append(0 if state is None else next_controlword(state, State.OPERATION_ENABLED))
        except NoRoute as error:
            what = f"{error}: {drive.fault_words()}{guard.last_words(drive.node_id)}"
            advice = "find and remove the cause; nothing is reset automatically"
            failures.append(DriveFault(what, node=drive.node_id, index=0x6041, advice=advice))
    raise_failures(failures)
    return words


def _stuck(exchange: SyncExchange, waited: list[int]) -> list[TransitionTimeout]:
    failures = []
    for drive, state, cycles in zip(exchange.drives, exchange.states, waited, strict=True):
        limit_s = drive.setup.profile.state_machine.transition_timeout_s
        if cycles * exchange.timing.period_s > limit_s:
            what = f"stays in {state} for more than {limit_s} s on the way to OPERATION ENABLED"
            advice = "check power stage, STO and enable input; the drive's display tells more"
            failures.append(TransitionTimeout(what, node=drive.node_id, index=0x6041, advice=advice))
    return failures
