"""Deviations of a simulated drive from a tolerant and healthy one: strict, unresponsive, flooding or defective.

The objects, PDOs, network management and motion of the drive read these settings. A default `Quirks` describes a drive
without deviations. The settings persist over an NMT reset, as properties of firmware and hardware do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from sim.node import OPERATIONAL, PRE_OPERATIONAL, SlaveNode
from sim.objects import DEVICE_STATE, NO_DATA, Address, ObjectStore
from sim.pdo import Pdo

EMCY_COMMUNICATION = 0x8100
REGISTER_COMMUNICATION = 0x11
#: A SYNC period that differs from 0x1006 by this share is wrong; this number of them in a row ends OPERATIONAL.
SYNC_PERIOD_TOLERANCE, MAX_WRONG_PERIODS = 0.5, 3
#: Index of the TPDO that floods the bus (0 = TPDO1), and the longest backlog that it sends at once [s].
FLOODING_TPDO, MAX_FLOOD_BACKLOG_S = 2, 0.1


@dataclass(slots=True)
class Quirks:
    """Settings that make one simulated drive deviate from a tolerant and healthy one.

    Attributes
    ----------
    inhibit_abort : SDO abort code when an inhibit time is written while the PDO is valid
    inhibit_100us : inhibit time of the TPDOs at power-up [100 us]
    start_refused_s : duration of a communication error after the first START; until then START is refused
    watches_cycle : compares the SYNC period with 0x1006 and changes to PRE-OPERATIONAL if they differ
    without_data : object indices whose SDO requests are aborted with "no data available"
    flood_hz : rate at which TPDO3, valid at power-up, is sent without a trigger; 0 = TPDO3 is invalid at power-up
    values : objects whose value at power-up differs from the default
    sto_open : the safety circuit is open (emergency stop pressed)
    unreferenced : the encoder has lost its reference
    mute_heartbeat : never sends a heartbeat, whatever 0x1017 says
    drops_after : number of SYNCs after which every OPERATION ENABLED falls back to SWITCHED ON; 0 = never
    never_enables : stays in SWITCHED ON when commanded to OPERATION ENABLED
    """

    inhibit_abort: int = DEVICE_STATE
    inhibit_100us: int = 0
    start_refused_s: float = 0.0
    watches_cycle: bool = False
    without_data: frozenset[int] = frozenset()
    flood_hz: float = 0.0
    values: dict[Address, int] = field(default_factory=dict)
    sto_open: bool = False
    unreferenced: bool = False
    mute_heartbeat: bool = False
    drops_after: int = 0
    never_enables: bool = False


class QuirkyDrive(Protocol):
    """What `QuirkBehaviour` reads and commands of its drive."""

    node: SlaveNode
    store: ObjectStore
    quirks: Quirks

    @property
    def enabled(self) -> bool:
        """Return whether the drive is in OPERATION ENABLED."""
        ...

    def drop_out(self) -> None:
        """Fall back from OPERATION ENABLED to SWITCHED ON."""

    def transmit(self, tpdo: Pdo) -> None:
        """Send one TPDO."""


class QuirkBehaviour:
    """Network behaviour of a drive with quirks: NMT, SDO, SYNC and TPDOs.

    Parameters
    ----------
    drive : the drive; its quirks are read at every use, so they may change at any time

    Attributes
    ----------
    clock : monotonic clock that measures the communication error's duration
    """

    def __init__(self, drive: QuirkyDrive) -> None:
        self._drive = drive
        self.clock: Callable[[], float] = time.monotonic
        self._refused_at_s: float | None = None
        self._erroneous = False
        self._synced_at_s: float | None = None
        self._wrong_cycles = 0
        self._flooded_s: float | None = None
        self._enabled_syncs = 0

    def entered_operational(self) -> None:
        """Reset the SYNC comparison when OPERATIONAL is entered."""
        self._synced_at_s = self._flooded_s = None
        self._wrong_cycles = 0

    def may_start(self) -> bool:
        """Return whether NMT START is obeyed; while the communication error is active, send its EMCY and refuse."""
        node, lasts_s = self._drive.node, self._drive.quirks.start_refused_s
        if not lasts_s:
            return True
        now = self.clock()
        self._refused_at_s = now if self._refused_at_s is None else self._refused_at_s
        error_active = now - self._refused_at_s < lasts_s
        if error_active:
            node.emergency(EMCY_COMMUNICATION, node.error_register | REGISTER_COMMUNICATION)
        elif self._erroneous:
            node.emergency(0, 0)
        self._erroneous = error_active
        return not error_active

    def refuse(self, index: int, _subindex: int) -> int | None:
        """Return the SDO abort code of a request for object `index`, or None if the request is served."""
        return NO_DATA if index in self._drive.quirks.without_data else None

    def sync_received(self, time_s: float) -> None:
        """Compare the SYNC period with 0x1006, and count the SYNCs in OPERATION ENABLED, as the quirks require."""
        drive, quirks = self._drive, self._drive.quirks
        if quirks.drops_after:
            self._enabled_syncs = self._enabled_syncs + 1 if drive.enabled else 0
            if self._enabled_syncs > quirks.drops_after:
                drive.drop_out()
        if not quirks.watches_cycle:
            return
        period_s = drive.store.number((0x1006, 0)) * 1e-6
        previous_s, self._synced_at_s = self._synced_at_s, time_s
        if not period_s or previous_s is None:
            return
        wrong = abs(time_s - previous_s - period_s) > SYNC_PERIOD_TOLERANCE * period_s
        self._wrong_cycles = self._wrong_cycles + 1 if wrong else 0
        if self._wrong_cycles >= MAX_WRONG_PERIODS and drive.node.state == OPERATIONAL:
            drive.node.emergency(EMCY_COMMUNICATION, drive.node.error_register | REGISTER_COMMUNICATION)
            drive.node.enter(PRE_OPERATIONAL)

    def flood(self, tpdo: Pdo, time_s: float) -> None:
        """Send the frames of the flooding TPDO that are due at `time_s` at the rate `flood_hz`."""
        rate_hz = self._drive.quirks.flood_hz
        if self._flooded_s is None or time_s - self._flooded_s > MAX_FLOOD_BACKLOG_S:
            self._flooded_s = time_s if self._flooded_s is None else time_s - MAX_FLOOD_BACKLOG_S
        for _ in range(int((time_s - self._flooded_s) * rate_hz)):
            self._flooded_s += 1.0 / rate_hz
            self._drive.transmit(tpdo)
