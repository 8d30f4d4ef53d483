"""Write ledger: file that stores each object's original value before the gateway writes the object to a drive.

An entry belongs to a drive, by its serial number, and is found from any cell file and any spelling of the bus.
Simulated drives share their serial numbers: on a network (`drives.bus_spec.NETWORKS`) an entry belongs to the bus too.
A drive without serial number is known by vendor, product, revision, node and bus.

The original is what the drive held when the gateway first wrote the object. A value that the gateway did not write is a
new original.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

from drives.bus_spec import NETWORKS
from drives.errors import ConfigurationRefused
from drives.files import lock_file, read_sealed, write_sealed
from drives.objects import object_name
from drives.values import Identity

SCHEMA: Final = 2
#: Serial numbers that are none.
_NO_SERIAL: Final = (0, 0xFFFFFFFF)
#: Longest wait for another process that writes the same ledger [s].
_PATIENCE_S: Final = 2.0
_POLL_S: Final = 0.01

#: Who wrote: a command that configures drives for its own use, or `config apply` before and after its last write.
Writer = Literal["run", "applying", "applied"]


@dataclass(frozen=True, slots=True)
class KnownDevice:
    """Identity of one drive or measuring device in the ledger; None = not known.

    Attributes
    ----------
    node_id : int
    bus : str or None
        `BusSpec.name`.
    vendor_id, product_code, revision, serial_number : int or None
    """

    node_id: int
    bus: str | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None

    @classmethod
    def of(cls, identity: Identity, bus: str | None) -> KnownDevice:
        """Build the device from the identity that it has reported on a bus."""
        serial = None if identity.serial_number in _NO_SERIAL else identity.serial_number
        return cls(identity.node_id, bus, identity.vendor_id, identity.product_code, identity.revision, serial)


def without_shared_serials(devices: Sequence[KnownDevice]) -> list[KnownDevice]:
    """Return the devices of one bus; a serial number that two of them share is left out."""

    def key(device: KnownDevice) -> tuple[int | None, ...]:
        return device.vendor_id, device.product_code, device.serial_number

    keys = [key(device) for device in devices]
    return [replace(each, serial_number=None) if keys.count(key(each)) > 1 else each for each in devices]


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """One object that was written.

    Attributes
    ----------
    node_id, index, subindex : int
        Which object of which node.
    data_type : str
        Its type.
    old, new : int
        Its original value, and what was written last.
    reason : str
        Why it was written.
    serial_number, vendor_id, product_code, revision, bus : optional
        Of the device, as `KnownDevice`.
    writer : "run", "applying" or "applied"
    also : tuple of int
        Further values that the gateway wrote, or that the drive made of them, and that it may still hold.
    open : bool
        A write has begun and was not read back: whatever the drive holds may come from it.
    """

    node_id: int
    index: int
    subindex: int
    data_type: str
    old: int
    new: int
    reason: str
    serial_number: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    bus: str | None = None
    writer: Writer = "run"
    also: tuple[int, ...] = field(default=(), compare=False)
    open: bool = field(default=False, compare=False)

    @property
    def where(self) -> str:
        """Return node and object as text, e.g. `node 3:6072:00 (max_torque)`."""
        return f"node {self.node_id}:{object_name(self.index, self.subindex)}"

    def __str__(self) -> str:
        return f"{self.where}: {self.old:#x} -> {self.new:#x} ({self.reason})"

    @property
    def address(self) -> tuple[int, int]:
        """Index and subindex."""
        return self.index, self.subindex

    @property
    def device(self) -> KnownDevice:
        """Return the device of the object."""
        return KnownDevice(self.node_id, self.bus, self.vendor_id, self.product_code, self.revision, self.serial_number)

    def is_own(self, value: int) -> bool:
        """Return whether the gateway wrote this value, or the drive derived it from such a value."""
        return value == self.new or value in self.also

    def is_of(self, device: KnownDevice) -> bool:
        """Return whether the object belongs to a device; unknown fields count as equal."""
        pairs: list[tuple[object, object]] = [
            (self.vendor_id, device.vendor_id),
            (self.product_code, device.product_code),
        ]
        if self.serial_number is not None:
            if self.serial_number != device.serial_number:
                return False
        else:
            pairs += [(self.node_id, device.node_id), (self.revision, device.revision)]
        if _is_network(self.bus) or self.serial_number is None:
            pairs.append((self.bus, device.bus))
        return all(None in pair or pair[0] == pair[1] for pair in pairs)


def _is_network(bus: str | None) -> bool:
    return bus is not None and bus.partition(":")[0] in NETWORKS


class WriteLedger:
    """Ledger entries of any number of drives, in the order of their first write.

    Parameters
    ----------
    path : Path, optional
        JSON file, replaced at each change; several processes may use it. None = kept in memory only.

    Raises
    ------
    ConfigurationRefused
        The file exists and is not a ledger.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._entries: list[LedgerEntry] = []
        self._stamp: tuple[int, ...] | None = None
        self._written: list[dict[str, Any]] | None = None
        self._read()

    @property
    def entries(self) -> tuple[LedgerEntry, ...]:
        """Return all entries."""
        return tuple(self._entries)

    def of_node(self, node_id: int) -> tuple[LedgerEntry, ...]:
        """Return the entries of every device that was written to at a node id."""
        return tuple(entry for entry in self._entries if entry.node_id == node_id)

    def of(self, device: KnownDevice) -> tuple[LedgerEntry, ...]:
        """Return the entries of one device."""
        return tuple(entry for entry in self._entries if entry.is_of(device))

    def of_other_bus(self, device: KnownDevice) -> tuple[LedgerEntry, ...]:
        """Return the entries of a device without serial number that were written over a bus of another name.

        They belong to this device where its adapter was renamed, and to another one like it elsewhere. On a network
        there is no adapter.
        """
        if device.serial_number is not None or _is_network(device.bus):
            return ()
        like = [each for each in self._entries if replace(each, bus=device.bus).is_of(device)]
        return tuple(each for each in like if not each.is_of(device) and not _is_network(each.bus))

    def of_predecessors(self, device: KnownDevice) -> tuple[LedgerEntry, ...]:
        """Return the entries of other devices that were written to at the same node of the same bus."""
        same = (device.node_id, device.bus)
        return tuple(each for each in self._entries if (each.node_id, each.bus) == same and not each.is_of(device))

    def note(self, *entries: LedgerEntry) -> None:
        """Store writes that are about to be sent.

        Parameters
        ----------
        entries : LedgerEntry
            `old` = what the object holds now, `new` = what is written; several for one object in their order.

        Raises
        ------
        ConfigurationRefused
            The ledger cannot be written: then nothing may be written to the drive.
        """
        batches: dict[tuple[int, int, int], list[LedgerEntry]] = {}
        for entry in entries:
            batches.setdefault((entry.node_id, *entry.address), []).append(entry)
        with self._change() as held:
            for batch in batches.values():
                _enter(held, batch)

    def expect(self, device: KnownDevice, values: Sequence[tuple[tuple[int, int], int]]) -> None:
        """Store further values that a restore is about to write to objects that have an entry."""
        more: dict[tuple[int, int], list[int]] = {}
        for address, value in values:
            more.setdefault(address, []).append(value)

        def with_values(entry: LedgerEntry) -> LedgerEntry:
            also = tuple(dict.fromkeys((*entry.also, *more[entry.address])))
            return replace(entry, also=also, open=True)

        with self._change() as held:
            self._each(held, device, set(more), with_values)

    def confirm(self, device: KnownDevice, values: dict[tuple[int, int], int]) -> None:
        """Store the values read back after a write; they reach the disk with the next change or by `settle`."""

        def closed(entry: LedgerEntry) -> LedgerEntry:
            back = values[entry.address]
            also = entry.also if back == entry.old or entry.is_own(back) else (*entry.also, back)
            return replace(entry, also=also, open=False)

        self._each(self._entries, device, set(values), closed)

    def settle(self, mark: Callable[[LedgerEntry], LedgerEntry] = lambda entry: entry) -> None:
        """Write the entries confirmed since the last change to disk, each modified by `mark`."""
        with self._change() as held:
            held[:] = [mark(entry) for entry in held]

    def forget(self, *entries: LedgerEntry) -> None:
        """Remove entries whose original value has been restored."""
        self.exchange(entries)

    def exchange(self, out: Sequence[LedgerEntry], back: Sequence[LedgerEntry] = ()) -> None:
        """Replace entries by others in one change."""
        gone = {(entry.device, entry.address) for entry in out}
        put = {(entry.device, entry.address): entry for entry in back}
        with self._change() as held:
            kept = [put.pop((each.device, each.address), each) for each in held]
            new = set(map(id, back))
            held[:] = [each for each in kept if id(each) in new or (each.device, each.address) not in gone]
            held += put.values()

    @staticmethod
    def _each(
        held: list[LedgerEntry],
        device: KnownDevice,
        addresses: set[tuple[int, int]],
        change: Callable[[LedgerEntry], LedgerEntry],
    ) -> None:
        held[:] = [change(each) if each.address in addresses and each.is_of(device) else each for each in held]

    # -- file --------------------------------------------------------------------------------------------------------

    @contextmanager
    def _change(self) -> Generator[list[LedgerEntry]]:
        """Change the list of entries under the file lock and write it to disk at the end."""
        if self.path is None:
            yield self._entries
            return
        try:
            with _locked(self.path):
                self._read()
                held = list(self._entries)
                yield held
                entries = [{name: getattr(entry, name) for name in LedgerEntry.__slots__} for entry in held]
                if entries != self._written and (held or self.path.exists()):
                    write_sealed(self.path, {"schema": SCHEMA, "entries": entries})
                    self._stamp, self._written = _stamp(self.path), entries
                self._entries = held
        except OSError as error:
            raise ConfigurationRefused(
                f"write ledger {self.path} cannot be written: {error}",
                advice="nothing is written to a drive without it; free some space or choose another folder",
            ) from error

    def _read(self) -> None:
        """Read the file if another process has changed it."""
        stamp = None if self.path is None else _stamp(self.path)
        if self.path is not None and stamp is not None and stamp != self._stamp:
            self._entries = _read_entries(self.path)
            self._stamp, self._written = stamp, None


