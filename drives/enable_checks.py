"""While drives are enabled: every drive answers SYNC, and its TPDOs report what SDO reads; reset of a fault."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from drives.bringup import POLL_S
from drives.cia402 import DISABLE_VOLTAGE, FAULT_RESET, FAULTED, State, decode_state, describe
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import ConfigurationRefused, DriveFault, IncompleteEpochs, raise_failures
from drives.exchange import SyncExchange
from drives.objects import OBJECTS
from drives.values import DriveReading

_FIRST_TRIES: Final = 10
#: How far the first TPDO may be from SDO at standstill, in motor revolutions.
_AGREEMENT_REVOLUTIONS: Final = 0.01


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
