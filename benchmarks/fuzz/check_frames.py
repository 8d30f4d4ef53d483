"""Promises of the decoders of frames: PDO, EMCY, heartbeat, SDO answers."""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import can
from hypothesis import strategies as st

from benchmarks.fuzz.guard import cpu_limit
from drives.bus import Bus, BusSpec
from drives.cia402 import describe
from drives.emcy import parse_emergency
from drives.epoch import EpochCollector
from drives.errors import DriveError
from drives.heartbeat import HeartbeatWatch
from drives.profile_file import load_profile
from drives.sdo import SdoClient

NODE = 5
INDEX, SUBINDEX = 0x6076, 0
REQUEST, ANSWER = 0x600 + NODE, 0x580 + NODE
PROFILE = load_profile("generic-cia402")


@dataclass(slots=True)
class Wire:
    """Adapter of a bus whose other end is a function: what is sent is answered at once."""

    arriving: deque[can.Message] = field(default_factory=deque)
    device: Any = None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.arriving.popleft() if self.arriving else None

    def send(self, frame: can.Message) -> None:
        if self.device is not None:
            for data in self.device(frame.arbitration_id, bytes(frame.data)):
                self.arriving.append(can.Message(arbitration_id=ANSWER, data=data, is_extended_id=False))

    def shutdown(self) -> None:
        """Nothing is open."""


def open_wire(device: Any = None) -> tuple[Wire, Bus]:
    """A bus and its other end."""
    wire = Wire(device=device)
    return wire, Bus(wire, BusSpec("virtual", "fuzz"))


# ---------------------------------------------------------------------------------------------------- EMCY, heartbeat


def emergencies() -> st.SearchStrategy[bytes]:
    return st.binary(max_size=8)


def check_emergency(data: bytes) -> None:
    """Code, register and vendor bytes as they are in the frame; what is not there is None or empty."""
    with cpu_limit():
        message = parse_emergency(NODE, data, 7, PROFILE)
    assert message.code == (struct.unpack("<H", data[:2])[0] if len(data) > 1 else None)
    assert message.register == (data[2] if len(data) > 2 else None)
    assert message.vendor == data[3:]
    assert message.text
    assert f"node {NODE}" in str(message)


def heartbeats() -> st.SearchStrategy[list[bytes]]:
    return st.lists(st.one_of(st.sampled_from([b"\x00", b"\x04", b"\x05", b"\x7f"]), st.binary(max_size=8)), max_size=5)


def check_heartbeat(frames: list[bytes]) -> None:
    """The state is that of the last one-byte frame, a boot-up is remembered, an unknown byte gives no state."""
    wire, bus = open_wire()
    watch = HeartbeatWatch(bus, [NODE], [0.1])
    for data in frames:
        wire.arriving.append(can.Message(arbitration_id=0x700 + NODE, data=data, is_extended_id=False))
    with cpu_limit():
        bus.drain()
    valid = [data[0] & 0x7F for data in frames if len(data) == 1]
    expected = valid[-1] if valid and valid[-1] in (0x00, 0x04, 0x05, 0x7F) else None
    state = watch.states[NODE]
    assert (None if state is None else int(state)) == expected
    assert (NODE in watch.booted) == (0 in valid)
    watch.close()


# ---------------------------------------------------------------------------------------------------------------- PDO

TPDOS = (0x181, 0x182, 0x281)
SIZES = {0x181: 8, 0x182: 8, 0x281: 6}


def answers() -> st.SearchStrategy[list[tuple[int, bytes]]]:
    """Answers to one SYNC: right ones, and frames of any length, twice, of others."""
    right = st.sampled_from(TPDOS).flatmap(lambda can_id: st.tuples(st.just(can_id), st.binary(min_size=8, max_size=8)))
    cut = right.map(lambda frame: (frame[0], frame[1][: SIZES[frame[0]]]))
    return st.lists(st.one_of(cut, cut, st.tuples(st.sampled_from((*TPDOS, 0x183)), st.binary(max_size=8))), max_size=8)


def check_answers(frames: list[tuple[int, bytes]]) -> None:
    """A slot holds the frame of its drive if exactly one content of the right length came, else nothing."""
    wire, bus = open_wire()
    collector = EpochCollector(bus, list(SIZES.items()), 1e-3)
    for can_id, data in frames:
        wire.arriving.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
    with cpu_limit():
        collected = collector.collect(0.0, 0.0)
        bus.drain()
    for slot, (can_id, size) in enumerate(SIZES.items()):
        contents = [data for sent, data in frames if sent == can_id and len(data) == size]
        got = collected[slot]
        assert got is None or bytes(got) in contents
        if got is not None:
            status, position, torque = struct.unpack("<Hih", bytes(got).ljust(8, b"\0"))
            word = describe(status)
            assert word
            assert -(2**31) <= position < 2**31
            assert -(2**15) <= torque < 2**15
        if not contents:
            assert got is None
    collector.close()


def odd_frames() -> st.SearchStrategy[list[tuple[int, bytes, bool, bool, bool]]]:
    """Frames of any id and kind."""
    flags = st.booleans()
    return st.lists(st.tuples(st.integers(0, 2**29 - 1), st.binary(max_size=8), flags, flags, flags), max_size=6)


def check_odd_frames(frames: list[tuple[int, bytes, bool, bool, bool]]) -> None:
    """Every frame is handed on or counted; nothing escapes."""
    wire, bus = open_wire()
    seen = 0
    for can_id, data, extended, remote, error in frames:
        extended = extended or can_id > 0x7FF
        wire.arriving.append(
            can.Message(
                arbitration_id=can_id,
                data=b"" if remote else data,
                is_extended_id=extended,
                is_remote_frame=remote,
                is_error_frame=error,
            )
        )
        seen += not (extended or remote or error)
    with cpu_limit():
        assert bus.drain() == seen
    assert sum(bus.counts[kind] for kind in ("error", "remote", "extended")) == len(frames) - seen


