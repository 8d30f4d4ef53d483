"""CANopen device whose PDOs are exchanged at SYNC: what a simulated drive and a simulated instrument have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import can

from sim.node import OPERATIONAL, SlaveNode
from sim.objects import Address, ObjectStore
from sim.pdo import DISABLED, Pdo

PDO_COUNT = 4


class Device:
    """Objects, network node and PDOs of one device; a subclass fills the store, then calls `connect`.

    Parameters
    ----------
    node_id : CANopen node id
    send : sends a frame on the bus

    Attributes
    ----------
    node : SlaveNode; store : object dictionary
    tpdos, rpdos : its PDOs
    put : sends a frame on the bus
    """

    node: SlaveNode

    def __init__(self, node_id: int, send: Callable[[can.Message], None]) -> None:
        self.node_id, self.put = node_id, send
        self.store = ObjectStore()
        self.tpdos: list[Pdo] = []
        self.rpdos: list[Pdo] = []
        self._sync_count = 0

    def connect(self) -> None:
        """Create the network node; all objects are registered."""
        self.preset_pdos()
        self.node = SlaveNode(self.node_id, self.store)
        self.node.on_nmt = self.nmt_changed

    def preset(self, pdos: Sequence[Pdo], identifier: int, addresses: Sequence[Address], first: bool) -> None:
        """Set PDOs to their defaults: PDO 1 shows the first object, the others the first two; none but PDO 1 is valid.

        Parameters
        ----------
        pdos : all TPDOs or all RPDOs
        identifier : of PDO 1 without node id
        addresses : objects to map
        first : PDO 1 is valid
        """
        for n, pdo in enumerate(pdos):
            pdo.cob_id = identifier + 0x100 * n + self.node_id | (0 if first and n == 0 else DISABLED)
            pdo.preset(addresses[: n + 1], 255)
        self._sync_count = 0

    def preset_pdos(self) -> None:
        """Set the default PDOs."""
        raise NotImplementedError

    def nmt_changed(self, _old: int, new: int) -> None:
        """React to a new NMT state."""
        if new == OPERATIONAL:
            self._sync_count = 0

    @property
    def exchanges(self) -> bool:
        """Return whether PDOs are exchanged: the device has power and is OPERATIONAL."""
        return self.node.state == OPERATIONAL and not self.node.unpowered

    def sync(self) -> None:
        """Process a SYNC: take over or sample, then send the synchronous TPDOs."""
        if not self.exchanges:
            return
        self._sync_count += 1
        self.latch()
        for tpdo in self.tpdos:
            if self.exchanges and tpdo.due(self._sync_count):
                self.transmit(tpdo)

    def latch(self) -> None:
        """Take over setpoints, or sample, at a SYNC."""
        raise NotImplementedError

    def transmit(self, tpdo: Pdo) -> None:
        """Send one TPDO."""
        self.put(can.Message(arbitration_id=tpdo.frame_id, data=tpdo.pack(), is_extended_id=False))
