"""Which objects of a drive are configuration: by access type, by what PDOs carry, and by what CiA 301 and 402 list.

Configuration = it can be read and written, no PDO that is switched on carries it, and no profile has it as a command, a
set point or a message. All the rest is kept apart: it changes by itself, or writing it does something.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Final, Literal

from canopen.objectdictionary import ODVariable

from drives.configuration.values import Value
from drives.pdo import INVALID
from drives.profile import DriveProfile

Address = tuple[int, int]
#: fixed = read only and does not change; actual = changes by itself; process = what the master sends while it moves;
#: command = writing it does something.
Kind = Literal["configuration", "fixed", "actual", "process", "command", "write only"]

#: Writing to these acts (CiA 301): messages are deleted, parameters stored or lost, a program is loaded.
_COMMANDS: Final = frozenset({0x1003, 0x1010, 0x1011, 0x1020, 0x1021, 0x1023, 0x1024, 0x1F50, 0x1F51})
#: What changes by itself, also where a sheet lets it be written (CiA 301: errors, time stamps; CiA 402-2: inputs).
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


def kind_of(entry: ODVariable, mapped: Collection[Address]) -> Kind:
    """What an object is.

    Parameters
    ----------
    entry : ODVariable
        As the data sheet has it.
    mapped : collection of (index, subindex)
        What PDOs that are switched on carry.
    """
    access = entry.access_type
    if entry.index in _COMMANDS:
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
    """Why an object is not written, whoever asks for it; None where it may be."""
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
