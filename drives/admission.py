"""Decide which nodes may be driven: only simulators in lockstep and on networks, only nodes whose EMCY can be
received.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from drives.access import NodeAccess
from drives.bringup import emergency_id, is_simulator
from drives.bus import EMCY_BASE, Bus, Handler
from drives.bus_spec import NETWORKS, BusSpec
from drives.drive import Cia402Drive
from drives.emcy import EmcyLog
from drives.errors import ConfigurationRefused
from drives.exchange import Pacing
from drives.instrument import Instrument


@dataclass(frozen=True, slots=True)
class Admission:
    """Rules for which nodes may be operated over a bus.

    Attributes
    ----------
    spec : BusSpec
    pacing : "lockstep" or "real"
    allow_real_drive : bool
        A node that is not a simulator may be driven over a network; never in lockstep.
    """

    spec: BusSpec
    pacing: Pacing
    allow_real_drive: bool

    def check(self, node: Cia402Drive | Instrument) -> None:
        """Refuse a real drive in lockstep, and over a network unless `allow_real_drive` is set.

        Raises
        ------
        ConfigurationRefused
        """
        lockstep = self.pacing == "lockstep"
        network = self.spec.interface in NETWORKS and not self.allow_real_drive
        if not (lockstep or network) or is_simulator(node.access.sdo):
            return
        if lockstep:
            what = "is not a simulator (object 0x5FFE): in lockstep it would receive SYNC as fast as it responds"
            raise ConfigurationRefused(what, node=node.node_id, advice='write pacing = "real" for this bus in the cell')
        what = f"is not a simulator (object 0x5FFE), and any computer on {self.spec} can write frames to it"
        advice = "connect it through its own CAN adapter, or accept the risk with allow_real_drive = true for this bus"
        raise ConfigurationRefused(what, node=node.node_id, advice=advice)


class EmergencyListener:
    """Receiver of EMCY messages on the identifiers that the drives state in 0x1014; stores them by node id.

    Parameters
    ----------
    bus : Bus
    log : EmcyLog
        Where messages go.
    """

    def __init__(self, bus: Bus, log: EmcyLog) -> None:
        self._bus, self._log = bus, log
        self._listeners: dict[int, Handler] = {}

    def add(self, access: NodeAccess, taken: Collection[int]) -> None:
        """Listen to one drive.

        Parameters
        ----------
        access : NodeAccess
        taken : collection of int
            Identifiers of other messages.

        Raises
        ------
        ConfigurationRefused
            It sends none, or with an identifier that another message has.
        """
        own_id = EMCY_BASE + access.node_id
        can_id = emergency_id(access) or own_id
        if can_id in taken or can_id in self._listeners:
            raise ConfigurationRefused(
                f"EMCY messages use the identifier {can_id:03X}, which another message also uses",
                node=access.node_id,
                index=0x1014,
                advice=f"set 0x1014 to {own_id:#x} in the drive",
            )

        def on_frame(_can_id: int, data: bytes | bytearray, time_s: float) -> None:
            self._log.on_frame(own_id, data, time_s)

        self._bus.subscribe(can_id, on_frame)
        self._listeners[can_id] = on_frame

    def close(self) -> None:
        """Stop receiving."""
        for can_id, listener in self._listeners.items():
            self._bus.unsubscribe(can_id, listener)
        self._listeners.clear()
