"""Which objects of a drive are configuration: by access type, by what PDOs carry, and by what CiA 301 and 402 list.

Configuration = it can be read and written, no PDO that is switched on carries it, and no profile uses it as a command,
a setpoint or a message. All other objects are excluded: they change without being written, or writing them triggers an
action.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Final, Literal

from drives.datasheet.object_values import Value, is_by_node, resolved
from drives.datasheet.sheet import SheetObject
from drives.pdo import INVALID
from drives.profile import DriveProfile

Address = tuple[int, int]
#: fixed = read only and does not change; actual = changes by itself; process = what the master sends while it moves;
#: command = writing it does something.
Kind = Literal["configuration", "fixed", "actual", "process", "command", "write only"]

#: Writing to these acts (CiA 301): messages are deleted, parameters stored or lost, a program is loaded.
_COMMANDS: Final = frozenset({0x1003, 0x1010, 0x1011, 0x1020, 0x1021, 0x1023, 0x1024, 0x1F50, 0x1F51})
#: Actual values, even where a sheet declares them writable (CiA 301: errors, time stamps; CiA 402-2: inputs).
_ACTUAL: Final = frozenset({0x1001, 0x1002, 0x1013, 0x603F, 0x60B9, 0x60FD})
#: Control word, mode, targets, offsets, touch probe, outputs (CiA 402-2, CiA 402-3).
_PROCESS: Final = frozenset(
    {0x6040, 0x6042, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60B8, 0x60C1, 0x60FE, 0x60FF}
)
_IDENTITY: Final = frozenset({0x1000, 0x1008, 0x1009, 0x100A, 0x1018})
#: Safety over CAN (EN 50325-5: commands, communication, mapping, signature) and safety functions of drives.
_SAFETY: Final = (range(0x1300, 0x1400), range(0x6600, 0x6800))
#: Identifiers by which a node is spoken to (CiA 301: SDO server).
_SERVERS: Final = range(0x1200, 0x1280)
_COMMUNICATION: Final = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_MAPPINGS: Final = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_MAPPING_OF: Final = 0x0200
#: Objects of the maker (CiA 301, 7.4.1).
_MAKERS: Final = range(0x2000, 0x6000)
#: Names of objects that set the node id or the bit rate, without anything but letters.
_NODE_ID: Final = re.compile(
    r"(?:node|station|slave|device|module|bus|can(?:open)?)(?:id|address|number)(?![a-z]*filter)"
)
_BIT_RATE: Final = re.compile(r"baud|bitrate|bittiming|(?:can|bus)speed")
#: Names of objects that act when they are written: what is done, and to what.
_ACTION: Final = re.compile(
    r"\b(?:save|stor(?:e|ing)|restore|load|reload|reset|erase|clear|delete|format)\b.*"
    r"\b(?:parameters?|params?|configurations?|config|settings?|eeprom|nvm|nvram|flash|memory|defaults?|factory|all|"
    r"device|drive|errors?|faults?|application|tuning)\b"
    r"|\b(?:factory|default)s?\b.*\b(?:reset|restore|load)\b"
    r"|^(?:save|store|restore|reset|reboot|restart)$|\b(?:reboot|restart|bootloader|soft(?:ware)? ?reset)\b"
    r"|^(?:start|execute|trigger|run)\b"
)
#: "save" and "load" as CiA 301 spells them: the value of an action.
_SIGNATURES: Final = frozenset({0x65766173, 0x64616F6C})
#: Identifiers that the standard gives a node (CiA 301, 7.3.3): EMCY, and the first four PDOs of each direction.
_STANDARD_IDENTIFIERS: Final = {(0x1014, 0): 0x080} | {
    (first + number, 1): base + 0x100 * number
    for first, base in ((0x1400, 0x200), (0x1800, 0x180))
    for number in range(4)
}
_NODE_BITS: Final = 0x7F
_IDENTIFIER: Final = 0x7FF
_LONG_IDENTIFIER: Final = 1 << 29


def kind_of(entry: SheetObject, mapped: Collection[Address]) -> Kind:
    """What an object is.

    Parameters
    ----------
    entry : SheetObject
        As the data sheet has it.
    mapped : collection of (index, subindex)
        What PDOs that are switched on carry.
    """
    access = entry.access_type
    if entry.index in _COMMANDS or is_action(entry):
        return "command"
    if "r" not in access and access != "const":
        return "write only"
    if entry.index in _IDENTITY:
        return "fixed"
    if entry.index in _PROCESS:
        return "process"
    if entry.index in _ACTUAL:
        return "actual"
    if "w" not in access:
        return "actual" if entry.pdo_mappable else "fixed"
    return "process" if (entry.index, entry.subindex) in mapped else "configuration"


def mapped_objects(values: Mapping[Address, Value]) -> frozenset[Address]:
    """What the PDOs carry that are switched on, by their records."""
    return frozenset(_mapped(values))


def _mapped(values: Mapping[Address, Value]) -> Iterator[Address]:
    for (index, subindex), cob_id in values.items():
        off = not isinstance(cob_id, int) or cob_id & INVALID
        if subindex != 1 or off or not any(index in area for area in _COMMUNICATION):
            continue
        for number in range(1, _count(values, index + _MAPPING_OF) + 1):
            word = values.get((index + _MAPPING_OF, number))
            if isinstance(word, int):
                yield word >> 16, word >> 8 & 0xFF


def _count(values: Mapping[Address, Value], mapping: int) -> int:
    count = values.get((mapping, 0), 0)
    return count if isinstance(count, int) else 0


def is_mapping(address: Address) -> bool:
    """Whether an object belongs to a mapping record."""
    return any(address[0] in area for area in _MAPPINGS)


def beyond_length(address: Address, values: Mapping[Address, Value]) -> bool:
    """Whether an object is a mapping entry that its record does not use."""
    return is_mapping(address) and address[1] > _count(values, address[0])


def why_never_written(address: Address, profile: DriveProfile) -> str | None:
    """Return why an object is never written; None where it may be written."""
    index = address[0]
    if any(index in area for area in _SAFETY):
        return "it belongs to a safety function"
    if any(address == (condition.object.index, condition.object.subindex) for condition in profile.safety):
        return f"profile {profile.name} counts it to the safety chain"
    if index in _SERVERS:
        return "the drive is spoken to by it"
    if index in _IDENTITY:
        return "it says which device this is"
    return "writing it acts on the drive" if index in _COMMANDS else None


def is_action(entry: SheetObject) -> bool:
    """Whether an object of the maker acts when it is written (save or load all parameters, reset), by its name."""
    if entry.index not in _MAKERS:
        return False
    return _ACTION.search(_words(entry.name)) is not None


def own_identifier(entry: SheetObject, value: int, node_id: int) -> bool:
    """Whether a value is an identifier (COB-ID) that follows from the node id, by sheet or standard."""
    return _identifier_node(entry, value) == node_id


def confirmation_reason(entry: SheetObject, value: Value, others: Collection[int]) -> str | None:
    """Why a value is written only if a question of its own was answered; None where it needs none.

    Parameters
    ----------
    entry : SheetObject
    value : value
        To be written.
    others : collection of int
        Other nodes of this bus.
    """
    if entry.index in _MAKERS:
        letters = _words(entry.name).replace(" ", "")
        if _NODE_ID.search(letters):
            return "it sets the node id: two drives with one id cannot be distinguished on the bus"
        if _BIT_RATE.search(letters):
            return "it sets the bit rate: with another one the drive cannot be reached, and disturbs the bus"
        if value in _SIGNATURES:
            return "its value is a command of CiA 301 (save, load)"
    other = _identifier_node(entry, value) if isinstance(value, int) and not value & INVALID else None
    if other in others:
        return f"it is the identifier of node {other}: two nodes would use it"
    return None


def _identifier_node(entry: SheetObject, value: int) -> int | None:
    """Node whose identifier a value is; None where it is none, or switched off by another base."""
    base = _STANDARD_IDENTIFIERS.get((entry.index, entry.subindex))
    if is_by_node(entry.default):
        base = resolved(entry.default, 0) & _IDENTIFIER
    if not base or value & _LONG_IDENTIFIER:
        return None
    node = (value & _IDENTIFIER) - base
    return node if 0 < node <= _NODE_BITS else None


def _words(name: str) -> str:
    """A name in lower case, `NodeID` and `node_id` as two words."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return " ".join(re.sub(r"[^A-Za-z]+", " ", spaced).lower().split())