def _enter(held: list[LedgerEntry], batch: Sequence[LedgerEntry]) -> None:
    """Store the writes to one object; its original value is kept unless another tool has written the object since."""
    first, last = batch[0], batch[-1]
    now, values = first.old, [entry.new for entry in batch]
    place = next((at for at, each in enumerate(held) if each.address == first.address and each.is_of(first.device)), -1)
    known = held[place] if place >= 0 else None
    if known is None or not _keeps(known, now, last):
        if known is not None:
            held.pop(place)
        held.append(replace(last, old=now, also=tuple(dict.fromkeys(values[:-1])), open=True))
        return
    before = [] if now == known.old else [now]
    also = tuple(dict.fromkeys([*before, *values[:-1]]))
    writer = "applying" if known.writer == "applying" else last.writer
    held[place] = replace(last, old=known.old, also=also, open=True, writer=writer)


def _keeps(known: LedgerEntry, now: int, write: LedgerEntry) -> bool:
    """Return whether the original value stays valid when an object that holds `now` is written again."""
    if known.writer == "applied" and write.writer == "run":
        return False
    return now == known.old or known.is_own(now) or (known.open and known.node_id == write.node_id)


def _stamp(path: Path) -> tuple[int, ...] | None:
    """Return what identifies a version of a file; None = the file does not exist."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


@contextmanager
def _locked(path: Path) -> Generator[None]:
    """Lock a ledger against changes by other processes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT, 0o666)
    try:
        until_s = time.monotonic() + _PATIENCE_S
        while True:
            try:
                lock_file(lock)
                break
            except BlockingIOError:
                if time.monotonic() > until_s:
                    raise TimeoutError("another servo-gateway process is writing it") from None
                time.sleep(_POLL_S)
        yield
    finally:
        os.close(lock)


def _read_entries(path: Path) -> list[LedgerEntry]:
    """Return the entries of a ledger file.

    Raises
    ------
    ConfigurationRefused
        The file is not a ledger.
    """
    try:
        document = read_sealed(path)
        if document.get("schema") != SCHEMA:
            raise ValueError(f"schema {SCHEMA} expected")
        return [LedgerEntry(**entry | {"also": tuple(entry["also"])}) for entry in document["entries"]]
    except (OSError, ValueError) as error:
        advice = "move the file away if the drives need no restore"
        raise ConfigurationRefused(f"{path} is not a write ledger: {error}", advice=advice) from error
