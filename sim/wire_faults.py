"""Faults on the wire: a CAN adapter that loses, delays, changes and generates frames between the drives and their bus.

`FaultyWire` replaces the drives' python-can bus: their frames pass `send` and `recv`, and there the hooks of the faults
that are active. Time is counted in SYNC frames; only delayed answers are delayed in seconds. The functions below it are
the hooks of the kinds in `sim.faults.KINDS`.
"""

from __future__ import annotations

import errno
import random
import struct
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import can

from sim.fault import Fault, Kind

SYNC, NMT, BUS_OFF, CONTROLLER_STATE = 0x080, 0x000, 0x040, 0x004
TPDO1, TPDO2, RPDO1, SDO_ANSWER, SDO_REQUEST, HEARTBEAT, EMCY = 0x180, 0x280, 0x200, 0x580, 0x600, 0x700, 0x080
#: What a hook can pass beside frames of a group: each SYNC towards the drives, and the start of the fault.
AT_SYNC, AT_START = -1, -2
ANSWERS: Final = (TPDO1, TPDO2)
#: A queue that is full is waited for, as a drive waits for a free mailbox [s].
QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)
QUEUE_PATIENCE_S = 5.0
#: Rounding of times that are sums of many periods [s].
HAIR_S = 1e-6
#: An answer that follows all others: its delay as a share of the SYNC period.
DELAYED_SHARE = 0.4
#: Another master with a slow SYNC: its period, and for how long it sends [s].
SLOW_SYNC_S, SLOW_SYNC_LASTS_S = 0.1, 60.0


@dataclass(slots=True)
class Armed:
    """A pending or active fault with its state."""

    fault: Fault
    kind: Kind
    left: int
    rng: random.Random
    started: bool = False
    memory: dict[int, bytes] = field(default_factory=dict)
    held: list[can.Message] = field(default_factory=list)
    due_s: float = 0.0

    def take(self) -> bool:
        """Whether one more frame may be touched."""
        if self.fault.count and self.left <= 0:
            return False
        self.left -= 1
        return True


