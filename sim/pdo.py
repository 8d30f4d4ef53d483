"""PDOs of a simulated drive with the communication and mapping parameters that the master wrote (CiA 301, 7.5).

Nothing is assumed about a map: what is packed into a TPDO and taken out of an RPDO follows from 0x1A00 and 0x1600 as
stored, and both may be changed only while the PDO is switched off.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial

from canopen.sdo.exceptions import SdoAbortedError

from sim.objects import (
    DEVICE_STATE,
    NO_OBJECT,
    NOT_MAPPABLE,
    PDO_TOO_LONG,
    STRUCT_CODES,
    UNSUPPORTED_ACCESS,
    VALUE_RANGE,
    Address,
    Getter,
    ObjectStore,
    Setter,
)

MAX_ENTRIES = 8
DISABLED = 1 << 31
EVENT_TYPES = (254, 255)


class Pdo:
    """Parameters of one PDO.

    Attributes
    ----------
    cob_id : with bit 31 set while the PDO is off
    transmission : 0 acyclic synchronous, 1 to 240 every n-th SYNC, 254 and 255 by event
    inhibit_100us, event_ms : times of event-driven transmission
    inhibit_abort : how an inhibit time is refused while the PDO exists
    """

    def __init__(self, store: ObjectStore, communication: int, mapping: int) -> None:
        self._store = store
        self.cob_id = DISABLED
        self.transmission, self.inhibit_100us, self.event_ms, self.sync_start = 255, 0, 0, 0
        self.inhibit_abort = DEVICE_STATE
        self._map: list[int] = []
        self._count = 0
        self.on_change: Callable[[], None] = lambda: None
        self.packing = struct.Struct("<")
        self.getters: list[Getter] = []
        self.setters: list[Setter | None] = []
        self._communication = communication
        self._register(communication, mapping)

    @property
    def _locked(self) -> bool:
        """A valid PDO is not mapped, unless its identifier is fixed, so that it cannot be switched off."""
        return self.enabled and self._store.entries[self._communication, 1].set is not None

    @property
    def enabled(self) -> bool:
        """Return whether the PDO is valid (bit 31 of the COB-ID is 0)."""
        return not self.cob_id & DISABLED

    @property
    def frame_id(self) -> int:
        """Return the CAN identifier."""
        return self.cob_id & 0x7FF

    @property
    def addresses(self) -> list[Address]:
        """Return the addresses of the mapped objects in order."""
        return [(value >> 16, value >> 8 & 0xFF) for value in self._map[: self._count]]

    def preset(self, addresses: Sequence[Address], transmission: int) -> None:
        """Set the default mapping, and no times of event-driven transmission."""
        self._map = [at << 16 | sub << 8 | 8 * self._store.find(at, sub).size_bytes for at, sub in addresses]
        self._count, self.transmission = len(addresses), transmission
        self.inhibit_100us = self.event_ms = 0
        self.refresh()

    def due(self, sync_count: int) -> bool:
        """Return whether this synchronous TPDO is sent after a SYNC, counted from 1."""
        return self.enabled and 1 <= self.transmission <= 240 and sync_count % self.transmission == 0

    def _register(self, communication: int, mapping: int) -> None:
        store, entries = self._store, self._store.entries
        store.constant((communication, 0), "u8", 5 if communication >= 0x1800 else 2)
        store.live((communication, 1), "u32", lambda: self.cob_id, self._set_cob_id)
        store.live((communication, 2), "u8", lambda: self.transmission, self._set_transmission)
        if communication >= 0x1800:
            store.live((communication, 3), "u16", lambda: self.inhibit_100us, self._set_inhibit)
            store.live((communication, 5), "u16", lambda: self.event_ms, partial(setattr, self, "event_ms"))
            store.live((communication, 6), "u8", lambda: self.sync_start, partial(setattr, self, "sync_start"))
        store.live((mapping, 0), "u8", lambda: self._count, self._set_count)
        for sub in range(1, MAX_ENTRIES + 1):
            store.live((mapping, sub), "u32", self._map_getter(sub), self._map_setter(sub))
        for address in [*entries]:
            if address[0] in (communication, mapping):
                entry = entries[address]
                entries[address] = type(entry)(entry.type, entry.get, entry.set, mappable=False)

    def _map_getter(self, sub: int) -> Callable[[], int]:
        return lambda: self._map[sub - 1] if sub <= len(self._map) else 0

    def _map_setter(self, sub: int) -> Callable[[int], None]:
        def assign(value: int) -> None:
            if self._locked or self._count:
                raise SdoAbortedError(UNSUPPORTED_ACCESS)
            self._check_mappable(value)
            self._map += [0] * (sub - len(self._map))
            self._map[sub - 1] = value

        return assign

    def _check_mappable(self, value: int) -> None:
        try:
            entry = self._store.find(value >> 16, value >> 8 & 0xFF)
        except SdoAbortedError as error:
            raise SdoAbortedError(NO_OBJECT) from error
        if not entry.mappable or value & 0xFF != 8 * entry.size_bytes:
            raise SdoAbortedError(NOT_MAPPABLE)

    def _set_cob_id(self, value: int) -> None:
        was, new = self.cob_id & 0x7FF, value & 0x7FF
        if self.enabled and not value & DISABLED and was != new:
            raise SdoAbortedError(DEVICE_STATE)
        if value & 1 << 29 or not 0x180 <= new <= 0x57F:
            raise SdoAbortedError(VALUE_RANGE)
        self.cob_id = value
        self.on_change()

    def _set_transmission(self, value: int) -> None:
        if 241 <= value <= 253:
            raise SdoAbortedError(VALUE_RANGE)
        self.transmission = value
        self.on_change()

    def _set_inhibit(self, value: int) -> None:
        if self.enabled:
            raise SdoAbortedError(self.inhibit_abort)
        self.inhibit_100us = value

    def _set_count(self, value: int) -> None:
        if self._locked:
            raise SdoAbortedError(UNSUPPORTED_ACCESS)
        if value > len(self._map):
            raise SdoAbortedError(VALUE_RANGE if value > MAX_ENTRIES else PDO_TOO_LONG)
        if sum(entry & 0xFF for entry in self._map[:value]) > 64:
            raise SdoAbortedError(PDO_TOO_LONG)
        self._count = value
        self.refresh()

    def refresh(self) -> None:
        """Turn the map into one struct and a list of functions."""
        found = [self._store.find(*address) for address in self.addresses]
        self.packing = struct.Struct("<" + "".join(STRUCT_CODES[entry.type] for entry in found))
        self.getters = [entry.get for entry in found]
        self.setters = [entry.set for entry in found]
        self.on_change()

    def pack(self) -> bytes:
        """Return the data bytes of one transmission."""
        return self.packing.pack(*[get() for get in self.getters])

    def unpack(self, data: bytes) -> None:
        """Write received data to the mapped objects; a frame that is too short is ignored (CiA 301, 7.2.2.5.2)."""
        if len(data) < self.packing.size:
            return
        for assign, value in zip(self.setters, self.packing.unpack_from(data), strict=True):
            if assign is not None:
                assign(value)
