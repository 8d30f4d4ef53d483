"""Checks before enabling: no fault, safety chain closed, TPDO values equal to SDO values."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import fields
from typing import Final

from drives.bringup import POLL_S, read_identity
from drives.bus import Bus
from drives.cia402 import (
    AT_REST,
    DISABLE_VOLTAGE,
    FAULT_RESET,
    FAULTED,
    State,
    decode_state,
    describe,
)
from drives.drive import Cia402Drive
from drives.enabling import BRAKE_DROP_REVOLUTIONS
from drives.epoch import Epoch
from drives.errors import (
    ConfigurationRefused,
    DriveFault,
    DriveRebooted,
    IdentityMismatch,
    IncompleteEpochs,
    raise_failures,
)
from drives.exchange import SyncExchange
from drives.guard import Guard
from drives.heartbeat import HeartbeatWatch
from drives.objects import OBJECTS, object_name
from drives.pdo import differences
from drives.values import DriveReading

_FIRST_TRIES: Final = 10
#: Differences of one drive that a message names beside the first one.
_NAMED: Final = 8
_AGAIN: Final = "check its supply, then run the command again"
_LOST: Final = f"the drive restarted, was exchanged, or was written by another master: {_AGAIN}"
#: How far the first TPDO may be from SDO at standstill, in motor revolutions.
_AGREEMENT_REVOLUTIONS: Final = 0.01


def refuse_fault(drive: Cia402Drive, guard: Guard) -> None:
    """Make sure that a drive may be enabled.

    Raises
    ------
    DriveFault
        It is in FAULT, which the gateway does not reset, or already enabled.
    """
    status = drive.statusword()
    state = decode_state(status)
    if state in FAULTED:
        what = f"is in {describe(status)}: {drive.fault_text()}{guard.last_emergency(drive.node_id)}"
        advice = "find and remove the cause, then reset the fault by hand; it is never reset automatically"
    elif state not in AT_REST:
        what, advice = f"is in {describe(status)} before it was enabled", "disable it first"
    else:
        return
    raise DriveFault(what, node=drive.node_id, index=0x6041, code=status, advice=advice)


def reset_fault(drive: Cia402Drive) -> None:
    """Reset a fault by SDO at the request of a person.

    The drive has the transition time of its profile to leave FAULT.

    Raises
    ------
    DriveFault
        The drive is still in FAULT.
    """
    control = OBJECTS["controlword"]
    if decode_state(drive.statusword()) is State.FAULT:
        for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):
            drive.access.sdo.write(control.index, control.subindex, control.type, word)
    deadline_s = time.monotonic() + drive.setup.profile.state_machine.transition_timeout_s
    while decode_state(status := drive.statusword()) in FAULTED and time.monotonic() < deadline_s:
        drive.access.bus.listen(POLL_S)
    if decode_state(status) in FAULTED:
        what = f"is still in {describe(status)}: {drive.fault_text()}"
        raise DriveFault(
            what, node=drive.node_id, index=0x6041, code=status, advice="the cause of the fault is still present"
        )


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
    """Send SYNC without commands until every drive responds, so that no command is sent before its position is known.

    Parameters
    ----------
    exchange : SyncExchange
    again : callable
        Called after the usual number of SYNCs: whether to wait for more SYNCs for the drives that do not answer.

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
    what = f"does not respond to SYNC ({_FIRST_TRIES} sent)"
    raise_failures(
        [IncompleteEpochs(what, node=exchange.drives[axis].node_id, advice=advice) for axis in epoch.missing]
    )
    return epoch


def refuse_exchanged(drive: Cia402Drive) -> None:
    """Refuse a device that reports another identity than the one that was connected.

    Raises
    ------
    IdentityMismatch
        Vendor, product, revision, serial number, names or versions differ.
    """
    before, now = drive.identity, read_identity(drive.access.sdo)
    if before is None or now == before:
        return
    names = [field.name for field in fields(now) if getattr(now, field.name) != getattr(before, field.name)]
    changes = [f"{name.replace('_', ' ')} was {getattr(before, name)}, {getattr(now, name)} is read" for name in names]
    what = f"is not the device that was connected: {'; '.join(changes)}"
    raise IdentityMismatch(what, node=drive.node_id, index=0x1018, advice=f"it was not enabled: {_AGAIN}")


def refuse_rebooted(watch: HeartbeatWatch, bus: Bus) -> None:
    """Refuse drives whose boot-up was received since they were configured, once all of them have been read back.

    Raises
    ------
    DriveRebooted, SeveralFailures
        One error for each of them.
    """
    bus.listen(POLL_S)
    what = "restarted (boot-up message) after it was configured"
    advice = f"it was not enabled: {_AGAIN}"
    raise_failures([DriveRebooted(what, node=node, advice=advice) for node in sorted(watch.booted)])


def refuse_lost_configuration(drive: Cia402Drive) -> None:
    """Refuse a drive that no longer holds what was configured, or is not where it came to rest.

    While the arm is held by its brakes the drives are not monitored: a drive may restart, be exchanged or be written by
    another master. Every configured object and every PDO is read again, and the position is compared with the last one
    known.

    Raises
    ------
    ConfigurationRefused
        Every object and PDO that differs, with its value as configured and as read; the error names the first one. Or
        an interpolation period that is not the SYNC period.
    """
    mapped = {(each.index, each.subindex) for plan in drive.commands for each in plan.entries}
    lost = [
        (address, f"{value:#x} was configured, {now:#x} is read now")
        for address, value, now in drive.access.changed(without=mapped)
    ]
    pdos = [
        ((plan.mapping, 0), f"{plan.name} {', '.join(changed)} since it was configured")
        for plan in drive.plans
        if (changed := differences(plan, drive.access.sdo.read))
    ]
    if lost or pdos:
        ((index, subindex), first), *others = (*pdos, *lost)
        named = [f"{object_name(*address)}: {what}" for address, what in others[:_NAMED]]
        more = [f"and {len(others) - _NAMED} more"] if len(others) > _NAMED else []
        what = "; ".join([first, *named, *more])
        raise ConfigurationRefused(what, node=drive.node_id, index=index, subindex=subindex, advice=_LOST)
    drive.check_interpolation_period()
    position = drive.setup.profile.position.object
    if drive.rest_count is not None:
        count = drive.access.read(position)
        if abs(count - drive.rest_count) > abs(drive.scale.revolutions(BRAKE_DROP_REVOLUTIONS)):
            drive.access.refuse(
                position,
                f"the axis came to rest at {drive.rest_count} counts, {count} counts are read now",
                "the brake slipped, the axis was moved by hand, or the encoder lost its reference",
            )


def compare_with_sdo(drive: Cia402Drive, reading: DriveReading) -> None:
    """Refuse a drive whose first TPDO differs from SDO reads of the same objects, as with a shifted mapping.

    Raises
    ------
    ConfigurationRefused
        It does not.
    """
    position = drive.access.read(drive.setup.profile.position.object)
    status = drive.access.read(OBJECTS["statusword"])
    allowed = drive.scale.revolutions(_AGREEMENT_REVOLUTIONS) + 1.0
    same_state = decode_state(status) is decode_state(reading.statusword)
    if abs(position - reading.position_count) > allowed or not same_state:
        raise ConfigurationRefused(
            f"TPDO1 reports {describe(reading.statusword)} at {reading.position_count} counts, "
            f"SDO reports {describe(status)} at {position} counts",
            node=drive.node_id,
            index=drive.plans[1].mapping,
            advice="the PDO mapping is shifted, or the axis moves although it is not enabled",
        )