class FaultyWire:
    """A python-can bus with faults.

    Parameters
    ----------
    bus : can.BusABC
        The real adapter.
    kinds : mapping
        The table of faults.

    Attributes
    ----------
    sync : SYNCs that this adapter has received
    period_s, real : SYNC period [s], and whether time is real or counted by SYNCs
    touched : frames by what was done to them
    act : carries out a fault inside the drives
    on_sync : called with the number of each SYNC, before the drives receive it
    on_frame : called with the number of the SYNC and each frame of a drive, before anything is done to it
    """

    def __init__(self, bus: Any, kinds: Mapping[str, Kind]) -> None:
        self.sync = 0
        self.period_s, self.real = 0.01, False
        self.touched: dict[str, int] = {}
        self.act: Callable[[Fault], None] = lambda _fault: None
        self.on_sync: Callable[[int], None] = lambda _sync: None
        self.on_frame: Callable[[int, can.Message], None] = lambda _sync, _frame: None
        self._bus, self._kinds = bus, kinds
        self._armed: list[Armed] = []
        self._due: list[tuple[float, can.Message]] = []
        self._held: list[tuple[float, can.Message]] = []
        self._answers = [0, 0]
        self._lock = threading.RLock()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    # -- scenario ----------------------------------------------------------------------------------------------------

    def arm(self, fault: Fault) -> None:
        """Schedule a fault; if its SYNC has passed, it starts now."""
        with self._lock:
            fault = replace(fault, at_sync=max(fault.at_sync, self.sync))
            armed = Armed(fault, self._kinds[fault.kind], fault.count, random.Random(fault.seed))
            self._armed.append(armed)
            if fault.at_sync <= self.sync:
                self._start(armed)

    def arm_in(self, fault: Fault, syncs: int) -> None:
        """Schedule a fault a number of SYNCs from now."""
        with self._lock:
            self.arm(replace(fault, at_sync=self.sync + max(syncs, 1)))

    def clear(self) -> None:
        """End every fault on the wire; a drive stays as the fault left it."""
        with self._lock:
            self._armed.clear()
            self._due.clear()
            self._held.clear()

    def _start(self, armed: Armed) -> None:
        if armed.started:
            return
        armed.started = True
        if armed.kind.where != "wire":
            self.count(armed)
            self.act(armed.fault)
        elif AT_START in armed.kind.touches and armed.kind.hook is not None:
            armed.kind.hook(self, armed, _frame(SYNC, b""))

    def count(self, armed: Armed) -> None:
        """Note that a fault has touched one more frame."""
        self.touched[armed.fault.kind] = self.touched.get(armed.fault.kind, 0) + 1

    # -- python-can --------------------------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, subject to the faults."""
        with self._lock:
            self.on_frame(self.sync, msg)
            group = msg.arbitration_id & 0x780
            self._answers[0] += group in ANSWERS
            for frame in self._through(msg, group):
                self.put(frame)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame for the drives; delayed frames are sent when they are due."""
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            with self._lock:
                while self._due and self._due[0][0] <= time.monotonic():
                    self.put(self._due.pop(0)[1])
            wait = None if end is None else max(end - time.monotonic(), 0.0)
            first = next(iter(self._due), None)
            if first is not None:
                wait = min(first[0] - time.monotonic(), 0.05 if wait is None else wait)
            frame = self._bus.recv(None if wait is None else max(wait, 0.0))
            if frame is not None and self._reaches_drives(frame):
                return frame
            if frame is None and end is not None and time.monotonic() >= end:
                return None

    def shutdown(self) -> None:
        """Close the adapter."""
        self.clear()
        self._bus.shutdown()

    def __enter__(self) -> FaultyWire:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()

    def _reaches_drives(self, frame: can.Message) -> bool:
        if frame.is_error_frame or frame.is_extended_id:
            return True
        with self._lock:
            if frame.arbitration_id != SYNC:
                return bool(self._through(frame, frame.arbitration_id & 0x780))
            self.sync += 1
            self.on_sync(self.sync)
            self._answers = [0, self._answers[0]]
            late = [held for due_s, held in self._held if due_s <= self.now_s + HAIR_S]
            self._held = [(due_s, held) for due_s, held in self._held if due_s > self.now_s + HAIR_S]
            for held in late:
                self.put(held)
            for armed in [each for each in self._armed if each.fault.active(self.sync)]:
                self._start(armed)
            return bool(self._through(frame, AT_SYNC))

    def _through(self, msg: can.Message, group: int) -> list[can.Message]:
        """Return what the active faults leave of a frame of a group, or of a SYNC to the drives."""
        frames, node = [msg], msg.arbitration_id & 0x7F
        for armed in [each for each in self._armed if each.fault.active(self.sync)]:
            hook = armed.kind.hook
            if hook is None or group not in armed.kind.touches or group != AT_SYNC and not armed.fault.concerns(node):
                continue
            touched: list[can.Message] = []
            for frame in frames:
                changed = hook(self, armed, frame)
                touched += [frame] if changed is None else changed
                if changed is not None:
                    self.count(armed)
            frames = touched
        return frames

    # -- for the hooks -----------------------------------------------------------------------------------------------

    def put(self, frame: can.Message) -> None:
        """Send a frame that no fault touches any more."""
        end = time.monotonic() + QUEUE_PATIENCE_S
        while True:
            try:
                return self._bus.send(frame)
            except can.CanOperationError as error:
                full = error.error_code in QUEUE_FULL or "buffer full" in str(error)
                if not full or time.monotonic() > end:
                    raise
            time.sleep(0.001)

    def later(self, frame: can.Message, delay_s: float) -> None:
        """Send the frame after a delay in real time."""
        self._at(frame, time.monotonic() + delay_s)

    def _at(self, frame: can.Message, due_s: float) -> None:
        self._due.append((due_s, frame))
        self._due.sort(key=lambda entry: entry[0])

    @property
    def now_s(self) -> float:
        """Return the time of the drives: real, or by SYNCs."""
        return time.monotonic() if self.real else self.sync * self.period_s

    def hold(self, frame: can.Message, due_s: float) -> None:
        """Send the frame at a time of the drives, after those that are due by then."""
        if self.real:
            self._at(frame, due_s)
        else:
            self._held.append((due_s, frame))

    def after_next_sync(self, frame: can.Message) -> None:
        """Send the frame when the next SYNC has come."""
        self._held.append((0.0, frame))

    @property
    def answers_per_sync(self) -> int:
        """Return the number of TPDOs that followed the last SYNC."""
        return self._answers[1]


WireHook = Callable[[FaultyWire, Armed, can.Message], list[can.Message] | None]


def _frame(can_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def _changing(change: Callable[[Fault, can.Message], bytes | None]) -> WireHook:
    """Return a hook that sends other data in place of those of a frame; None = this frame is not meant."""

    def hook(_wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
        data = change(armed.fault, frame)
        return None if data is None or not armed.take() else [_frame(frame.arbitration_id, data)]

    return hook


# ---------------------------------------------------------------------------------------------- lost, delayed, repeated


def lose(_wire: FaultyWire, armed: Armed, _frame: can.Message) -> list[can.Message] | None:
    """Frames are lost."""
    return [] if armed.take() else None


def lose_some(_wire: FaultyWire, armed: Armed, _frame: can.Message) -> list[can.Message] | None:
    """A random share of the frames is lost."""
    return [] if armed.rng.random() < armed.fault.share and armed.take() else None


def send_twice(_wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Frames are sent twice."""
    return [frame, _frame(frame.arbitration_id, bytes(frame.data))] if armed.take() else None


