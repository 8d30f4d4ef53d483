"""The gate before power and before a person: what was just read from every drive of an arm, as one record.

What may be done with an arm, and what is said of it, comes from an `ArmState`. The gate reads by SDO and writes
nothing. The brief gate reads state and position of each drive; boot-ups, emergencies and NMT states that came since the
last one count. The full gate also reads the identity, every configured object and PDO, and the conditions of the
safety chain.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import Final

from drives.bringup import check_interpolation_period
from drives.bus import Bus
from drives.cia402 import AT_REST, FAULTED, State, decode_state, describe
from drives.discovery import read_identity
from drives.drive import POLL_S, Cia402Drive
from drives.emcy import EmcyLog
from drives.enabling import BRAKE_DROP_REVOLUTIONS
from drives.errors import (
    ConfigurationRefused,
    DriveError,
    DriveFault,
    DriveRebooted,
    ForeignMaster,
    IdentityMismatch,
    SdoTimeout,
    raise_failures,
)
from drives.heartbeat import HeartbeatWatch, NmtState
from drives.objects import object_name
from drives.pdo import differences
from drives.sdo import NOT_ANSWERING

#: Differences of one drive that a message names beside the first one.
_NAMED: Final = 8
_AGAIN: Final = "check its supply, then run the command again"
_OTHER_MASTER: Final = "another master has started it: disconnect that one, then run the command again"
#: Heartbeats in OPERATIONAL that a drive may have sent before it received the command to leave it.
_SENT_BEFORE: Final = 1
#: All drives are asked at once whether they are there, so often, and looked at in this interval [s].
_QUESTIONS: Final = 2
_LOOK_S: Final = 0.001
_CONFIGURE: Final = "connect() and configure() again"
_LOST: Final = f"the drive restarted, was exchanged, or was written by another master: {_AGAIN}"


@dataclass(frozen=True, slots=True)
class DriveState:
    """What was read of one drive.

    Attributes
    ----------
    node_id : int
    state : State or None
        CiA 402 state; None = it was not read.
    failure : DriveError or None
        First reason against calling a person to the arm and against enabling it.
    unsafe : DriveError or None
        Reason against power alone. A fault, which leaves the axis in its brake. An open safety chain (full gate). An
        earlier finding, after which the drive has to be configured again.
    arm : str
        Which arm it belongs to, where several move together.
    """

    node_id: int
    state: State | None
    failure: DriveError | None = None
    unsafe: DriveError | None = None
    arm: str = ""


@dataclass(frozen=True, slots=True)
class ArmState:
    """What was read of all drives of one arm, or of several that move together.

    Attributes
    ----------
    drives : tuple of DriveState
    read_at : datetime
        UTC, before the first drive was read.
    is_full : bool
        Read by the full gate.
    """

    drives: tuple[DriveState, ...]
    read_at: datetime
    is_full: bool = False

    @classmethod
    def of(cls, states: Mapping[str, ArmState]) -> ArmState:
        """Return one record of several arms, by their names."""
        each = tuple(states.values())
        if len(each) == 1:
            return each[0]
        drives = tuple(replace(drive, arm=arm) for arm, state in states.items() for drive in state.drives)
        return cls(drives, min(state.read_at for state in each), all(state.is_full for state in each))

    @property
    def is_disabled(self) -> bool:
        """Return whether every drive was read in a state in which it exerts no torque."""
        return all(drive.state in AT_REST for drive in self.drives)

    @property
    def safe_to_approach(self) -> bool:
        """Return whether a person may be called to the arm: every drive is disabled, and nothing has changed."""
        return all(drive.failure is None for drive in self.drives)

    @property
    def safe_to_power(self) -> bool:
        """Return whether the drives may be enabled; never after a brief gate."""
        return self.is_full and self.safe_to_approach and all(drive.unsafe is None for drive in self.drives)

    def require_approach(self) -> None:
        """Raise the failures of all drives, unless a person may be called to the arm."""
        if not self.safe_to_approach:
            raise_failures([drive.failure for drive in self.drives if drive.failure is not None])

    def require_power(self) -> None:
        """Raise the failures of all drives, unless they may be enabled.

        Raises
        ------
        ConfigurationRefused
            Also where nothing is wrong after a brief gate, which does not read what power needs.
        """
        if not self.safe_to_power:
            reasons = [drive.unsafe or drive.failure for drive in self.drives]
            raise_failures([reason for reason in reasons if reason is not None])
            raise ConfigurationRefused("not everything was read that power needs", advice="read the full gate")

    def __str__(self) -> str:
        """Say what is known of the arm, as one sentence without its full stop."""
        if self.is_disabled:
            return f"every drive was read as disabled at {self.read_at:%H:%M:%S} UTC"
        rest = [drive for drive in self.drives if drive.state not in AT_REST]
        nodes = "; ".join(
            f"{drive.arm and f'arm {drive.arm}, '}node {drive.node_id}: {drive.state or 'not read'}" for drive in rest
        )
        return f"the state of the arm is not known: use the emergency stop ({nodes})"


class Gate:
    """Gate of the drives that share one SYNC.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
        Configured.
    watch : HeartbeatWatch
        Has the boot-ups since the drives were configured.
    emcy : EmcyLog
        Emergencies count that came after the gate before, and after `restart`.

    A drive that was found exchanged, restarted, moved, written by others or not stopped is not enabled until it is
    configured again, for which there is a new gate.
    """

    def __init__(self, bus: Bus, drives: Sequence[Cia402Drive], watch: HeartbeatWatch, emcy: EmcyLog) -> None:
        self._bus, self._drives, self._watch, self._emcy = bus, tuple(drives), watch, emcy
        self._emergencies = emcy.count
        #: By node: why it has to be configured again.
        self._lost: dict[int, ConfigurationRefused] = {}

    def mistrust(self, failures: Iterable[DriveError]) -> None:
        """Require drives to be configured again before they are enabled; a failure without a node is one of all."""
        for failure in failures:
            for node in [drive.node_id for drive in self._drives] if failure.node is None else [failure.node]:
                what = f"has to be configured again: {failure.what}"
                self._lost.setdefault(node, ConfigurationRefused(what, node=node, advice=_CONFIGURE))

    def restart(self) -> None:
        """The drives have been disabled: emergencies of the motion are not those of drives in their brakes."""
        self._emergencies = self._emcy.count

    def read(self, *, full: bool) -> ArmState:
        """Read every drive; an error is part of the record, so that the others are read too.

        Parameters
        ----------
        full : bool
            Also identity, configuration and the conditions for power.
        """
        began = datetime.now(UTC)
        try:
            silent = self._silent()
            read = [silent.get(drive.node_id) or self._read(drive, full) for drive in self._drives]
            self._bus.listen(POLL_S)  # a boot-up or an emergency that was sent while the last drive was read
        except DriveError as error:
            self.mistrust([error])
            return ArmState(tuple(DriveState(drive.node_id, None, error) for drive in self._drives), began, full)
        new, self._emergencies = self._emcy.count - self._emergencies, self._emcy.count
        latest = {each.node_id: each for each in self._emcy.messages[-new:]} if new else {}
        is_stopped = self._watch.commanded is not NmtState.OPERATIONAL
        states: list[DriveState] = []
        for drive in read:
            failure, sent = drive.failure, latest.get(drive.node_id)
            if failure is None and drive.node_id in self._watch.booted:
                what = "restarted (boot-up message) after it was configured"
                failure = DriveRebooted(what, node=drive.node_id, advice=_AGAIN)
            elif failure is None and sent is not None and not sent.is_harmless:
                what = f"sent an emergency while it was disabled: {sent.what}"
                failure = DriveFault(what, node=drive.node_id, code=sent.code, advice=sent.advice or _AGAIN)
            elif failure is None and is_stopped and self._watch.contrary[drive.node_id] > _SENT_BEFORE:
                what = "is in NMT state OPERATIONAL, in which a PDO can enable it; this master did not command it"
                failure = ForeignMaster(what, node=drive.node_id, advice=_OTHER_MASTER)
            states.append(replace(drive, failure=failure, unsafe=drive.unsafe or self._lost.get(drive.node_id)))
        self.mistrust(each.failure for each in states if each.failure and type(each.failure) is not DriveFault)
        return ArmState(tuple(states), began, full)

    def _silent(self) -> dict[int, DriveState]:
        """Return the drives that do not answer, by node: together they take no longer to find than one."""
        waiting = [drive.access.sdo for drive in self._drives]
        began_s = time.monotonic()
        for _ in range(_QUESTIONS):
            asked = [(sdo, sdo.ask()) for sdo in waiting]
            until_s = time.monotonic() + max((sdo.timeout_s for sdo in waiting), default=0.0)
            while (waiting := [sdo for sdo, answer in asked if not answer.answered]) and time.monotonic() < until_s:
                self._bus.listen(_LOOK_S)
        what = f"no SDO answer within {(time.monotonic() - began_s) * 1e3:.0f} ms"
        return {
            sdo.node_id: DriveState(sdo.node_id, None, SdoTimeout(what, node=sdo.node_id, advice=NOT_ANSWERING))
            for sdo in waiting
        }

    def _read(self, drive: Cia402Drive, full: bool) -> DriveState:
        """Read one drive up to the first reason against power and against a person at the arm."""
        state, node, unsafe = None, drive.node_id, None
        try:
            status = drive.statusword()
            state = decode_state(status)
            if state in FAULTED:
                what = f"is in {describe(status)}: {drive.fault_text()}{self._emcy.last_clause(node)}"
                advice = "find and remove the cause, then reset the fault by hand; it is never reset automatically"
                unsafe = DriveFault(what, node=node, index=0x6041, code=status, advice=advice)
            if state not in AT_REST:
                what, advice = f"is energised: {describe(status)}", "`servo-gateway restore CELL` disables it"
                raise unsafe or DriveFault(what, node=node, index=0x6041, code=status, advice=advice)
            if full:
                before, now = drive.identity, read_identity(drive.access.sdo)
                if now != before:
                    names = [each.name for each in fields(now) if getattr(now, each.name) != getattr(before, each.name)]
                    changes = "; ".join(
                        f"{name.replace('_', ' ')} was {getattr(before, name)}, {getattr(now, name)} is read"
                        for name in names
                    )
                    what = f"does not identify itself as the device that was connected: {changes}"
                    raise IdentityMismatch(what, node=node, index=0x1018, advice=_AGAIN)
                _refuse_lost_configuration(drive)
                if unsafe is None and (faults := drive.safety_faults()):
                    advice = "release the emergency stop, close the safety chain, or have the encoder referenced"
                    unsafe = DriveFault(f"must not move: {'; '.join(faults)}", node=node, advice=advice)
            if drive.rest_count is not None:
                position = drive.setup.profile.position.object
                count = drive.access.read(position)
                if abs(count - drive.rest_count) > abs(drive.scale.revolutions(BRAKE_DROP_REVOLUTIONS)):
                    what = f"the axis came to rest at {drive.rest_count} counts, {count} counts are read now"
                    advice = "the brake slipped, the axis was moved by hand, or the encoder lost its reference"
                    drive.access.refuse(position, what, advice)
        except DriveError as error:
            return DriveState(node, state, error, unsafe)
        return DriveState(node, state, unsafe=unsafe)


def _refuse_lost_configuration(drive: Cia402Drive) -> None:
    """Refuse a drive that no longer holds what was configured; every object and PDO that differs is named."""
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
    check_interpolation_period(drive.access, drive.sync_period_s)