# ---------------------------------------------------------------------------------------------------------------- SDO

#: What happens to one answer of the device.
FATES = (
    "keep",
    "keep",
    "keep",
    "drop",
    "junk first",
    "junk after",
    "junk instead",
    "twice",
    "flip",
    "short",
    "delayed",
)


@dataclass(frozen=True, slots=True)
class Conversation:
    """A device that holds `value`, and what the wire does to its answers."""

    value: bytes
    fates: tuple[tuple[str, bytes], ...]


def sdo_answers() -> st.SearchStrategy[Conversation]:
    """Devices that answer by CiA 301, on a wire that drops, repeats, delays and invents."""
    head = st.sampled_from([b"\x43", b"\x4f", b"\x41", b"\x40", b"\x60", b"\x00", b"\x11", b"\x80", b"\x20", b"\x0f"])
    address = st.sampled_from([struct.pack("<HB", INDEX, SUBINDEX), struct.pack("<HB", 0x6077, 0), b"\0\0\0"])
    plausible = st.builds(lambda *parts: b"".join(parts), head, address, st.binary(min_size=4, max_size=4))
    junk = st.one_of(plausible, st.binary(max_size=8))
    fate = st.tuples(st.sampled_from(FATES), junk)
    return st.builds(Conversation, st.binary(max_size=24), st.lists(fate, max_size=5).map(tuple))


class Device:
    """SDO server of one object, from CiA 301 (7.2.4.3), behind a wire that does to each answer what fate says."""

    def __init__(self, conversation: Conversation) -> None:
        self.value = conversation.value
        self.written: bytes | None = None
        #: Whether a frame went out that no client can distinguish from a right answer.
        self.deceived = False
        self._fates = deque(conversation.fates)
        self._rest = b""
        self._kept: list[bytes] = []
        self._delayed: list[bytes] = []

    def __call__(self, can_id: int, data: bytes) -> list[bytes]:
        if can_id != REQUEST or data[0] & 0xE0 == 0x80:
            return []
        answer = self._answer(data)
        fate, junk = self._fates.popleft() if self._fates else ("keep", b"")
        delayed, self._delayed = self._delayed, []
        if fate in ("junk first", "junk after", "junk instead"):
            self.deceived |= self._like_an_answer(junk)
        out = {
            "drop": [],
            "junk first": [junk, answer],
            "junk after": [answer, junk],
            "junk instead": [junk],
            "twice": [answer, answer],
            "short": [answer[:5]],
            "delayed": [],
        }.get(fate, [answer])
        if fate == "flip" and junk:
            position = junk[0] % 64
            flipped = bytearray(answer)
            flipped[position // 8] ^= 1 << position % 8
            out, self.deceived = [bytes(flipped)], True
        if fate == "delayed":
            self._delayed.append(answer)
        return delayed + out

    @staticmethod
    def _like_an_answer(junk: bytes) -> bool:
        if len(junk) != 8:
            return False
        kind = junk[0] & 0xE0
        mine = struct.unpack_from("<HB", junk, 1) == (INDEX, SUBINDEX)
        return kind in (0x00, 0x20) or mine and kind in (0x40, 0x60, 0x80)

    def _answer(self, data: bytes) -> bytes:
        kind = data[0] & 0xE0
        if kind in (0x40, 0x20) and struct.unpack_from("<HB", data, 1) != (INDEX, SUBINDEX):
            return bytes([0x80]) + data[1:4] + struct.pack("<I", 0x06020000)
        if kind == 0x40:
            if 0 < len(self.value) <= 4:
                head = 0x43 | (4 - len(self.value)) << 2
                return bytes([head]) + data[1:4] + self.value.ljust(4, b"\0")
            self._rest = self.value
            return b"\x41" + data[1:4] + struct.pack("<I", len(self.value))
        if kind == 0x60:
            part, self._rest = self._rest[:7], self._rest[7:]
            head = data[0] & 0x10 | (7 - len(part)) << 1 | (not self._rest)
            return bytes([head]) + part.ljust(7, b"\0")
        if kind == 0x20:
            if data[0] & 0x02:
                self.written = data[4 : 8 - (data[0] >> 2 & 3)]
            self._kept = []
            return b"\x60" + data[1:4] + bytes(4)
        self._kept.append(data[1 : 8 - (data[0] >> 1 & 7)])
        if data[0] & 0x01:
            self.written = b"".join(self._kept)
        return bytes([0x20 | data[0] & 0x10]) + bytes(7)


def check_upload(conversation: Conversation) -> None:
    """The value of the device or a typed error: never a value of another object, of an older answer, or a part."""
    device = Device(conversation)
    _, bus = open_wire(device)
    client = SdoClient(bus, NODE, timeout_s=1e-4, slow_timeout_s=1e-4)
    with cpu_limit():
        for _ in range(2):
            try:
                value = client.upload(INDEX, SUBINDEX)
            except DriveError:
                continue
            assert device.deceived or value == conversation.value
    client.close()


def check_download(conversation: Conversation) -> None:
    """What is reported as written is what the device holds."""
    device = Device(conversation)
    _, bus = open_wire(device)
    client = SdoClient(bus, NODE, timeout_s=1e-4, slow_timeout_s=1e-4)
    with cpu_limit():
        try:
            client.download(INDEX, SUBINDEX, conversation.value)
        except DriveError:
            pass
        else:
            assert device.deceived or device.written == conversation.value
    client.close()