def send_last(wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Answers arrive after all others of their SYNC."""
    if not armed.take():
        return None
    wire.later(frame, DELAYED_SHARE * wire.period_s)
    return []


def delay(wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Frames are sent after a delay; without one, after the next SYNC."""
    if not armed.take():
        return None
    if armed.fault.delay_s:
        wire.later(frame, armed.fault.delay_s)
    else:
        wire.after_next_sync(frame)
    return []


def gather(wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Frames of a while are held back and come at once."""
    now = wire.now_s
    if now >= armed.due_s - HAIR_S:
        if not armed.take():
            return None
        armed.due_s = now + armed.fault.delay_s
    wire.hold(frame, armed.due_s)
    return []


def shuffle(wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Answers to one SYNC come in another order."""
    armed.held.append(frame)
    if len(armed.held) < max(wire.answers_per_sync, 1):
        return []
    frames, armed.held = armed.held, []
    armed.rng.shuffle(frames)
    return frames


def freeze(_wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Frames repeat the first one."""
    data = armed.memory.setdefault(frame.arbitration_id, bytes(frame.data))
    return [_frame(frame.arbitration_id, data)]


# ------------------------------------------------------------------------------------------------------ other content


def cut(stop: int) -> WireHook:
    """Return a hook that sends the first bytes only."""
    return _changing(lambda _fault, frame: bytes(frame.data)[:stop])


def tear(_wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Two answers with different positions follow one SYNC."""
    if not armed.take():
        return None
    other = bytearray(frame.data)
    other[2] ^= 0xFF
    return [frame, _frame(frame.arbitration_id, bytes(other))]


def status_bit(bit: int, value: bool) -> WireHook:
    """Return a hook that sets or clears a bit of the statusword."""

    def change(_fault: Fault, frame: can.Message) -> bytes:
        word = struct.unpack_from("<H", frame.data)[0] & ~(1 << bit) | value << bit
        return struct.pack("<H", word) + bytes(frame.data[2:])

    return _changing(change)


@_changing
def add_torque(fault: Fault, frame: can.Message) -> bytes | None:
    """The torque word is larger by `code`."""
    data = bytes(frame.data)
    if len(data) < 8:
        return None
    torque = max(-32768, min(32767, struct.unpack_from("<h", data, 6)[0] + fault.code))
    return data[:6] + struct.pack("<h", torque)


# ---------------------------------------------------------------------------------------------------------------- SDO


def of_object(hook: WireHook) -> WireHook:
    """Return a hook for SDO answers about the object of the fault only."""

    def limited(wire: FaultyWire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
        fault = armed.fault
        if fault.index and struct.unpack_from("<HB", frame.data, 1) != (fault.index, fault.subindex):
            return None
        return hook(wire, armed, frame)

    return limited


@_changing
def abort(fault: Fault, frame: can.Message) -> bytes:
    """SDO answers are aborts."""
    return b"\x80" + bytes(frame.data[1:4]) + struct.pack("<I", fault.code)


@_changing
def other_object(_fault: Fault, frame: can.Message) -> bytes:
    """SDO answers name another object."""
    return bytes([frame.data[0], frame.data[1] ^ 1, *frame.data[2:]])


@_changing
def wrong_toggle(_fault: Fault, frame: can.Message) -> bytes | None:
    """The toggle bit of segments is inverted."""
    return bytes([frame.data[0] ^ 0x10, *frame.data[1:]]) if frame.data[0] & 0xE0 in (0x00, 0x20) else None


def answer_twice(_wire: FaultyWire, _armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """A second device answers too, with another last bit."""
    data = bytes(frame.data)
    return [frame, _frame(frame.arbitration_id, data[:-1] + bytes([data[-1] ^ 0x01]) if len(data) == 8 else data)]


# -------------------------------------------------------------------------------------------------- frames of no drive


def also(frames: Callable[[Fault, int], list[can.Message]]) -> WireHook:
    """Return a hook that sends frames of its own beside; `frames` is called with the fault and its node, or 1."""

    def hook(wire: FaultyWire, armed: Armed, _frame: can.Message) -> None:
        for frame in frames(armed.fault, armed.fault.node or 1):
            if armed.take():
                wire.count(armed)
                wire.put(frame)

    return hook


def of_node(group: int, data: bytes) -> WireHook:
    """Return a hook that sends one frame with the identifier of the fault's node in a group."""
    return also(lambda _fault, node: [_frame(group + node, data)])


def of_bus(can_id: int, data: bytes) -> WireHook:
    """Return a hook that sends one frame."""
    return also(lambda _fault, _node: [_frame(can_id, data)])


def emergency(size: int = 8, times: int = 1) -> WireHook:
    """Return a hook that sends EMCY messages, whole or short."""
    return also(
        lambda fault, node: (
            [_frame(EMCY + node, struct.pack("<HB5s", fault.code, 0x81, b"\x01\x02\x03\x04\x05")[:size])] * times
        )
    )


def error_frames(bits: int, data: bytes = bytes(8), times: int = 1) -> WireHook:
    """Return a hook that sends error frames."""
    frame = can.Message(arbitration_id=bits, data=data, is_error_frame=True, is_extended_id=False)
    return also(lambda _fault, _node: [frame] * times)


def strange_frames(_fault: Fault, node: int) -> list[can.Message]:
    """An extended frame and a remote frame of other devices."""
    return [
        can.Message(arbitration_id=0x1ABCDE0, data=b"\x01\x02", is_extended_id=True),
        can.Message(arbitration_id=HEARTBEAT + node, is_remote_frame=True, is_extended_id=False),
    ]


def sync_slowly(wire: FaultyWire, armed: Armed, frame: can.Message) -> None:
    """Another master sends SYNC slowly, in real time."""
    for number in range(round(SLOW_SYNC_LASTS_S / SLOW_SYNC_S)):
        wire.later(frame, number * SLOW_SYNC_S)
        wire.count(armed)
