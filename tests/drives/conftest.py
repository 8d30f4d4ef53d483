"""A wire and a slave for tests of the master: deterministic, without threads, with a clock of their own.

The slave is written from CiA 301 and CiA 402-2 and shares nothing with the master but object numbers.
"""

from __future__ import annotations

import heapq
import itertools
import math
import struct
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import can
import pytest

from drives.bus import Bus, BusSpec
from drives.group import DriveGroup
from drives.profile import DriveProfile
from drives.profile_file import load_profile
from drives.proof import BrakeTest, StopTrace
from drives.values import AxisSetup, DriveCommand

CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}


class Wire:
    """An adapter as python-can's, with slaves behind it; time passes only while a caller waits."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.echo = False
        self.sent: list[tuple[int, bytes]] = []
        self.sent_at_s: list[float] = []
        self.slaves: list[Slave] = []
        self.send_errors = 0
        #: By how much the wall clock, which also stamps frames, is ahead of the monotonic one.
        self.wall_ahead_s = 7.0e8
        #: The process is stalled for so long in its next wait for a frame.
        self.held_up_s = 0.0
        self._queue: list[tuple[float, int, can.Message]] = []
        self._number = itertools.count()

    def monotonic(self) -> float:
        self.now_s += 1e-7
        return self.now_s

    def wall(self) -> float:
        return self.monotonic() + self.wall_ahead_s

    def sleep(self, seconds: float) -> None:
        self.now_s += max(0.0, seconds)

    def emit(self, can_id: int, data: bytes, delay_s: float = 0.0, **flags: bool) -> None:
        """Put a frame on the wire; frames due at the same time keep their order."""
        message = can.Message(
            arbitration_id=can_id,
            data=data,
            is_extended_id=False,
            timestamp=self.now_s + self.wall_ahead_s + delay_s,
            **flags,
        )
        heapq.heappush(self._queue, (self.now_s + delay_s, next(self._number), message))

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if self.send_errors:
            self.send_errors -= 1
            raise can.CanOperationError("Transmit buffer full")
        can_id, data = message.arbitration_id, bytes(message.data)
        self.sent.append((can_id, data))
        self.sent_at_s.append(self.now_s)
        if self.echo:
            self.emit(can_id, data)
        for slave in self.slaves:
            slave.on_frame(can_id, data)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if timeout and self.held_up_s:
            self.now_s, self.held_up_s = self.now_s + self.held_up_s, 0.0
            return None
        until = self.now_s + (timeout or 0.0)
        for slave in self.slaves:
            slave.pass_time(min(until, self._queue[0][0]) if self._queue else until)
        if not self._queue or self._queue[0][0] > until:
            self.now_s = until + 1e-6
            return None
        due, _, message = heapq.heappop(self._queue)
        self.now_s = max(self.now_s, due) + 1e-6
        return message

    def shutdown(self) -> None:
        self._queue.clear()


class Beside(Wire):
    """A second wire under the clock of the first one."""

    def __init__(self, first: Wire) -> None:
        self._first = first
        super().__init__()

    @property
    def now_s(self) -> float:
        return self._first.now_s

    @now_s.setter
    def now_s(self, now_s: float) -> None:
        self._first.now_s = max(now_s, self._first.now_s)


def after_command(state: str, word: int) -> str:
    """State after a controlword (CiA 402-2, commands by their bits and the transitions they cause)."""
    if state == "fault":
        return "switch on disabled" if word & 0x80 else state
    if state in ("not ready", "fault reaction"):
        return state
    if word & 0x02 == 0:  # disable voltage
        return "switch on disabled"
    if word & 0x04 == 0:  # quick stop
        moves = {"operation enabled": "quick stop", "quick stop": "quick stop"}
        return moves.get(state, "switch on disabled")
    if word & 0x01 == 0:  # shutdown
        return state if state == "quick stop" else "ready"
    if word & 0x08 == 0:  # switch on, disable operation
        return {"ready": "switched on", "operation enabled": "switched on"}.get(state, state)
    enable = {"ready": "switched on", "switched on": "operation enabled", "quick stop": "operation enabled"}
    return enable.get(state, state)


Reply = Callable[[bytes, bytes], list[tuple[float, bytes]]]


class Slave:
    """A CiA 402 drive in CSP behind a `Wire`."""

    def __init__(self, wire: Wire, node_id: int, serial: int | None = None) -> None:
        self.wire = wire
        self.node_id = node_id
        self.alive = True
        self.nmt = 127
        self.state = "switch on disabled"
        self.stuck_in: str | None = None
        self.sync_seen = 0
        self.position = 1000 * node_id
        self.torque = 10 * node_id
        #: By state: counts that the axis goes at each SYNC while it is in that state, until the list is empty.
        self.moves_in: dict[str, list[int]] = {}
        self.position_at_sync: list[int] = []
        self.controlwords: list[int] = []
        #: Called after every SYNC.
        self.at_sync: Callable[[], object] = lambda: None
        self.written: list[tuple[int, int, int]] = []
        #: Delay of TPDOs by SYNC number; None = lost.
        self.tpdo_delay_s: dict[int, float | None] = {}
        self.tpdo_cut = 8
        self.refused: dict[tuple[int, int], int] = {}
        #: Step to which a written value is rounded, down or, below zero, up.
        self.rounded: dict[tuple[int, int], int] = {}
        #: What becomes of an SDO answer: (request, answer) -> [(delay, answer), ..].
        self.reply: Reply = lambda request, answer: [(0.001, answer)]
        #: Sends its heartbeat (0x1017).
        self.beats = True
        self._beat_s = wire.now_s
        #: Time at which an event-driven TPDO3 is due, which it sends at 5 kHz.
        self._event_s = wire.now_s
        #: A communication error persists until this time: START is refused (CiA 301, 0x1029).
        self.communication_error_until_s = 0.0
        #: Supervises SYNC (0x1006): the time of the last one.
        self._sync_s: float | None = None
        self.communication_errors = 0
        #: Aborts a write of an inhibit time while the PDO exists.
        self.strict_inhibit = False
        self.takes_nmt = True
        #: Heeds its consumer heartbeat time (0x1016) in real time, and leaves operation as 0x6007 says.
        self.supervises = False
        self._master_s: float | None = None
        self._latched: bytes | None = None
        self._upload = b""
        self._toggle = 0
        self.downloaded = bytearray()
        self._target = (0, 0)
        self.texts = {(0x1008, 0): b"Test drive with a long name", (0x100A, 0): b"v1", (0x5FFE, 0): b"servo-sim"}
        self.types: dict[tuple[int, int], str] = {}
        self.values: dict[tuple[int, int], int] = {}
        self._fill(node_id if serial is None else serial)

    def obey_after(self, syncs: int) -> None:
        """Leave OPERATION ENABLED so many SYNCs after it was commanded."""
        commanded = [0]

        def obeys(word: int) -> bool:
            commanded[0] += word != 0x0F
            return commanded[0] > syncs or word == 0x0F

        self.obeys = obeys

    def _fill(self, serial: int) -> None:
        node = self.node_id
        for index, sub, kind, value in (
            (0x1000, 0, "u32", 0x00020192),
            (0x1005, 0, "u32", 0x80),
            (0x1016, 1, "u32", 0),
            (0x1017, 0, "u16", 0),
            (0x1018, 1, "u32", 0x1234),
            (0x1018, 2, "u32", 0x5678),
            (0x1018, 3, "u32", 0x00010002),
            (0x1018, 4, "u32", serial),
            (0x6007, 0, "i16", 1),
            (0x603F, 0, "u16", 0),
            (0x6040, 0, "u16", 0),
            (0x6041, 0, "u16", 0),
            (0x6060, 0, "i8", 0),
            (0x6061, 0, "i8", 0),
            (0x6064, 0, "i32", 0),
            (0x606C, 0, "i32", 0),
            (0x6075, 0, "u32", 5000),
            (0x6076, 0, "u32", 2000),
            (0x6077, 0, "i16", 0),
            (0x6078, 0, "i16", 0),
            (0x607A, 0, "i32", 0),
            (0x608F, 1, "u32", 65536),
            (0x608F, 2, "u32", 1),
            (0x60B2, 0, "i16", 0),
            (0x60C2, 1, "u8", 1),
            (0x60C2, 2, "i8", -3),
        ):
            self.types[index, sub], self.values[index, sub] = kind, value
        for number, base in ((0, 0x180), (1, 0x280)):
            self.add_pdo(0x1800 + number, 0x1A00 + number, 0x40000000 | base + node, [0x60410010])
            self.types[0x1800 + number, 3] = "u16"
            self.values[0x1800 + number, 3] = 300
        self.add_pdo(0x1400, 0x1600, 0x200 + node, [0x60400010])

    def add_pdo(self, communication: int, mapping: int, cob_id: int, entries: list[int]) -> None:
        """Give it the parameter and mapping records of a PDO."""
        for sub, kind, value in ((1, "u32", cob_id), (2, "u8", 255)):
            self.types[communication, sub], self.values[communication, sub] = kind, value
        self.types[mapping, 0], self.values[mapping, 0] = "u8", len(entries)
        for sub in range(1, 9):
            self.types[mapping, sub] = "u32"
            self.values[mapping, sub] = entries[sub - 1] if sub <= len(entries) else 0

    # -- values ------------------------------------------------------------------------------------------------------

    @property
    def statusword(self) -> int:
        word = {
            "not ready": 0x00,
            "switch on disabled": 0x40,
            "ready": 0x21,
            "switched on": 0x23,
            "operation enabled": 0x27,
            "quick stop": 0x07,
            "fault reaction": 0x0F,
            "fault": 0x08,
        }[self.state]
        return word | 0x0200 | 0x10

    def get(self, address: tuple[int, int]) -> int:
        live = {
            (0x6041, 0): self.statusword,
            (0x6064, 0): self.position,
            (0x6077, 0): self.torque,
            (0x6078, 0): 2 * self.torque,
            (0x6061, 0): self.values[0x6060, 0],
        }
        return live.get(address, self.values[address])

    def bytes_of(self, address: tuple[int, int]) -> bytes:
        kind = self.types[address]
        return struct.pack("<" + CODES[kind], self.get(address))

    # -- frames ------------------------------------------------------------------------------------------------------

    def on_frame(self, can_id: int, data: bytes) -> None:
        if not self.alive:
            return
        if can_id == 0x000 and data[1] in (0, self.node_id):
            self._command(data[0])
        elif can_id == 0x600 + self.node_id and self.nmt != 4:
            self._sdo(data)
        elif can_id == self.values[0x1400, 1] and self.nmt == 5:
            self._latched = data
        elif can_id == 0x080 and self.nmt == 5:
            self._sync()
            self.at_sync()
        elif can_id == 0x700 | self.values[0x1016, 1] >> 16:
            self._master_s = self.wire.now_s

    def _command(self, command: int) -> None:
        refused = command == 1 and self.wire.now_s < self.communication_error_until_s
        if self.takes_nmt and not refused:
            self.nmt = {1: 5, 2: 4, 128: 127}.get(command, self.nmt)
            self._sync_s = None

    def pass_time(self, until_s: float) -> None:
        """What the slave sends by itself before a time: its heartbeat, and an event-driven TPDO3."""
        if not self.alive:
            return
        period_s = self.values[0x1017, 0] / 1000.0
        if period_s and self.beats and self._beat_s + period_s <= until_s:
            self._beat_s = max(self._beat_s + period_s, self.wire.now_s)
            self.wire.emit(0x700 + self.node_id, bytes([self.nmt]), self._beat_s - self.wire.now_s)
        cob_id, transmission = self.values.get((0x1802, 1), 1 << 31), self.values.get((0x1802, 2))
        by_event = self.nmt == 5 and transmission == 255 and not cob_id & 1 << 31
        if by_event and self._event_s + 0.0002 <= until_s:
            self._event_s = max(self._event_s + 0.0002, self.wire.now_s)
            self.wire.emit(cob_id & 0x7FF, bytes(2), self._event_s - self.wire.now_s)

    def _supervise_sync(self) -> None:
        """Communication cycle period (CiA 301, 0x1006): a SYNC that is delayed is a communication error."""
        now_s, before_s, period_s = self.wire.now_s, self._sync_s, self.values.get((0x1006, 0), 0) * 1e-6
        self._sync_s = now_s
        if period_s and before_s is not None and now_s - before_s > 1.5 * period_s:
            self.communication_errors += 1
            self.nmt = 127

    def _supervise_master(self) -> None:
        """Consumer heartbeat time (CiA 301, 0x1016) and abort connection option (CiA 402-2, 0x6007)."""
        limit_s = (self.values[0x1016, 1] & 0xFFFF) / 1000.0
        armed = self.supervises and limit_s and self._master_s is not None and self.state == "operation enabled"
        if armed and self.wire.now_s - self._master_s > limit_s:
            self.state = {1: "fault", 2: "switch on disabled", 3: "quick stop"}[self.values[0x6007, 0]]

    def _sync(self) -> None:
        self._supervise_sync()
        self._supervise_master()
        if self.nmt != 5:
            return
        self.sync_seen += 1
        for number in (0, 1, 2):
            if (0x1800 + number, 1) in self.values:
                self._send_tpdo(number)
        if self._latched is not None:
            offset = 0
            for address, size in self._mapped(0x1600):
                value = int.from_bytes(self._latched[offset : offset + size], "little", signed=address[0] != 0x6040)
                offset += size
                self.values[address] = value
            self._latched = None
            self.controlwords.append(self.values[0x6040, 0])
            self._control(self.values[0x6040, 0])
            if self.state == "operation enabled":
                self.position = self.values[0x607A, 0]
        positions = self.moves_in.get(self.state)
        if positions:
            self.position += positions.pop(0)
        self.position_at_sync.append(self.position)

    def _mapped(self, mapping: int) -> list[tuple[tuple[int, int], int]]:
        entries = [self.values[mapping, sub] for sub in range(1, self.values[mapping, 0] + 1)]
        return [((entry >> 16, entry >> 8 & 0xFF), (entry & 0xFF) // 8) for entry in entries]

    def _send_tpdo(self, number: int) -> None:
        cob_id = self.values[0x1800 + number, 1]
        if cob_id & 1 << 31 or self.values[0x1800 + number, 2] > 240:
            return
        delay = self.tpdo_delay_s.get(self.sync_seen, 0.0002)
        if delay is not None:
            data = b"".join(self.bytes_of(address) for address, _ in self._mapped(0x1A00 + number))
            self.wire.emit(cob_id & 0x7FF, data[: self.tpdo_cut], delay)

    def emergency(self, data: bytes) -> None:
        self.wire.emit(self.values.get((0x1014, 0), 0x80 + self.node_id) & 0x7FF, data)

    def heartbeat(self, state: int | None = None) -> None:
        self.wire.emit(0x700 + self.node_id, bytes([self.nmt if state is None else state]))

    # -- CiA 402-2, finite state automaton ----------------------------------------------------------------------------

    def obeys(self, word: int) -> bool:
        """Return whether it obeys a controlword that it received; a test may replace it."""
        return True

    def _control(self, word: int) -> None:
        if self.obeys(word) and self.stuck_in != self.state:
            self.state = after_command(self.state, word)
            self._supervise_master()

    # -- SDO server (CiA 301, 7.2.4.3) ---------------------------------------------------------------------------------

    def _answer(self, request: bytes, answer: bytes) -> None:
        for delay, frame in self.reply(request, answer):
            self.wire.emit(0x580 + self.node_id, frame, delay)

    def _abort(self, request: bytes, code: int) -> None:
        self._answer(request, b"\x80" + request[1:4] + struct.pack("<I", code))

    def refuses_write(self, address: tuple[int, int], data: bytes) -> int:
        """Return the abort code of a write, 0 = it is taken; a test may replace it."""
        return 0

    def _sdo(self, request: bytes) -> None:
        command, address = request[0], (request[1] | request[2] << 8, request[3])
        kind = command & 0xE0
        if kind in (0x20, 0x40) and address in self.refused:
            self._abort(request, self.refused[address])
        elif kind == 0x40:
            self._sdo_upload(request, address)
        elif kind == 0x60:
            toggle = command & 0x10
            part, self._upload = self._upload[:7], self._upload[7:]
            last = 0 if self._upload else 1
            self._answer(request, bytes([toggle | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0"))
        elif kind == 0x20 and (code := self.refuses_write(address, request[4:])):
            self._abort(request, code)
        elif kind == 0x20:
            self._sdo_download(request, address)
        elif kind == 0x00:
            self.downloaded += request[1 : 8 - (command >> 1 & 7)]
            self._answer(request, bytes([0x20 | command & 0x10]) + bytes(7))

    def _sdo_upload(self, request: bytes, address: tuple[int, int]) -> None:
        if address in self.texts:
            self._upload = self.texts[address]
            self._answer(request, b"\x41" + request[1:4] + struct.pack("<I", len(self._upload)))
        elif address in self.values:
            data = self.bytes_of(address)
            self._answer(request, bytes([0x43 | (4 - len(data)) << 2]) + request[1:4] + data.ljust(4, b"\0"))
        else:
            known = any(index == address[0] for index, _ in self.values)
            self._abort(request, 0x06090011 if known else 0x06020000)

    def _sdo_download(self, request: bytes, address: tuple[int, int]) -> None:
        if not request[0] & 0x02:
            self.downloaded = bytearray()
            self._answer(request, b"\x60" + request[1:4] + bytes(4))
            return
        if address not in self.values:
            self._abort(request, 0x06020000)
            return
        kind = self.types[address]
        size = struct.calcsize(CODES[kind])
        if 4 - (request[0] >> 2 & 3) != size:
            self._abort(request, 0x06070010)
            return
        exists = not self.values.get((address[0], 1), 0) & 1 << 31
        if self.strict_inhibit and exists and 0x1800 <= address[0] < 0x1A00 and address[1] == 3:
            self._abort(request, 0x06090030)
            return
        mapping = 0x1600 <= address[0] < 0x1C00 and not 0x1800 <= address[0] < 0x1A00
        cob_id = self.values.get((address[0] & ~0x200, 1), 0)
        if mapping and (not cob_id & 1 << 31 or (address[1] and self.values[address[0], 0])):
            self._abort(request, 0x08000022)
            return
        (value,) = struct.unpack("<" + CODES[kind], request[4 : 4 + size])
        self.written.append((*address, value))
        self.values[address] = value - value % self.rounded.get(address, 1)
        if address == (0x6040, 0):
            self.controlwords.append(value)
            self._control(value)
        self._answer(request, b"\x60" + request[1:4] + bytes(4))


def on_its_clock(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the clock of a wire be the clock of the test."""
    monkeypatch.setattr(time, "monotonic", wire.monotonic)
    monkeypatch.setattr(time, "time", wire.wall)
    monkeypatch.setattr(time, "sleep", wire.sleep)


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    """A wire whose clock is the clock of the test."""
    wire = Wire()
    on_its_clock(wire, monkeypatch)
    return wire


