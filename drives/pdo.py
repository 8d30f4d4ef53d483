"""PDO mapping of the cyclic exchange: objects of each frame, and the order of the writes (CiA 301, 7.5.2.36).

RPDO1 = controlword, target position and, in a run that uses it, torque offset. TPDO1 = statusword, position and, if it
fits, the torque object. TPDO2, where it is needed = the torque object if it did not fit, velocity, current. RPDO2, only
in a run that uses it = velocity offset. All synchronous, every SYNC; an RPDO whose type is fixed at 254 or 255 acts
when it comes, just before the SYNC.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from drives.objects import (
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    STRUCT_CODE,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
)
from drives.profile import DriveProfile, ObjectReference

EVERY_SYNC: Final = 1
#: Types of an RPDO that acts when it comes (CiA 301, table 68).
_AT_ONCE: Final = (254, 255)
INVALID: Final = 1 << 31
_NO_RTR: Final = 1 << 30
_MAX_BITS: Final = 64
#: Identifier of the emergency message.
_EMERGENCY: Final = (0x1014, 0)

Role = Literal["statusword", "position", "torque", "velocity", "current"]

CONTROLWORD: Final = ObjectReference(index=0x6040, type="u16")
STATUSWORD: Final = ObjectReference(index=0x6041, type="u16")
#: Names of the offsets that a run adds to the target position.
Offsets = tuple[Literal["velocity", "torque"], ...]
#: Their objects.
OFFSETS: Final[dict[str, ObjectReference]] = {
    "velocity": ObjectReference(index=0x60B1, type="i32"),
    "torque": ObjectReference(index=0x60B2, type="i16"),
}

#: What the master sends: controlword, target position (counts).
COMMAND: Final = struct.Struct("<Hi")
#: What it sends beside that in a run with a torque offset, and in one with a velocity offset (raw).
TORQUE: Final = struct.Struct("<h")
VELOCITY: Final = struct.Struct("<i")

#: Reads one object as a number, by index, subindex and type.
Read = Callable[[int, int, str], int]


@dataclass(frozen=True, slots=True)
class PdoPlan:
    """Required configuration of one PDO.

    Attributes
    ----------
    name : str
        TPDO1, TPDO2, RPDO1 or RPDO2.
    communication, mapping : int
        Indices of its parameter and mapping records.
    cob_id : int
        CAN id, by the predefined connection set.
    entries : tuple of ObjectReference
        Mapped objects in their order.
    """

    name: str
    communication: int
    mapping: int
    cob_id: int
    entries: tuple[ObjectReference, ...]

    @property
    def size_bytes(self) -> int:
        """Return the length of the frame [bytes]."""
        return sum(entry.size_bits for entry in self.entries) // 8

    @property
    def layout(self) -> struct.Struct:
        """Return the codec of the frame."""
        return struct.Struct("<" + "".join(STRUCT_CODE[entry.type] for entry in self.entries))


@dataclass(frozen=True, slots=True)
class Step:
    """One SDO write of a PDO configuration."""

    index: int
    subindex: int
    data_type: str
    value: int
    reason: str

    @property
    def address(self) -> tuple[int, int]:
        """Index and subindex."""
        return self.index, self.subindex


def rpdo_plans(profile: DriveProfile, node_id: int, offsets: Offsets = ()) -> tuple[PdoPlan, ...]:
    """Return the RPDO configurations of a node in a run with these offsets, RPDO1 first."""
    setpoint = (CONTROLWORD, profile.target_position)
    entries = (*setpoint, OFFSETS["torque"]) if "torque" in offsets else setpoint
    first = PdoPlan("RPDO1", RPDO_COMMUNICATION, RPDO_MAPPING, 0x200 + node_id, entries)
    second = PdoPlan("RPDO2", RPDO_COMMUNICATION + 1, RPDO_MAPPING + 1, 0x300 + node_id, (OFFSETS["velocity"],))
    return (first, second) if "velocity" in offsets else (first,)


def tpdo_plan(number: int, node_id: int, entries: Sequence[ObjectReference]) -> PdoPlan:
    """Return the configuration of a TPDO of a node with these objects, from number 1 on."""
    name, cob_id = f"TPDO{number}", 0x080 + 0x100 * number + node_id
    return PdoPlan(name, TPDO_COMMUNICATION + number - 1, TPDO_MAPPING + number - 1, cob_id, tuple(entries))


def tpdo_plans(profile: DriveProfile, node_id: int) -> tuple[tuple[PdoPlan, ...], tuple[Role, ...]]:
    """Return the TPDO configurations of a node, and the role of each mapped object in the order of the bytes.

    Returns
    -------
    plans : tuple of PdoPlan
        One or two.
    roles : tuple of str
        One per mapped object over both frames.
    """
    frames: list[list[tuple[Role, ObjectReference]]] = [
        [("statusword", STATUSWORD), ("position", profile.position.object)],
        [],
    ]
    torque: tuple[Role, ObjectReference] = ("torque", profile.torque.object)
    frames[0 if _bits(frames[0]) + torque[1].size_bits <= _MAX_BITS else 1].append(torque)
    if profile.current is not None or frames[1]:
        optional: list[tuple[Role, ObjectReference]] = []
        if profile.velocity is not None:
            optional.append(("velocity", profile.velocity.object))
        if profile.current is not None:
            optional.append(("current", profile.current.object))
        for entry in optional:
            if _bits(frames[1]) + entry[1].size_bits <= _MAX_BITS:
                frames[1].append(entry)
    plans = tuple(
        tpdo_plan(number, node_id, [entry for _, entry in frame])
        for number, frame in enumerate(frames, start=1)
        if frame
    )
    return plans, tuple(role for frame in frames for role, _ in frame)


def _bits(frame: list[tuple[Role, ObjectReference]]) -> int:
    return sum(entry.size_bits for _, entry in frame)


def differences(plan: PdoPlan, read: Read, *, accepts_at_once: bool = True) -> list[str]:
    """Return the differences between drive and plan as text.

    Parameters
    ----------
    plan : PdoPlan
    read : callable
    accepts_at_once : bool
        Accept an RPDO that acts when it comes: a drive may have no other type.
    """
    found = []
    cob_id = read(plan.communication, 1, "u32")
    if cob_id & INVALID:
        found.append("is switched off")
    if cob_id & 0x1FFFFFFF != plan.cob_id:
        found.append(f"has COB-ID {cob_id & 0x1FFFFFFF:#x} instead of {plan.cob_id:#x}")
    transmission = read(plan.communication, 2, "u8")
    if transmission != EVERY_SYNC and not (accepts_at_once and is_received(plan) and transmission in _AT_ONCE):
        found.append(f"has transmission type {transmission} instead of {EVERY_SYNC}")
    count = read(plan.mapping, 0, "u8")
    if count != len(plan.entries):
        found.append(f"maps {count} objects instead of {len(plan.entries)}")
        return found
    for number, entry in enumerate(plan.entries, start=1):
        mapped = read(plan.mapping, number, "u32")
        if mapped != entry.mapping:
            found.append(f"maps {mapped:08X} at place {number} instead of {entry.mapping:08X}")
    return found


def is_received(plan: PdoPlan) -> bool:
    """Return whether the node receives this PDO."""
    return plan.communication < TPDO_COMMUNICATION


def mapping_steps(plan: PdoPlan, cob_id_now: int) -> list[Step]:
    """Return the writes that configure a PDO, in the order of `ordered_steps`."""
    values = {
        (plan.communication, 1): ("u32", plan.cob_id | cob_id_now & _NO_RTR),
        (plan.communication, 2): ("u8", EVERY_SYNC),
        (plan.mapping, 0): ("u8", len(plan.entries)),
    }
    values |= {(plan.mapping, number): ("u32", each.mapping) for number, each in enumerate(plan.entries, start=1)}
    return ordered_steps(values, f"{plan.name} of the SYNC exchange")


def restore_steps(old: dict[tuple[int, int], tuple[str, int]]) -> list[Step]:
    """Return the writes that restore objects, in reverse order of writing; PDO records in the order of `ordered_steps`.

    Parameters
    ----------
    old : dict
        (index, subindex) -> (type, value to be put back), in the order in which they were first written.
    """
    return ordered_steps(dict(reversed(old.items())), "restore")


def ordered_steps(values: dict[tuple[int, int], tuple[str, int]], reason: str) -> list[Step]:
    """Return the writes of these values in an order that a drive accepts.

    Parameters
    ----------
    values : dict
        (index, subindex) -> (type, value).
    reason : str
        Why they are written.

    Returns
    -------
    list of Step
        Plain objects in the order given, the emergency object switched off before it gets another identifier (CiA 301,
        7.5.2.17), then each PDO in the order the standard asks for: off, emptied, filled, length, type, on.
    """
    steps: list[Step] = []
    for address, (data_type, value) in values.items():
        if 0x1400 <= address[0] < 0x1C00:
            continue
        if address == _EMERGENCY:
            steps.append(Step(*address, data_type, value | INVALID, reason))
        steps.append(Step(*address, data_type, value, reason))
    for communication in sorted({address[0] & ~0x0200 for address in values if 0x1400 <= address[0] < 0x1C00}):
        steps += _record_steps(communication, values, reason)
    return steps


def _record_steps(communication: int, values: dict[tuple[int, int], tuple[str, int]], reason: str) -> list[Step]:
    steps: list[Step] = []
    mapping = communication | 0x0200
    head = values.get((communication, 1))
    if head is not None:
        steps.append(Step(communication, 1, "u32", head[1] | INVALID, reason))
    entries = sorted(address for address in values if address[0] == mapping and address[1] > 0)
    count = values.get((mapping, 0))
    if entries or count is not None:
        steps.append(Step(mapping, 0, "u8", 0, reason))
    length = 0xFF if count is None else count[1]
    steps += [Step(*address, *values[address], reason) for address in entries if address[1] <= length]
    if count is not None:
        steps.append(Step(mapping, 0, "u8", count[1], reason))
    others = sorted(address for address in values if address[0] == communication and address[1] > 1)
    steps += [Step(*address, *values[address], reason) for address in others]
    if head is not None:
        steps.append(Step(communication, 1, "u32", head[1], reason))
    return steps
