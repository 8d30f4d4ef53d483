"""Switch off PDOs of a node that the exchange does not use where that is allowed; count and list the others.

They would load the bus with unused frames, and a foreign frame in an RPDO can carry a controlword.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from drives.access import NodeAccess
from drives.errors import ConfigurationRefused, SdoAbort
from drives.objects import RPDO_COMMUNICATION, RPDO_MAPPING, TPDO_COMMUNICATION, TPDO_MAPPING
from drives.pdo import CONTROLWORD, INVALID
from drives.profile import ObjectReference

#: Most PDOs of each direction (CiA 301); a device numbers its own in a row, so that it has no more after so many gaps.
_PDOS: Final = 512
_GAPS: Final = 8
_LAST_SYNCHRONOUS: Final = 240
_MOST_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class OtherPdo:
    """A valid PDO of a node that the exchange does not use.

    Attributes
    ----------
    node_id : int
    name : str
        TPDO1 to TPDO512, RPDO1 to RPDO512.
    communication : int
        Index of its parameter record.
    cob_id : int
        As stored there.
    transmission : int
        0 to 240 with SYNC, 254 and 255 by event.
    mapped : tuple of int
        Mapping entries.
    may_be_switched_off : bool
        The profile allows writing its parameter record.
    """

    node_id: int
    name: str
    communication: int
    cob_id: int
    transmission: int
    mapped: tuple[int, ...]
    may_be_switched_off: bool

    @property
    def is_sent(self) -> bool:
        """Return whether the node sends this PDO (TPDO)."""
        return self.communication >= TPDO_COMMUNICATION

    @property
    def carries_controlword(self) -> bool:
        """Return whether this frame can carry a controlword."""
        return not self.is_sent and any(entry >> 16 == CONTROLWORD.index for entry in self.mapped)

    @property
    def cyclic_bytes(self) -> int | None:
        """Return the frame length that it adds to every SYNC cycle [bytes]; None if it is not sent cyclically."""
        if not self.is_sent or self.transmission > _LAST_SYNCHRONOUS:
            return None
        return min(_MOST_BYTES, sum(entry & 0xFF for entry in self.mapped) // 8)

    def __str__(self) -> str:
        how = "with SYNC" if self.transmission <= _LAST_SYNCHRONOUS else "by event"
        return f"node {self.node_id}: {self.name} (id {self.cob_id & 0x7FF:03X}, {how})"


def other_pdos(access: NodeAccess, planned: Collection[int]) -> tuple[OtherPdo, ...]:
    """Read which PDOs of a node are valid but not used by the exchange; nothing is written.

    Parameters
    ----------
    access : NodeAccess
    planned : collection of int
        Indices of the parameter records of the exchange.

    Raises
    ------
    SdoError
        The node does not answer, or has a PDO whose records cannot be read.
    """
    found = []
    for kind, communication, mapping in (
        ("RPDO", RPDO_COMMUNICATION, RPDO_MAPPING),
        ("TPDO", TPDO_COMMUNICATION, TPDO_MAPPING),
    ):
        gaps = 0
        for number in range(_PDOS):
            record = communication + number
            cob_id = INVALID if record in planned else access.read_optional(_u32(record, 1))
            gaps = gaps + 1 if cob_id is None else 0
            if gaps == _GAPS:
                break
            if cob_id is None or cob_id & INVALID:
                continue
            transmission = access.read(ObjectReference(index=record, subindex=2, type="u8"))
            mapped = _mapped(access, mapping + number)
            name = f"{kind}{number + 1}"
            allowed = access.may_write(record)
            found.append(OtherPdo(access.node_id, name, record, cob_id, transmission, mapped, allowed))
    return tuple(found)


def _mapped(access: NodeAccess, index: int) -> tuple[int, ...]:
    count = access.read_optional(ObjectReference(index=index, subindex=0, type="u8")) or 0
    entries = (access.read_optional(_u32(index, number)) for number in range(1, min(count, 64) + 1))
    return tuple(entry for entry in entries if entry is not None)


def _u32(index: int, subindex: int) -> ObjectReference:
    return ObjectReference(index=index, subindex=subindex, type="u32")


def switch_off(access: NodeAccess, pdo: OtherPdo) -> bool:
    """Switch a PDO off through the write ledger.

    Returns
    -------
    bool
        Whether it is off; False where the profile does not allow it, or the node refuses.

    Raises
    ------
    ConfigurationRefused
        It stays on, and its frame can carry a controlword.
    SdoTimeout, SdoProtocolError
        A transfer failed.
    """
    reason = f"{pdo.name} is not used by the gateway"
    if pdo.may_be_switched_off:
        with suppress(SdoAbort):  # the node refuses the value
            access.write(_u32(pdo.communication, 1), pdo.cob_id | INVALID, reason)
            return True
    if pdo.carries_controlword:
        sender = f"the sender of id {pdo.cob_id & 0x7FF:03X}"
        raise ConfigurationRefused(
            f"{pdo.name} takes a controlword from {sender}, and cannot be switched off",
            node=pdo.node_id,
            index=pdo.communication,
            subindex=1,
            advice=f"add 0x{pdo.communication:04X} to write.allow, or switch this PDO off in the drive",
        )
    return False
