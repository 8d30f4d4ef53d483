"""The way up: from whatever state the drives are in to OPERATION ENABLED, each axis holding the place it is at."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
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
from drives.errors import (
    ConfigurationRefused,
    DriveFault,
    IncompleteEpochs,
    StopAsked,
    TransitionTimeout,
    raise_failures,
)
from drives.exchange import SyncExchange
from drives.guard import Guard
from drives.objects import OBJECTS
from drives.values import DriveReading

_FIRST_TRIES: Final = 10
#: How far the first TPDO may be from SDO at standstill, in motor revolutions.
_AGREEMENT_REVOLUTIONS: Final = 0.01
#: How far an axis may be from where it stood until its brake is open, in motor revolutions: behind a gear of 100 it is
#: 0.016 rad of the joint. A drive that holds its place stays far below; one that lets its axis sag is stopped here.
SAG_REVOLUTIONS: Final = 0.25
#: From SWITCH ON DISABLED to OPERATION ENABLED.
_TRANSITIONS: Final = 3
#: States on the way up, each higher than the one before.
_LADDER: Final = (
    State.NOT_READY,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
)


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


def refuse_unsafe(drive: Cia402Drive) -> None:
    """Make sure that the safety chain is closed and the encoder referenced, as far as the profile names the objects.

    Raises
    ------
    DriveFault
        They are not.
    """
    faults = drive.safety_faults()
    if faults:
        advice = "release the emergency stop, close the safety chain, or have the encoder referenced"
        raise DriveFault(f"must not move: {'; '.join(faults)}", node=drive.node_id, advice=advice)


def first_epoch(exchange: SyncExchange, again: Callable[[Epoch], bool] = lambda epoch: False) -> Epoch:
    """SYNC alone, until every drive answers: no command is sent before the position is known.

    Parameters
    ----------
    exchange : SyncExchange
    again : callable
        Asked after the usual number of SYNCs: whether those that do not answer are to be given more of them.

    Raises
    ------
    IncompleteEpochs, SeveralFailures
        Some do not.
    """
    epoch = exchange.cycle(None)
    tries = 1
    while not epoch.complete:
        more = again(epoch)
        if tries >= _FIRST_TRIES and not more:
            break
        epoch = exchange.cycle(None)
        tries += 1
    if epoch.complete:
        return epoch
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


class WayUp:
    """The way from SWITCH ON DISABLED to an open brake, watched at every SYNC.

    No axis is led up twice: one that falls back to a lower state ends it. The place that each axis is told to hold is
    the one before the first controlword, so that an axis that sags is pulled back and not followed.

    Parameters
    ----------
    exchange : SyncExchange
    guard : Guard
    stop_asked : callable
        Whether a person has asked to stop.
    """

    def __init__(self, exchange: SyncExchange, guard: Guard, stop_asked: Callable[[], bool]) -> None:
        machines = [drive.setup.profile.state_machine for drive in exchange.drives]
        #: Longest time that a brake takes to open.
        self.brake_s = max(machine.brake_delay_s for machine in machines)
        self._limit_s = _TRANSITIONS * max(machine.transition_timeout_s for machine in machines) + self.brake_s
        self._exchange, self._guard, self._stop_asked = exchange, guard, stop_asked
        self._since_s = 0.0
        self._held: tuple[int, ...] = ()

    def check_stop(self) -> None:
        """Give way to a person.

        Raises
        ------
        StopAsked
        """
        if self._stop_asked():
            raise StopAsked("stopped while the drives were being enabled", advice="all axes have been disabled")

    def walk(self, start: Epoch) -> Epoch:
        """Transitions to OPERATION ENABLED.

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
        DriveFault, TransitionTimeout, IncompleteEpochs, DriveRebooted, StopAsked, SeveralFailures
        """
        exchange, epoch = self._exchange, start
        states = exchange.states
        self._since_s = self._now_s()
        self._held = tuple(reading.position_count for reading in start.readings if reading is not None)
        waited = [0] * len(states)
        while True:
            raise_failures(_stuck(exchange, waited))
            for drive, count in zip(exchange.drives, self._held, strict=True):
                drive.hold(count)
            words = _words_up(exchange, self._guard)
            before = list(states)
            epoch = exchange.cycle(words)
            self._guard.check_bus()
            self._guard.check_silence()
            self._refuse_backward(before)
            self.check(epoch)
            if epoch.complete and all(state is State.OPERATION_ENABLED for state in states):
                return epoch
            for axis, state in enumerate(states):
                stands = state is before[axis] and state is not State.OPERATION_ENABLED
                waited[axis] = waited[axis] + 1 if stands else 0

    def check(self, epoch: Epoch) -> None:
        """What holds at every SYNC until the brakes are open.

        Raises
        ------
        DriveFault
            An axis moves away from where it stood.
        TransitionTimeout
            All of it takes too long.
        StopAsked
            A person asked to stop.
        """
        self.check_stop()
        raise_failures(self._moved(epoch))
        if self._now_s() - self._since_s > self._limit_s:
            raise_failures(self._late(epoch))

    def _now_s(self) -> float:
        """The time that counts: in lockstep that of the SYNCs."""
        exchange = self._exchange
        return exchange.sync_time_s if exchange.timing.pacing == "lockstep" else time.monotonic()

    def _refuse_backward(self, before: Sequence[State | None]) -> None:
        failures = []
        for drive, was, now in zip(self._exchange.drives, before, self._exchange.states, strict=True):
            if was in _LADDER and now in _LADDER and _LADDER.index(now) < _LADDER.index(was):
                what = f"fell back from {was} to {now} on the way up{self._guard.last_words(drive.node_id)}"
                advice = "check power stage, STO and enable input; it is not led up again by itself"
                failures.append(DriveFault(what, node=drive.node_id, index=0x6041, advice=advice))
        raise_failures(failures)

    def _moved(self, epoch: Epoch) -> list[DriveFault]:
        failures = []
        for drive, reading, held in zip(self._exchange.drives, epoch.readings, self._held, strict=True):
            if reading is None:
                continue
            turns = abs(reading.position_count - held) * drive.scale.count_rad / (2.0 * math.pi)
            if turns > SAG_REVOLUTIONS:
                what = f"moves while its brake opens: {turns:.2f} motor revolutions from where it stood"
                advice = "check the brake, the load and the torque limit 0x6072; the axis may sag when it is enabled"
                failures.append(DriveFault(what, node=drive.node_id, index=0x6064, advice=advice))
        return failures

    def _late(self, epoch: Epoch) -> list[TransitionTimeout]:
        advice = "check power stage, STO and enable input; the drive's display tells more"
        what = f"after {self._limit_s:.1f} s not all axes are enabled and answer"
        slow = [
            TransitionTimeout(f"{what}: it is in {state}", node=drive.node_id, index=0x6041, advice=advice)
            for drive, state, reading in zip(self._exchange.drives, self._exchange.states, epoch.readings, strict=True)
            if state is not State.OPERATION_ENABLED or reading is None
        ]
        return slow or [TransitionTimeout(what, advice=advice)]


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
