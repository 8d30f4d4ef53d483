"""Six light drives in a process of their own: just enough CANopen to be enabled, then one TPDO each per SYNC.

python -m benchmarks.bench.wire_responder PORT
"""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import can

CHANNEL = "239.74.163.2"
NODES = range(1, 7)
QUIT_ID = 0x7F0
#: Where a simulated drive says what it is, and what it says: lockstep goes to no other.
SIMULATOR_OBJECT, SIMULATOR_NAME = (0x5FFE, 0), b"servo-sim"
TPDO, RPDO = struct.Struct("<Hih"), struct.Struct("<Hi")
_AFTER = {0x06: 0x21, 0x07: 0x23, 0x0F: 0x27, 0x00: 0x40, 0x02: 0x40}


class Responder:
    """Answers SDO from a table, follows the controlword, and sends prepared TPDOs at SYNC."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.values = {node: {} for node in NODES}
        for node in NODES:
            self.values[node] |= {
                (0x1000, 0): 0x00020192,
                (0x1005, 0): 0x80,
                (0x1014, 0): 0x80 + node,
                (0x1018, 1): 0xFB,
                (0x1018, 3): 0x01700000,
                (0x1018, 4): node,
                (0x3000, 5): 65536,
                (0x6076, 0): 2000,
                (0x6064, 0): 1000 * node,
            }
        self.unused: dict[tuple[int, int, int], int] = {}
        self.text_left = dict.fromkeys(NODES, b"")
        self.state = dict.fromkeys(NODES, 0x40)
        self.tpdos = [
            can.Message(arbitration_id=0x180 + node, data=bytearray(8), is_extended_id=False) for node in NODES
        ]
        self.positions = {node: 1000 * node for node in NODES}
        self.syncs = 0
        self._refresh()

    def _refresh(self) -> None:
        self.syncs += 1
        for node, message in zip(NODES, self.tpdos, strict=True):
            TPDO.pack_into(message.data, 0, self.state[node] | 0x0200, self.positions[node], self.syncs % 1000)

    def run(self) -> None:
        """Serve until the master ends it, or no frame has come for a minute."""
        send, tpdos = self.bus.send, self.tpdos
        while (frame := self.bus.recv(60.0)) is not None:
            can_id = frame.arbitration_id
            if can_id == 0x080:
                for message in tpdos:
                    send(message)
                self._refresh()
            elif 0x200 < can_id <= 0x206:
                word, position = RPDO.unpack(frame.data)
                node = can_id - 0x200
                self.state[node], self.positions[node] = _AFTER.get(word, self.state[node]), position
            elif 0x600 < can_id <= 0x606:
                self._sdo(can_id - 0x600, bytes(frame.data))
            elif can_id == QUIT_ID:
                return

    def _sdo(self, node: int, request: bytes) -> None:
        address = (request[1] | request[2] << 8, request[3])
        values = self.values[node]
        if request[0] & 0xE0 == 0x20:
            values[address] = int.from_bytes(request[4:8], "little")
            self.unused[node, *address] = request[0] & 0x0C
            answer = b"\x60" + request[1:4] + bytes(4)
        elif request[0] & 0xE0 == 0x40 and address == SIMULATOR_OBJECT:
            self.text_left[node] = SIMULATOR_NAME
            answer = b"\x41" + request[1:4] + struct.pack("<I", len(SIMULATOR_NAME))
        elif request[0] & 0xE0 == 0x60:
            part, self.text_left[node] = self.text_left[node][:7], self.text_left[node][7:]
            last = 0 if self.text_left[node] else 1
            answer = bytes([request[0] & 0x10 | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0")
        elif request[0] & 0xE0 == 0x40:
            live = {(0x6041, 0): self.state[node], (0x6064, 0): self.positions[node], (0x6061, 0): 8}
            unset = (address[1] == 1 and 0x1400 <= address[0] < 0x1A00) << 31  # a PDO that does not exist
            value = live.get(address, values.get(address, unset))
            answer = (
                bytes([0x43 | self.unused.get((node, *address), 0)])
                + request[1:4]
                + struct.pack("<I", value & 0xFFFFFFFF)
            )
        else:
            return
        self.bus.send(can.Message(arbitration_id=0x580 + node, data=answer, is_extended_id=False))


def free_port() -> int:
    """Return a free UDP port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


@contextmanager
def responder() -> Iterator[int]:
    """Start the process; gives its port."""
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.bench.wire_responder", str(port)], stdout=subprocess.PIPE, text=True
    )
    if process.stdout is None or process.stdout.readline() != "ready\n":
        raise RuntimeError("the responder did not start")
    try:
        yield port
    finally:
        with can.Bus(interface="udp_multicast", channel=CHANNEL, port=port, fd=False, hop_limit=0) as bus:
            bus.send(can.Message(arbitration_id=QUIT_ID, is_extended_id=False))
        process.stdout.close()
        process.wait(10)


def main() -> None:
    """Serve on one port."""
    with can.Bus(interface="udp_multicast", channel=CHANNEL, port=int(sys.argv[1]), fd=False, hop_limit=0) as bus:
        print("ready", flush=True)
        Responder(bus).run()


if __name__ == "__main__":
    main()
