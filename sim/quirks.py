"""Deviations of a simulated drive from a tolerant one: strict, unresponsive, flooding or defective.

Everything here is read where it acts (objects, PDOs, network management, motion). A default `Quirks` describes a drive
without deviations; the settings persist over an NMT reset, as firmware and hardware do.
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
#: A SYNC period that differs from 0x1006 by this share is wrong; so many of them in a row end OPERATIONAL.
CYCLE_SHARE, CYCLES = 0.5, 3
#: TPDO that floods the bus, counted from 0, and what it may have to catch up at once [s].
FLOODING, MOST_FLOOD_S = 2, 0.1


@dataclass(slots=True)
class Quirks:
    """Of one drive.

    Attributes
    ----------
    inhibit_abort : SDO abort code of an inhibit time that is written while the PDO exists
    inhibit_100us : inhibit time of the TPDOs at power-up
    start_refused_s : duration of a communication error after the first START; meanwhile START is refused
    watches_cycle : SYNC is compared with 0x1006, and OPERATIONAL is left where they differ
    without_data : indices that answer "no data available"
    flood_hz : rate at which TPDO3, switched on at power-up, sends unrequested; 0 = off at power-up
    values : objects that hold another value from power-up on
    sto_open : the safety circuit is open (emergency stop pressed)
    unreferenced : the encoder has lost its reference
    mute_heartbeat : never sends a heartbeat, whatever 0x1017 says
    drops_after : SYNCs after which OPERATION ENABLED falls back to SWITCHED ON, every time; 0 = never
    never_enables : stays in SWITCHED ON
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
    """Interface of a drive used by its conduct."""

    node: SlaveNode
    store: ObjectStore
    quirks: Quirks

    @property
    def enabled(self) -> bool:
        """Whether it is in OPERATION ENABLED."""
        ...

    def drop_out(self) -> None:
        """Fall back from OPERATION ENABLED to SWITCHED ON."""

    def transmit(self, tpdo: Pdo) -> None:
        """Put one TPDO on the bus."""


class Conduct:
    """How a drive with quirks behaves on the network.

    Parameters
    ----------
    drive : whose quirks are looked at whenever they matter

    Attributes
    ----------
    clock : monotonic clock of a communication error
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
        """Return whether START is obeyed: not while the communication error is active, which is reported each time."""
        node, lasts_s = self._drive.node, self._drive.quirks.start_refused_s
        if not lasts_s:
            return True
        now = self.clock()
        self._refused_at_s = now if self._refused_at_s is None else self._refused_at_s
        standing = now - self._refused_at_s < lasts_s
        if standing:
            node.emergency(EMCY_COMMUNICATION, node.error_register | REGISTER_COMMUNICATION)
        elif self._erroneous:
            node.emergency(0, 0)
        self._erroneous = standing
        return not standing

    def refuse(self, index: int, _subindex: int) -> int | None:
        """Abort code of an SDO request, None = none."""
        return NO_DATA if index in self._drive.quirks.without_data else None

    def sync_came(self, time_s: float) -> None:
        """Compare SYNC with 0x1006; count how long the drive has been enabled."""
        drive, quirks = self._drive, self._drive.quirks
        if quirks.drops_after:
            self._enabled_syncs = self._enabled_syncs + 1 if drive.enabled else 0
            if self._enabled_syncs > quirks.drops_after:
                drive.drop_out()
        if not quirks.watches_cycle:
            return
        stated_s = drive.store.number((0x1006, 0)) * 1e-6
        before_s, self._synced_at_s = self._synced_at_s, time_s
        if not stated_s or before_s is None:
            return
        wrong = abs(time_s - before_s - stated_s) > CYCLE_SHARE * stated_s
        self._wrong_cycles = self._wrong_cycles + 1 if wrong else 0
        if self._wrong_cycles >= CYCLES and drive.node.state == OPERATIONAL:
            drive.node.emergency(EMCY_COMMUNICATION, drive.node.error_register | REGISTER_COMMUNICATION)
            drive.node.enter(PRE_OPERATIONAL)

    def flood(self, tpdo: Pdo, time_s: float) -> None:
        """Send what has become due of a TPDO that sends at a rate of its own."""
        rate_hz = self._drive.quirks.flood_hz
        if self._flooded_s is None or time_s - self._flooded_s > MOST_FLOOD_S:
            self._flooded_s = time_s if self._flooded_s is None else time_s - MOST_FLOOD_S
        for _ in range(int((time_s - self._flooded_s) * rate_hz)):
            self._flooded_s += 1.0 / rate_hz
            self._drive.transmit(tpdo)