@pytest.fixture
def bus(wire: Wire) -> Iterator[Bus]:
    """The master's bus on that wire."""
    with Bus(wire, BusSpec("test", "wire")) as bus:
        yield bus


@pytest.fixture
def generic() -> DriveProfile:
    return load_profile("generic-cia402")


@pytest.fixture
def add_slaves(wire: Wire) -> Callable[[int], list[Slave]]:
    """Put slaves 1 .. n on the wire."""

    def add(number: int) -> list[Slave]:
        wire.slaves += [Slave(wire, node_id) for node_id in range(1, number + 1)]
        return wire.slaves

    return add


@pytest.fixture
def setups(generic: DriveProfile) -> Callable[[int], list[AxisSetup]]:
    """Setups of axes 1 .. n."""

    def make(number: int) -> list[AxisSetup]:
        return [AxisSetup(node_id, generic, 0.5, 300.0) for node_id in range(1, number + 1)]

    return make


@contextmanager
def configured(*arguments: Any, **options: Any) -> Generator[DriveGroup]:
    """Drives that are connected and configured; arguments as `DriveGroup`."""
    with DriveGroup(*arguments, **options) as group:
        group.connect()
        group.configure()
        yield group


@pytest.fixture
def make_slave(wire: Wire) -> Callable[..., Slave]:
    """Put one more slave on the wire."""

    def make(node_id: int, serial: int | None = None) -> Slave:
        slave = Slave(wire, node_id, serial)
        wire.slaves.append(slave)
        return slave

    return make


