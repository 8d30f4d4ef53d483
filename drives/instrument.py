"""Measuring device on the bus of the drives (CiA 404): process values by synchronous TPDO, sampled at the same SYNC.

The meaning of its channels is defined by the cell. All frames of one SYNC make one reading; if a frame is missing there
is none, and a channel with an invalid status has no value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from drives.access import NodeAccess
from drives.bus import Bus
from drives.errors import ConfigurationRefused, IdentityMismatch
from drives.ledger import WriteLedger
from drives.objects import OBJECTS, RPDO_COMMUNICATION, TPDO_COMMUNICATION
from drives.other_pdos import OtherPdo
from drives.pdo import PdoPlan, tpdo_plan
from drives.profile import ObjectReference
from drives.scaling import Frames
from drives.values import Identity, InstrumentReading

PROFILE_NUMBER: Final = 404
#: CiA 404: physical unit (coded as CiA 303-2 says) and decimal digits of the process value.
UNIT, DIGITS = 0x6131, 0x6132
METRE: Final = 0x01
_INVALID: Final = 0x07
_MAX_BITS: Final = 64
_TPDOS: Final = 4


@dataclass(frozen=True, slots=True)
class InstrumentSetup:
    """Settings of a measuring device: channels, scaling and unit.

    Attributes
    ----------
    node_id : int
    index : int
        Object of the process values, one channel per subindex: 0x9130 (i32) or 0x7130 (i16) by the standard.
    type : "i16" or "i32"
    subindices : tuple of int
        Which channels, in the order of the values.
    per_bit : float
        What one bit means, in the SI unit.
    unit : int
        That unit by its code in CiA 303-2; the device is asked whether it agrees.
    status_index : int or None
        Object of the channels' status, 0x6150 by the standard; None = the device has none.
    """

    node_id: int
    index: int
    type: Literal["i16", "i32"]
    subindices: tuple[int, ...]
    per_bit: float
    unit: int = METRE
    status_index: int | None = None

    def plans(self) -> tuple[PdoPlan, ...]:
        """TPDOs that carry all values, then all status bytes.

        Raises
        ------
        ConfigurationRefused
            They do not fit into four.
        """
        entries = [ObjectReference(index=self.index, subindex=sub, type=self.type) for sub in self.subindices]
        if self.status_index is not None:
            entries += [ObjectReference(index=self.status_index, subindex=sub, type="u8") for sub in self.subindices]
        frames: list[list[ObjectReference]] = [[]]
        for entry in entries:
            if sum(other.size_bits for other in frames[-1]) + entry.size_bits > _MAX_BITS:
                frames.append([])
            frames[-1].append(entry)
        if len(frames) > _TPDOS:
            what = f"{len(self.subindices)} channels need {len(frames)} TPDOs, a device has {_TPDOS}"
            raise ConfigurationRefused(what, node=self.node_id, advice="use fewer channels, or 16 bits")
        return tuple(tpdo_plan(number, self.node_id, frame) for number, frame in enumerate(frames, start=1))


class Instrument:
    """Master's representation of one measuring device.

    Parameters
    ----------
    bus : Bus
    setup : InstrumentSetup
    ledger : WriteLedger
        Where every write is entered before it happens.
    """

    def __init__(self, bus: Bus, setup: InstrumentSetup, ledger: WriteLedger) -> None:
        self.setup, self.node_id = setup, setup.node_id
        self.plans = setup.plans()
        allowed = {OBJECTS["communication_cycle_period"].index}
        allowed |= {index for plan in self.plans for index in (plan.communication, plan.mapping)}
        allowed |= {area + number for area in (RPDO_COMMUNICATION, TPDO_COMMUNICATION) for number in range(_TPDOS)}
        #: PDOs that are switched on and not of the exchange, as bring-up found them.
        self.other_pdos: tuple[OtherPdo, ...] = ()
        #: Those of them that stay on, as far as it is known.
        self.left_pdos: tuple[OtherPdo, ...] = ()
        self.access = NodeAccess(bus, setup.node_id, "measuring device", allowed, ledger)
        self.identity = Identity(setup.node_id)
        self._unpack = [plan.layout.unpack for plan in self.plans]

    @property
    def answers(self) -> tuple[tuple[int, int], ...]:
        """Return CAN id and length of each TPDO that follows a SYNC."""
        return tuple((plan.cob_id, plan.size_bytes) for plan in self.plans)

    def check_identity(self) -> None:
        """Make sure that this is a CiA 404 measuring device; raises `IdentityMismatch`."""
        kind = self.identity.device_type
        if kind is not None and kind & 0xFFFF != PROFILE_NUMBER:
            what = f"device type {kind:#010x} is not a CiA 404 measuring device"
            raise IdentityMismatch(what, node=self.node_id, index=0x1000, advice="correct the node id in the cell")

    def check_units(self) -> None:
        """Compare the unit of each channel with the cell; raises `ConfigurationRefused` or `SdoError`."""
        for subindex in self.setup.subindices:
            unit = ObjectReference(index=UNIT, subindex=subindex, type="u32")
            code = self.access.read_optional(unit)
            digits = self.access.read_optional(ObjectReference(index=DIGITS, subindex=subindex, type="u8")) or 0
            if code is None:
                continue
            prefix = (code >> 24 ^ 0x80) - 0x80
            per_bit = 10.0 ** (prefix - digits)
            if code >> 16 & 0xFF != self.setup.unit or not math.isclose(per_bit, self.setup.per_bit, rel_tol=1e-6):
                what = f"says unit {code:#010x} with {digits} decimal digits, the cell {self.setup.per_bit:g} per bit"
                self.access.refuse(unit, what, "correct the cell, or set the unit of the device")

    def decode(self, sync_index: int, frames: Frames, first_slot: int) -> InstrumentReading | None:
        """Return the reading of one SYNC, or None if a frame of this device is missing."""
        words: list[int] = []
        for slot, unpack in enumerate(self._unpack, start=first_slot):
            data = frames[slot]
            if data is None:
                return None
            words += unpack(data)
        count = len(self.setup.subindices)
        status = words[count:] or [0] * count
        values = tuple(
            None if state & _INVALID else word * self.setup.per_bit
            for word, state in zip(words[:count], status, strict=True)
        )
        return InstrumentReading(self.node_id, sync_index, tuple(words[:count]), values)
