"""The same SYNC exchange through canopen's PdoMap objects, its network and python-can's notifier: the yardstick."""

from __future__ import annotations

import struct
import threading

import can
import canopen
from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable, datatypes

NODES = range(1, 7)
COMMANDS = ((0x6040, datatypes.UNSIGNED16), (0x607A, datatypes.INTEGER32))
ANSWERS = ((0x6041, datatypes.UNSIGNED16), (0x6064, datatypes.INTEGER32), (0x6077, datatypes.INTEGER16))


def dictionary() -> ObjectDictionary:
    """Object dictionary with the mapped objects and one PDO in each direction."""
    entries = ObjectDictionary()
    for index, kind in (*COMMANDS, *ANSWERS):
        variable = ODVariable(f"object {index:04X}", index, 0)
        variable.data_type = kind
        entries.add_object(variable)
    for index in (0x1400, 0x1600, 0x1800, 0x1A00):
        record = ODRecord(f"record {index:04X}", index)
        for sub in range(7):
            member = ODVariable(f"member {sub}", index, sub)
            member.data_type = datatypes.UNSIGNED32
            record.add_member(member)
        entries.add_object(record)
    return entries


class PdoMapExchange:
    """Six nodes whose PDOs are canopen's objects; values are written and read through `.raw`."""

    def __init__(self, network: canopen.Network) -> None:
        self.network = network
        self.missing = 0
        self._condition = threading.Condition()
        self._left = 0
        self.axes = []
        for node_id in NODES:
            node = network.add_node(node_id, dictionary())
            answer, command = node.tpdo[1], node.rpdo[1]
            answer.cob_id, command.cob_id = 0x180 + node_id, 0x200 + node_id
            for pdo, objects in ((answer, ANSWERS), (command, COMMANDS)):
                pdo.clear()
                pdo.enabled = True
                for index, _ in objects:
                    pdo.add_variable(index)
            network.subscribe(answer.cob_id, answer.on_message)
            answer.add_callback(self._arrived)
            self.axes.append((command, answer))

    def _arrived(self, pdo: object) -> None:
        with self._condition:
            self._left -= 1
            if self._left == 0:
                self._condition.notify()

    def cycle(self, position: int) -> list[tuple[int, int, int]]:
        """One SYNC: three values out and three values in per axis."""
        self._send(position)
        with self._condition:
            self._left = len(self.axes)
        self.network.sync.transmit()
        with self._condition:
            if not self._condition.wait_for(lambda: self._left <= 0, 1.0):
                self.missing += 1
        return self._read()

    def cycle_without_bus(self, position: int, frames: list[bytearray]) -> list[tuple[int, int, int]]:
        """The same with frames that are handed to the network: no adapter, no thread."""
        self._send(position)
        self._left = len(self.axes)
        self.network.sync.transmit()
        for node_id, data in zip(NODES, frames, strict=True):
            self.network.notify(0x180 + node_id, data, 0.0)
        return self._read()

    def _send(self, position: int) -> None:
        for command, _ in self.axes:
            command[0x6040].raw = 0x0F
            command[0x607A].raw = position
            command.transmit()

    def _read(self) -> list[tuple[int, int, int]]:
        return [(answer[0x6041].raw, answer[0x6064].raw, answer[0x6077].raw) for _, answer in self.axes]


class DroppingNetwork(canopen.Network):
    """A network that drops what it is asked to send."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Nothing is sent."""


def answers(count: int) -> list[bytearray]:
    """What six drives answer to SYNC number `count`."""
    return [bytearray(struct.pack("<Hih", 0x0227, 1000 * node, count % 1000)) for node in NODES]


def open_network(port: int, channel: str) -> canopen.Network:
    """canopen on udp_multicast with its notifier."""
    network = canopen.Network(can.Bus(interface="udp_multicast", channel=channel, port=port, fd=False, hop_limit=0))
    network.connect()
    return network