# -- tests of a stop, without the loop of an arm -----------------------------------------------------------------------


def stop_responding(group: DriveGroup, rows: Iterable[Sequence[DriveCommand]]) -> tuple[StopTrace, ...]:
    """Setpoints go on without a heartbeat; after the last one the axes are held until all have stopped."""
    test, remaining = group.withhold_heartbeat(), iter(rows)
    while not test.done:
        row = next(remaining, None)
        group.hold() if row is None else group.exchange(row)
    if len(test.left) < len(group.drives):
        group.quick_stop()
    group.disable()
    return test.traces()


def prove_quick_stop(group: DriveGroup, rows: Iterable[Sequence[DriveCommand]]) -> tuple[StopTrace, ...]:
    """Setpoints, then the quick stop until all axes are at rest."""
    for row in rows:
        group.exchange(row)
    test = group.try_quick_stop()
    while not test.done:
        group.hold()
    group.disable()
    return test.traces()


def release(
    group: DriveGroup, axis: int, seconds: float, limit_rad: float = math.inf, disables_voltage: bool = True
) -> BrakeTest:
    """One axis is held by its brake for a time, or until it has moved too far; then all are disabled."""
    for _ in range(math.ceil(1.0 / group.timing.period_s)):
        if group.is_at_rest:
            break
        group.hold()
    test = group.release(axis, limit_rad, disables_voltage)
    try:
        while not test.beyond_limit and (test.released_syncs * group.timing.period_s < seconds or not test.is_watched):
            group.hold()
        while test.beyond_limit and not test.held:
            group.hold()
    finally:
        group.disable()
    return test
