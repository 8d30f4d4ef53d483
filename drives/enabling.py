"""Enable all axes: NMT START, comparison of PDO and SDO, the CiA 402 transitions, open brakes.

CiA 301 defines no answer to an NMT command. The NMT state is taken from the node's heartbeat or, where the profile sets
none, from its answers to SYNC, which are sent in OPERATIONAL only. A node may refuse START while a communication error
is active: the command is repeated.

No axis is enabled twice: an axis that falls back to a lower state ends the sequence. The target of each axis is its
position before the first controlword, so that an axis that drops is pulled back.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from drives.bringup import check_mode, refuse_mode
from drives.bus import Bus
from drives.cia402 import NoRoute, State, decode_state, describe, enabling_controlword
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import (
    ConfigurationRefused,
    DriveError,
    DriveFault,
    HeartbeatLost,
    IncompleteEpochs,
    NotOperational,
    StopRequested,
    TransitionTimeout,
    raise_failures,
)
from drives.exchange import SyncExchange
from drives.heartbeat import NmtCommand, NmtState, send_nmt
from drives.instrument import Instrument
from drives.monitor import Monitor
from drives.objects import OBJECTS
from drives.sdo import Posted

#: Interval at which START is repeated to a node that is not OPERATIONAL, and how long: at least so many heartbeats [s].
_REPEAT_S: Final = 0.2
_PATIENCE_S: Final = 2.0
_BEATS: Final = 3.0
_SLICE_S: Final = 0.01
#: SYNCs that a drive may leave unanswered at first.
_FIRST_TRIES: Final = 10
#: How far the first TPDO may be from SDO at standstill, in motor revolutions.
_AGREEMENT_REVOLUTIONS: Final = 0.01
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
_STUCK: Final = "check power stage, STO and enable input, and the drive's display"


def enable(
    bus: Bus,
    exchange: SyncExchange,
    instruments: Sequence[Instrument],
    monitor: Monitor,
    stop_requested: Callable[[], bool],
) -> Epoch:
    """Bring configured drives, whose SYNC has not begun, from PRE-OPERATIONAL to OPERATION ENABLED with open brakes.

    Parameters
    ----------
    bus : Bus
    exchange : SyncExchange
    instruments : sequence of Instrument
        Started too, but not waited for: a row is complete without them.
    monitor : Monitor
    stop_requested : callable
        Whether a person has requested a stop; called at every SYNC.

    Returns
    -------
    Epoch
        Complete, every axis enabled.

    Raises
    ------
    StopRequested
    NotOperational, HeartbeatLost, IncompleteEpochs
        A node does not start, or does not answer SYNC.
    ConfigurationRefused
        PDO and SDO report different values, or another mode is shown.
    DriveFault, TransitionTimeout, DriveRebooted, ForeignMaster, BusOff, SeveralFailures
        An axis falls back, moves, or stays in a state; other events on the bus.
    """

    drives, watch = exchange.drives, monitor.watch

    def check_stop() -> None:
        if stop_requested():
            raise StopRequested("a stop was requested while the drives were being enabled")

    def start(node_ids: Sequence[int]) -> float:
        for node_id in node_ids:
            send_nmt(bus, NmtCommand.START, node_id)
        return time.monotonic()

    def start_again(node_ids: Sequence[int]) -> None:
        nonlocal sent_s
        if time.monotonic() - sent_s >= _REPEAT_S:
            sent_s = start(node_ids)

    def down(those: Sequence[Cia402Drive]) -> list[Cia402Drive]:
        return [drive for drive in those if watch.states[drive.node_id] is not NmtState.OPERATIONAL]

    def until_complete() -> Epoch:
        """Send SYNC until every axis has answered one: no command is sent before all positions are known."""
        exchange.clock.restart()
        since_s, tries = time.monotonic(), 1
        while not (epoch := exchange.cycle(None)).complete:
            check_stop()
            silent = down([drives[axis] for axis in epoch.missing])
            if silent and time.monotonic() - since_s > _PATIENCE_S:
                raise_failures([_not_operational(drive, monitor) for drive in silent])
            mute = [device for device, reading in zip(instruments, epoch.instruments, strict=True) if reading is None]
            start_again([node.node_id for node in (*silent, *mute)])
            if tries >= _FIRST_TRIES and not silent:
                advice = "check that its TPDOs are synchronous and that it is in NMT state OPERATIONAL"
                what = f"does not respond to SYNC ({_FIRST_TRIES} sent)"
                raise_failures(
                    [IncompleteEpochs(what, node=drives[axis].node_id, advice=advice) for axis in epoch.missing]
                )
            tries += 1
        return epoch

    bus.drain()
    for drive in drives:
        watch.states[drive.node_id] = None
    began_s = sent_s = start([node.node_id for node in (*drives, *instruments)])
    beating = [drive for drive in drives if drive.setup.profile.heartbeat.producer_ms is not None]
    while waiting := down(beating):
        slowest_s = max(drive.setup.profile.heartbeat.producer_ms or 0 for drive in waiting) / 1000.0
        if time.monotonic() - began_s > max(_PATIENCE_S, _BEATS * slowest_s):
            raise_failures([_not_operational(drive, monitor) for drive in waiting])
        start_again([drive.node_id for drive in waiting])
        check_stop()
        bus.listen(_SLICE_S)
        monitor.check_rules("bus")
    epoch = until_complete()
    monitor.forgive_cleared()  # a node may report why it refuses START, and that the cause was cleared
    _compare_with_sdo(drives, epoch)
    epoch = until_complete()  # SDO took its time: the positions before the first controlword are read again
    return _walk(exchange, monitor, epoch, check_stop)


def _not_operational(drive: Cia402Drive, monitor: Monitor) -> DriveError:
    state, producer_ms = monitor.watch.states[drive.node_id], drive.setup.profile.heartbeat.producer_ms
    if state is None and producer_ms is not None:
        what = f"sends no heartbeat, although 0x1017 is {producer_ms} ms"
        advice = "check the drive; leave heartbeat.producer_ms out of the profile if it has no heartbeat"
        return HeartbeatLost(what, node=drive.node_id, index=0x1017, advice=advice)
    said = "its NMT state is not known" if state is None else f"it is in NMT state {str(state).upper()}"
    what = f"does not go to OPERATIONAL, commanded for {_PATIENCE_S:.0f} s: {said}"
    what += monitor.emcy.last_clause(drive.node_id)
    advice = "a communication error may be active: read 0x1001, 0x1003, error behaviour 0x1029 and SYNC period 0x1006"
    return NotOperational(what, node=drive.node_id, advice=f"{advice}; remove its cause, or switch it off and on")


def _compare_with_sdo(drives: Sequence[Cia402Drive], epoch: Epoch) -> None:
    """Refuse drives whose first TPDO differs from SDO reads of the same objects, or that show another mode by now."""
    failures: list[DriveError] = []
    readings = [reading for reading in epoch.readings if reading is not None]  # the epoch is complete
    for drive, reading in zip(drives, readings, strict=True):
        try:
            status, position, _ = drive.read_axis()
            check_mode(drive)
        except DriveError as error:
            failures.append(error)
            continue
        allowed = drive.scale.revolutions(_AGREEMENT_REVOLUTIONS) + 1.0
        same_state = decode_state(status) is decode_state(reading.statusword)
        if abs(position - reading.position_count) > allowed or not same_state:
            what = (
                f"TPDO1 reports {describe(reading.statusword)} at {reading.position_count} counts, "
                f"SDO reports {describe(status)} at {position} counts"
            )
            advice = "the PDO mapping is shifted, or the axis moves although it is not enabled"
            index = drive.plans[1].mapping
            failures.append(ConfigurationRefused(what, node=drive.node_id, index=index, advice=advice))
    raise_failures(failures)


def _walk(exchange: SyncExchange, monitor: Monitor, epoch: Epoch, check_stop: Callable[[], None]) -> Epoch:
    """Command the transitions to OPERATION ENABLED, and hold each axis until its brake is open and its mode shown."""
    drives, states, timing = exchange.drives, exchange.states, exchange.timing
    machines = [drive.setup.profile.state_machine for drive in drives]
    brake_s = max(machine.brake_delay_s for machine in machines)
    limit_s = _TRANSITIONS * max(machine.transition_timeout_s for machine in machines) + brake_s
    held = tuple(reading.position_count for reading in epoch.readings if reading is not None)
    display = OBJECTS["mode_display"]
    #: Of each drive whose mode is not known since all are enabled: the open question. Some show 0 until then.
    asked: dict[Cia402Drive, Posted] = {}

    began_s, held_s, waited, all_enabled = epoch.time_s, 0.0, [0] * len(drives), False
    while not all_enabled or held_s < brake_s or asked or not epoch.complete:
        check_stop()
        for drive, count in zip(drives, held, strict=True):
            drive.hold(count)
        before, words = list(states), _enable_controlwords(exchange)
        epoch = exchange.cycle(words)
        monitor.emcy.sync_index = epoch.sync_index
        if all_enabled:
            monitor.check(epoch)
            held_s += timing.period_s
        else:
            monitor.check_rules("started")
        for axis, state in enumerate(states):
            unchanged = state is before[axis] and state is not State.OPERATION_ENABLED
            waited[axis] = waited[axis] + 1 if unchanged else 0
        _refuse_astray(exchange, epoch, before, held, waited)
        check_stop()
        if not all_enabled and epoch.complete and all(state is State.OPERATION_ENABLED for state in states):
            all_enabled = True
            asked = {drive: drive.access.sdo.post(*display.address, display.type) for drive in drives}
        for drive, answer in list(asked.items()):
            if answer.value == drive.mode.value:
                del asked[drive]
            elif answer.answered or time.monotonic() > answer.until_s:
                if epoch.time_s - began_s > limit_s:
                    refuse_mode(drive.access, drive.mode, answer.value)
                asked[drive] = drive.access.sdo.post(*display.address, display.type)
        if epoch.time_s - began_s > limit_s and not asked:
            raise_failures(_overdue(exchange, epoch, limit_s))
    return epoch


def _enable_controlwords(exchange: SyncExchange) -> list[int]:
    words: list[int] = []
    failures = []
    for drive, state in zip(exchange.drives, exchange.states, strict=True):
        try:
            words.append(0 if state is None else enabling_controlword(state))
        except NoRoute as error:
            what = f"{error}: {drive.fault_text()}"
            advice = "find and remove the cause; nothing is reset automatically"
            failures.append(DriveFault(what, node=drive.node_id, index=0x6041, advice=advice))
    raise_failures(failures)
    return words


def _refuse_astray(
    exchange: SyncExchange, epoch: Epoch, before: Sequence[State | None], held: Sequence[int], waited: Sequence[int]
) -> None:
    """Refuse axes that fell back, move although they are held, or stay in a state."""
    failures: list[DriveError] = []
    for axis, (drive, was, now) in enumerate(zip(exchange.drives, before, exchange.states, strict=True)):
        node, reading, limit_s = (
            drive.node_id,
            epoch.readings[axis],
            drive.setup.profile.state_machine.transition_timeout_s,
        )
        turns = 0.0 if reading is None else abs(reading.position_count - held[axis]) / drive.scale.revolutions(1.0)
        if was in _LADDER and now in _LADDER and _LADDER.index(now) < _LADDER.index(was):
            what = f"fell back from {was} to {now} while being enabled"
            advice = "check power stage, STO and enable input; it is not enabled again automatically"
            failures.append(DriveFault(what, node=node, index=0x6041, advice=advice))
        elif turns > BRAKE_DROP_REVOLUTIONS:
            what = f"moves while its brake opens: {turns:.2f} motor revolutions from its position"
            advice = "check the brake, the load and the torque limit 0x6072; the axis may drop when it is enabled"
            failures.append(DriveFault(what, node=node, index=0x6064, advice=advice))
        elif waited[axis] * exchange.timing.period_s > limit_s:
            what = f"stays in {now} for more than {limit_s} s in the transition to OPERATION ENABLED"
            failures.append(TransitionTimeout(what, node=node, index=0x6041, advice=_STUCK))
    raise_failures(failures)


def _overdue(exchange: SyncExchange, epoch: Epoch, limit_s: float) -> list[TransitionTimeout]:
    what = f"after {limit_s:.1f} s not all axes are enabled and responding"
    slow = [
        TransitionTimeout(f"{what}: it is in {state}", node=drive.node_id, index=0x6041, advice=_STUCK)
        for drive, state, reading in zip(exchange.drives, exchange.states, epoch.readings, strict=True)
        if state is not State.OPERATION_ENABLED or reading is None
    ]
    return slow or [TransitionTimeout(what, advice=_STUCK)]
