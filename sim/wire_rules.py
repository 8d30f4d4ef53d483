"""What becomes of a frame under each fault of the wire, and which frames a fault invents."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Protocol

import can

from sim.faults import Fault

SYNC, NMT, ERROR_FRAME_BUS_OFF, ERROR_FRAME_CONTROLLER = 0x080, 0x000, 0x040, 0x004
TPDO1, TPDO2, RPDO1, SDO_ANSWER, SDO_REQUEST, HEARTBEAT, EMCY = 0x180, 0x280, 0x200, 0x580, 0x600, 0x700, 0x080
#: How long the answers of a burst are held back [s].
BURST_S = 0.025
#: Rounding of times that are sums of many periods [s].
HAIR_S = 1e-6
#: Another master with a slow SYNC: its period, and for how long it sends [s].
SLOW_SYNC_S, SLOW_SYNC_LASTS_S = 0.1, 60.0
#: Statusword bits.
BITS: Final = {
    "internal_limit": 1 << 11,
    "following_error": 1 << 13,
    "warning": 1 << 7,
    "not_remote": 1 << 9,
    "not_following": 1 << 12,
}


class Wire(Protocol):
    """What a rule may ask of the adapter."""

    def later(self, frame: can.Message, delay_s: float) -> None:
        """Send the frame after a time by the clock."""
        ...

    @property
    def now_s(self) -> float:
        """Time that the drives know: by the clock, or by SYNCs."""
        ...

    def hold(self, frame: can.Message, due_s: float) -> None:
        """Send the frame at a time that the drives know."""
        ...

    def after_next_sync(self, frame: can.Message) -> None:
        """Send the frame when the next SYNC has come."""
        ...

    @property
    def period_s(self) -> float:
        """SYNC period."""
        ...

    @property
    def answers_per_sync(self) -> int:
        """TPDOs that answered the last SYNC."""
        ...


@dataclass(slots=True)
class Armed:
    """A fault that waits or acts, with what it has to remember."""

    fault: Fault
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


def invented(fault: Fault) -> list[can.Message]:
    """Frames that a fault sends at every SYNC while it acts."""
    node = fault.node or 1
    code = fault.code or 0x7305
    emergency = struct.pack("<HB5s", code, 0x81, b"\x01\x02\x03\x04\x05")
    passive = bytes([0, 0x30, 0, 0, 0, 0, 128, 0])
    bodies: dict[str, list[can.Message]] = {
        "emcy": [_frame(EMCY + node, emergency)],
        "emcy_short": [_frame(EMCY + node, emergency[:2])],
        "emcy_reset": [_frame(EMCY + node, bytes(8))],
        "emcy_storm": [_frame(EMCY + node, emergency)] * 200,
        "boot_up_frame": [_frame(HEARTBEAT + node, b"\x00")],
        "second_master_sync": [_frame(SYNC, b"")],
        "second_master_nmt": [_frame(NMT, bytes([0x01, 0x7E]))],
        "second_master_sdo": [_frame(SDO_REQUEST + node, bytes([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]))],
        "error_frames": [_error(0x08, bytes(8))] * 5,
        "error_passive": [_error(ERROR_FRAME_CONTROLLER, passive)],
        "bus_off": [_error(ERROR_FRAME_BUS_OFF, bytes(8))],
        "strange_frames": [
            can.Message(arbitration_id=0x1ABCDE0, data=b"\x01\x02", is_extended_id=True),
            can.Message(arbitration_id=0x700 + node, is_remote_frame=True, is_extended_id=False),
        ],
    }
    return bodies.get(fault.kind, [])


def slow_syncs(fault: Fault) -> list[tuple[float, can.Message]]:
    """Frames that a fault sends by the clock, and when, from its beginning [s]."""
    if fault.kind != "second_master_slow":
        return []
    return [(number * SLOW_SYNC_S, _frame(SYNC, b"")) for number in range(round(SLOW_SYNC_LASTS_S / SLOW_SYNC_S))]


def _frame(can_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def _error(bits: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=bits, data=data, is_error_frame=True, is_extended_id=False)


Rule = Callable[[Wire, Armed, can.Message], list[can.Message] | None]


def _lose(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    return [] if armed.take() else None


def _lose_some(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    return [] if armed.rng.random() < armed.fault.share and armed.take() else None


def _twice(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    return [frame, _frame(frame.arbitration_id, bytes(frame.data))] if armed.take() else None


def _delay(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    if not armed.take():
        return None
    default_s = {"tpdo_delayed": 0.4 * wire.period_s, "sdo_late": 0.1}.get(armed.fault.kind, 1.0)
    wire.later(frame, armed.fault.delay_s or default_s)
    return []


def _after_next_sync(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    if not armed.take():
        return None
    if armed.fault.delay_s:
        wire.later(frame, armed.fault.delay_s)
    else:
        wire.after_next_sync(frame)
    return []


def _gather(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    """Hold the frames of a while back and let them come at once."""
    now = wire.now_s
    if now >= armed.due_s - HAIR_S:
        if not armed.take():
            return None
        armed.due_s = now + (armed.fault.delay_s or BURST_S)
    wire.hold(frame, armed.due_s)
    return []


def _shuffle(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    armed.held.append(frame)
    if len(armed.held) < max(wire.answers_per_sync, 1):
        return []
    frames, armed.held = armed.held, []
    armed.rng.shuffle(frames)
    return frames


def _cut(stop: int) -> Rule:
    def rule(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
        return [_frame(frame.arbitration_id, bytes(frame.data)[:stop])] if armed.take() else None

    return rule


def _tear(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    if not armed.take():
        return None
    other = bytearray(frame.data)
    other[2] ^= 0xFF
    return [frame, _frame(frame.arbitration_id, bytes(other))]


def _freeze(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    data = armed.memory.setdefault(frame.arbitration_id, bytes(frame.data))
    return [_frame(frame.arbitration_id, data)]


def _status_bit(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    if not armed.take():
        return None
    word = struct.unpack_from("<H", frame.data)[0]
    bit = BITS[armed.fault.kind]
    word = word & ~bit if armed.fault.kind.startswith("not_") else word | bit
    return [_frame(frame.arbitration_id, struct.pack("<H", word) + bytes(frame.data[2:]))]


def _spike(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    data = bytes(frame.data)
    if len(data) < 8 or not armed.take():
        return None
    torque = struct.unpack_from("<h", data, 6)[0]
    torque = max(-32768, min(32767, torque + (armed.fault.code or 700)))
    return [_frame(frame.arbitration_id, data[:6] + struct.pack("<h", torque))]


def _sdo(change: Callable[[Fault, bytes], bytes | None]) -> Rule:
    def rule(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
        data = bytes(frame.data)
        fault = armed.fault
        if fault.index and struct.unpack_from("<HB", data, 1) != (fault.index, fault.subindex):
            return None
        changed = change(fault, data)
        if changed is None or not armed.take():
            return None
        return [_frame(frame.arbitration_id, changed)]

    return rule


def _abort(fault: Fault, data: bytes) -> bytes:
    return b"\x80" + data[1:4] + struct.pack("<I", fault.code or 0x08000022)


def _other_object(fault: Fault, data: bytes) -> bytes:
    return data[:1] + struct.pack("<H", struct.unpack_from("<H", data, 1)[0] ^ 1) + data[3:]


def _wrong_toggle(fault: Fault, data: bytes) -> bytes | None:
    return bytes([data[0] ^ 0x10]) + data[1:] if data[0] & 0xE0 in (0x00, 0x20) else None


def _matching(rule: Rule) -> Rule:
    """The rule, for answers about the fault's object only."""

    def limited(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
        fault = armed.fault
        if fault.index and struct.unpack_from("<HB", frame.data, 1) != (fault.index, fault.subindex):
            return None
        return rule(wire, armed, frame)

    return limited


def _double(wire: Wire, armed: Armed, frame: can.Message) -> list[can.Message] | None:
    data = bytes(frame.data)
    return [frame, _frame(frame.arbitration_id, data[:-1] + bytes([data[-1] ^ 0x01]) if len(data) == 8 else data)]


_ANSWERS: Final = (TPDO1, TPDO2)
_ALL: Final = (TPDO1, TPDO2, 0x380, 0x480, SDO_ANSWER, HEARTBEAT, EMCY)

#: By kind: groups of CAN ids that it touches, and what it does to a frame (None = not touched).
RULES: Final[dict[str, tuple[tuple[int, ...], Rule]]] = {
    "tpdo_lost": (_ANSWERS, _lose),
    "tpdo_gone": (_ANSWERS, _lose),
    "tpdo_duplicated": (_ANSWERS, _twice),
    "tpdo_delayed": (_ANSWERS, _delay),
    "tpdo_reordered": (_ANSWERS, _shuffle),
    "tpdo_late": (_ANSWERS, _after_next_sync),
    "tpdo_short": (_ANSWERS, _cut(-1)),
    "tpdo_empty": (_ANSWERS, _cut(0)),
    "tpdo_torn": ((TPDO1,), _tear),
    "tpdo_stuck": (_ANSWERS, _freeze),
    "tpdo_random_loss": (_ANSWERS, _lose_some),
    "burst": (_ANSWERS, _gather),
    "sdo_late": ((SDO_ANSWER,), _matching(_delay)),
    "sdo_too_late": ((SDO_ANSWER,), _matching(_delay)),
    "sdo_lost": ((SDO_ANSWER,), _matching(_lose)),
    "sdo_silent": ((SDO_ANSWER,), _matching(_lose)),
    "sdo_aborted": ((SDO_ANSWER,), _sdo(_abort)),
    "sdo_other_object": ((SDO_ANSWER,), _sdo(_other_object)),
    "sdo_wrong_toggle": ((SDO_ANSWER,), _sdo(_wrong_toggle)),
    "sdo_short": ((SDO_ANSWER,), _sdo(lambda _fault, data: data[:4])),
    "heartbeat_lost": ((HEARTBEAT,), _lose),
    "heartbeat_back": ((HEARTBEAT,), _lose),
    "node_killed": (_ALL, _lose),
    "node_missing": (_ALL, _lose),
    "duplicate_node": ((SDO_ANSWER, HEARTBEAT), _double),
    "internal_limit": ((TPDO1,), _status_bit),
    "following_error": ((TPDO1,), _status_bit),
    "not_remote": ((TPDO1,), _status_bit),
    "not_following": ((TPDO1,), _status_bit),
    "warning": ((TPDO1,), _status_bit),
    "torque_spike": ((TPDO1,), _spike),
}
