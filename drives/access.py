"""Read and write objects of one node: writes need an allow-list, a ledger entry before and a read-back after."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Container, Iterator, Sequence
from dataclasses import asdict, replace
from typing import Final, NoReturn

from drives.abort import ABSENT, READ_ONLY
from drives.bus import Bus
from drives.cia402 import AT_REST, decode_state
from drives.errors import (
    ConfigurationRefused,
    DriveError,
    DriveFault,
    ForeignMaster,
    IdentityMismatch,
    SdoAbort,
    SdoError,
    SdoProtocolError,
    SdoTimeout,
)
from drives.heartbeat import NmtCommand, send_nmt
from drives.ledger import KnownDevice, LedgerEntry, WriteLedger, Writer
from drives.objects import OBJECTS, ObjectEntry, object_name
from drives.pdo import PdoPlan, Step, differences, is_received, mapping_steps, restore_steps
from drives.profile import DriveProfile, ObjectReference
from drives.sdo import NORMAL, SLOW, SdoClient, Transfer

Entry = ObjectEntry | ObjectReference
Address = tuple[int, int]

_NOT_TAKEN: Final = "the drive limits or ignores this value: set it with the maker's tool, then `restore` once more"


class NodeAccess:
    """SDO access to one node.

    Parameters
    ----------
    bus : Bus
    node_id : int
    profile : str
        Name of the profile, for messages.
    allow : collection of int
        Objects that it allows the master to write.
    ledger : WriteLedger
        Every write is entered here before it is sent.
    sdo : SdoClient, optional
        To the node, with its time-outs.
    """

    def __init__(
        self,
        bus: Bus,
        node_id: int,
        profile: str,
        allow: Collection[int],
        ledger: WriteLedger,
        sdo: SdoClient | None = None,
    ) -> None:
        self.node_id = node_id
        self.bus = bus
        self.sdo = SdoClient(bus, node_id) if sdo is None else sdo
        self._profile, self._allow = profile, allow
        #: Key of the node in the ledger; its identity is added once it is read.
        self.device = KnownDevice(node_id, bus.spec.name)
        #: Objects that `restore` left unchanged because another tool has written them since.
        self.superseded: tuple[LedgerEntry, ...] = ()
        #: Type and value of each configured object when it was last read back.
        self._configured: dict[Address, tuple[str, int]] = {}
        self._ledger = ledger

    def read(self, entry: Entry, options: Transfer = NORMAL) -> int:
        """Read an object."""
        return self.sdo.read(entry.index, entry.subindex, entry.type, options)

    def read_optional(self, entry: Entry) -> int | None:
        """Read an object; return None if the drive does not have it."""
        try:
            return self.read(entry)
        except SdoAbort as abort:
            if abort.code in ABSENT:
                return None
            raise

    def read_readable(self, entry: Entry, options: Transfer = NORMAL) -> int | None:
        """Read an object that only informs; return None if the drive refuses it or answers too short."""
        try:
            return self.read(entry, options)
        except (SdoAbort, SdoProtocolError):
            return None

    def write(
        self, entry: Entry, value: int, reason: str, options: Transfer = NORMAL, rounded: Container[int] = ()
    ) -> int:
        """Write an object and return what is read back; nothing is written if it holds the value already.

        Parameters
        ----------
        entry : object
        value : int
        reason : str
            Why it is written, for the ledger.
        options : Transfer
        rounded : container of int
            Values beside `value` that may be read back from a drive that rounds.

        Raises
        ------
        ConfigurationRefused
            The profile does not allow it, or it does not read back as written.
        SdoError
            The transfer failed.
        """
        self._check_allowed(entry)
        now = self.read(entry, options)
        if now == value:
            self._configured[entry.index, entry.subindex] = (entry.type, value)
            return value
        step = Step(entry.index, entry.subindex, entry.type, value, reason)
        self._ledger.note(self._entry(step, now))
        return self.write_step(step, options, rounded)

    def note_steps(self, steps: Sequence[Step], writer: Writer = "run") -> dict[Address, tuple[str, int]]:
        """Record writes in the ledger, all of them before the first one is sent.

        Returns
        -------
        dict
            (index, subindex) -> (type, value that the object holds now).
        """
        held = {step.address: (step.data_type, self._before(step.address, step.data_type)) for step in steps}
        entries = [self._entry(step, held[step.address][1], writer) for step in steps]
        self._ledger.note(*entries)
        return held

    def write_step(self, step: Step, options: Transfer = NORMAL, rounded: Container[int] = ()) -> int:
        """Write a parameter that is recorded in the ledger, even without permission of the profile; read it back.

        What is read back, and returned, is its value, or one of `rounded`.

        Raises
        ------
        ConfigurationRefused
            It does not read back as written.
        SdoError
            The transfer failed.
        """
        self._send(step)
        back = self.sdo.read(*step.address, step.data_type, options)
        self._ledger.confirm(self.device, {step.address: back})
        if back != step.value and back not in rounded:
            what = f"{step.value:#x} was written, but {back:#x} is read back"
            self.refuse(step, what, "the drive limits or ignores this value")
        self._configured[step.address] = (step.data_type, back)
        return back

    def changed(self, without: Collection[Address] = ()) -> Iterator[tuple[Address, int, int]]:
        """Read every configured object again and yield those that have changed.

        Parameters
        ----------
        without : collection of (index, subindex)
            Objects that the cyclic exchange writes too.

        Yields
        ------
        (index, subindex), int, int
            Of an object that differs: its value when it was configured, and now.
        """
        for address, (data_type, value) in self._configured.items():
            if address not in without and (now := self.sdo.read(*address, data_type)) != value:
                yield address, value, now

    @property
    def noted(self) -> tuple[LedgerEntry, ...]:
        """Return the ledger entries of this device."""
        return self._ledger.of(self.device)

    def undo(self, old: dict[Address, tuple[str, int]], noted: tuple[LedgerEntry, ...]) -> list[str]:
        """Restore values to those of an earlier moment; the ledger is restored to the same moment.

        Parameters
        ----------
        old : dict
            (index, subindex) -> (type, value at that moment), in the order in which they were written.
        noted : tuple of LedgerEntry
            `noted` of that moment.

        Returns
        -------
        list of str
            Objects that do not hold their old value, or no longer answer: they stay in the ledger.
        """
        with contextlib.suppress(ForeignMaster):
            self._send_back(old)
        self._configured.clear()
        left = {address for address, (data_type, value) in old.items() if self._held(address, data_type) != value}
        self._ledger.exchange(
            [entry for entry in self.noted if entry.address not in left],
            [entry for entry in noted if entry.address not in left],
        )
        return [f"node {self.node_id}:{object_name(*address)}" for address in sorted(left)]

    def _held(self, address: Address, data_type: str) -> int | None:
        """Return the present value of an object; None = it cannot be read."""
        try:
            return self._before(address, data_type)
        except SdoError:
            return None

    def _send_back(self, old: dict[Address, tuple[str, int]]) -> dict[Address, DriveError]:
        """Write values back, entered in the ledger before. Continue after a refusal, stop at a device that does not
        respond.

        Returns
        -------
        dict
            (index, subindex) -> why it was not written.
        """
        steps = restore_steps(old)
        self._ledger.expect(self.device, [(step.address, step.value) for step in steps])
        refused: dict[Address, DriveError] = {}
        for step in steps:
            try:
                self._send(step, SLOW)
            except SdoError as error:
                refused[step.address] = error
                if isinstance(error, SdoTimeout):
                    break
        return refused

    def may_write(self, index: int) -> bool:
        """Return whether the profile allows writing this object."""
        return index in self._allow

    def original(self, entry: Entry, held: int) -> int:
        """Value of an object that holds `held` now, as the engineer left it.

        `held` itself, unless the gateway wrote it in a run: then what the object held before. What `config apply` wrote
        is the engineer's.
        """
        for note in self.noted:
            if note.address == (entry.index, entry.subindex) and note.writer == "run" and note.is_own(held):
                return note.old
        return held

    def is_in_ledger(self, *indices: int) -> bool:
        """Return whether the ledger has an unrestored write to one of these objects of this device."""
        return any(entry.index in indices for entry in self.noted)

    def refuse_unfinished(self) -> None:
        """Refuse a device in which an interrupted `config apply` left part of a configuration.

        Raises
        ------
        ConfigurationRefused
        """
        unfinished = [entry for entry in self.noted if entry.writer == "applying"]
        if unfinished:
            what = f"`config apply` was interrupted while it wrote to this device ({len(unfinished)} objects)"
            advice = "restore the drive with `servo-gateway restore CELL`, or run `config apply` again"
            self.refuse(unfinished[0], what, advice)

    def refuse_renamed(self) -> None:
        """Refuse a device without serial number that holds values of a run over a bus of another name.

        They would count as the originals of a new device.

        Raises
        ------
        ConfigurationRefused
        """
        for entry in self._ledger.of_other_bus(self.device):
            known = any(note.address == entry.address for note in self.noted)
            if not known and self._held(entry.address, entry.data_type) == entry.new != entry.old:
                what = (
                    f"holds {entry.new:#x}, which a run wrote over {entry.bus} to a drive like this (no serial number)"
                )
                advice = "`servo-gateway restore CELL` asks whether it is the same drive, and puts its value back"
                self.refuse(entry, what, advice)

    def take_over(self, entries: Sequence[LedgerEntry]) -> None:
        """Make entries those of this device; a person has said that it is the one they were written to."""
        self._ledger.exchange(entries, [replace(entry, bus=self.device.bus) for entry in entries])

    def adopt_applied(self) -> None:
        """Treat the values written by `config apply` as the original values."""
        self._ledger.forget(*(entry for entry in self.noted if entry.writer == "applied"))

    def finish_applying(self, devices: Sequence[KnownDevice]) -> None:
        """Mark the configuration that `config apply` wrote to these devices as complete."""

        def applied(entry: LedgerEntry) -> LedgerEntry:
            done = entry.writer == "applying" and any(entry.is_of(device) for device in devices)
            return replace(entry, writer="applied") if done else entry

        self._ledger.settle(applied)

    def _send(self, step: Step, options: Transfer = NORMAL) -> None:
        """Write a parameter; if no response arrives, read it back and write it once more if the value differs."""
        self.bus.check_free()
        words = (*step.address, step.data_type, step.value)
        try:
            self.sdo.write(*words, options)
        except SdoTimeout:
            if self.sdo.read(*step.address, step.data_type) != step.value:
                self.sdo.write(*words, options)

    def _entry(self, step: Step, old: int, writer: Writer = "run") -> LedgerEntry:
        return LedgerEntry(
            **asdict(self.device),
            index=step.index,
            subindex=step.subindex,
            data_type=step.data_type,
            old=old,
            new=step.value,
            reason=step.reason,
            writer=writer,
        )

    def _check_allowed(self, entry: Entry | Step) -> None:
        if not self.may_write(entry.index):
            what = f"must not be written: profile {self._profile} does not allow it"
            self.refuse(entry, what, "add it to write.allow if that is safe on this drive")

    def refused(self, entry: Entry | Step | LedgerEntry, what: str, advice: str) -> ConfigurationRefused:
        """Return the error about an object."""
        return ConfigurationRefused(what, node=self.node_id, index=entry.index, subindex=entry.subindex, advice=advice)

    def refuse(self, entry: Entry | Step | LedgerEntry, what: str, advice: str) -> NoReturn:
        """Raise `ConfigurationRefused` about an object."""
        raise self.refused(entry, what, advice)

    def map_pdo(self, plan: PdoPlan) -> None:
        """Write a PDO configuration and read it back; nothing is written if it is already correct.

        Identifier and type may be read-only: what counts is what is read back. Only a write shows whether the type 254
        or 255 of an RPDO is fixed: it is tried at each bring-up. The inhibit time of a TPDO is never written: it has no
        meaning for a synchronous PDO (CiA 301, 7.5.2.37), and many drives refuse to change it while it exists.

        Raises
        ------
        ConfigurationRefused
            It does not read back as written.
        SdoError
            A transfer failed.
        """
        if differences(plan, self.sdo.read, accepts_at_once=False):
            cob_id = self.sdo.read(plan.communication, 1, "u32")
            steps = mapping_steps(plan, cob_id)
            for step in steps:
                self._check_allowed(step)
            self.note_steps(steps)
            for step in steps:
                try:
                    self._send(step)
                except SdoAbort as abort:
                    if abort.code != READ_ONLY or step.index != plan.communication:
                        raise
            written = [entry for entry in self.noted if _record(entry.index) == plan.communication]
            self._ledger.confirm(self.device, self._read_entries(written, {}))
            left = differences(plan, self.sdo.read)
            if left:
                what = f"{plan.name} {', '.join(left)} after it was written"
                advice = "the drive's PDOs may be fixed: see its manual"
                raise ConfigurationRefused(what, node=self.node_id, index=plan.mapping, advice=advice)
        if is_received(plan):
            kind = (plan.communication, 2)
            self._configured[kind] = ("u8", self.sdo.read(*kind, "u8"))

    def _before(self, address: Address, data_type: str) -> int:
        """Return an object's value before a write; 0 for a mapping entry beyond the mapped ones."""
        try:
            return self.sdo.read(*address, data_type)
        except SdoAbort as abort:
            if abort.code in ABSENT and 0x1600 <= address[0] < 0x1C00:
                return 0
            raise

    def restore(self) -> list[DriveError]:
        """Restore the original values of this device; an entry is removed once its original value reads back.

        An object that another tool has written since keeps its value and is removed from the ledger too (`superseded`).

        Returns
        -------
        list of DriveError
            What could not be put back.
        """
        self.superseded = ()
        failures = self._of_predecessors()
        if not self.noted:
            return failures
        if self._busy():
            return [
                *failures,
                DriveFault("is enabled: its objects are not restored", node=self.node_id, advice="disable it first"),
            ]
        send_nmt(self.bus, NmtCommand.ENTER_PREOPERATIONAL, self.node_id)
        moved = [entry for entry in self.noted if entry.node_id != self.node_id and _names_node(entry.index)]
        if moved:
            what = (
                f"{len(moved)} identifiers and PDO mappings were written while this drive was node {moved[0].node_id}"
            )
            advice = "give it that node id to restore them, or delete the entries with `restore CELL --forget`"
            failures.append(self.refused(moved[0], what, advice))
        entries = [entry for entry in self.noted if entry not in moved]
        unread: dict[Address, DriveError] = {}
        held = self._read_entries(entries, unread)
        entries = self._without_superseded(entries, held)
        changed = {_record(entry.index) for entry in entries if held.get(entry.address) != entry.old}
        old = {each.address: (each.data_type, each.old) for each in entries if _record(each.index) in changed}
        refused = self._send_back({address: old[address] for address in old if address not in unread})
        back = self._read_entries(entries, unread)
        length = {address[0]: old for address, (_, old) in old.items() if _is_mapping(address[0]) and not address[1]}
        done = [
            entry
            for entry in entries
            if back.get(entry.address) == entry.old
            or (_is_mapping(entry.index) and entry.subindex > length.get(entry.index, 0xFF) and entry.address in back)
        ]
        self._ledger.forget(*done)
        return failures + [
            unread.get(entry.address)
            or refused.get(entry.address)
            or self.refused(
                entry, f"{entry.old:#x} was restored, but {back[entry.address]:#x} is read back", _NOT_TAKEN
            )
            for entry in entries
            if entry not in done and (entry.address in unread or entry.address in back)
        ]

    def _of_predecessors(self) -> list[DriveError]:
        """Return the error for ledger entries that belong to another device with this node id."""
        others = self._ledger.of_predecessors(self.device)
        if not others:
            return []
        serials = sorted({"none" if each.serial_number is None else str(each.serial_number) for each in others})
        what = (
            f"{len(others)} objects in the write ledger belong to another device"
            f" (serial number {', '.join(serials)}, here is {self.device.serial_number or 'none'})"
        )
        advice = "connect that device to restore it, or delete its entries with `restore CELL --forget`"
        return [IdentityMismatch(what, node=self.node_id, index=0x1018, subindex=4, advice=advice)]

    def _read_entries(self, entries: Sequence[LedgerEntry], unread: dict[Address, DriveError]) -> dict[Address, int]:
        """Return the present values of the entries' objects; those that cannot be read are added to `unread`.

        Raises
        ------
        SdoTimeout
            The device does not answer.
        """
        held: dict[Address, int] = {}
        for entry in entries:
            try:
                held[entry.address] = self._before(entry.address, entry.data_type)
            except SdoTimeout:
                raise
            except SdoError as error:
                unread[entry.address] = error
        return held

    def _without_superseded(self, entries: list[LedgerEntry], held: dict[Address, int]) -> list[LedgerEntry]:
        """Return the entries whose objects hold the original value or one of the gateway's; remove the others from the
        ledger.

        Within the record of a PDO that is restored, a value written by another tool becomes the original.
        """

        def is_others(entry: LedgerEntry) -> bool:
            now = held.get(entry.address)
            return now is not None and now != entry.old and not entry.is_own(now) and not entry.open

        others = [entry for entry in entries if is_others(entry)]
        changed = {_record(each.index) for each in entries if each not in others and held.get(each.address) != each.old}
        kept = {
            each.address: replace(each, old=held[each.address])
            for each in others
            if _is_pdo(each.index) and _record(each.index) in changed
        }
        if others:
            self._ledger.exchange(others, list(kept.values()))
        self.superseded = tuple(others)
        return [kept.get(each.address, each) for each in entries if each not in others or each.address in kept]

    def _busy(self) -> bool:
        """Return whether a restore is not allowed now."""
        return False


def _is_pdo(index: int) -> bool:
    """Return whether an object belongs to a PDO's communication or mapping record."""
    return 0x1400 <= index < 0x1C00


def _is_mapping(index: int) -> bool:
    return _is_pdo(index) and bool(index & 0x0200)


def _record(index: int) -> int:
    """Return the key of objects that are restored together: the records of one PDO, else the single object."""
    return index & ~0x0200 if _is_pdo(index) else index


def _names_node(index: int) -> bool:
    """Return whether an object holds CAN identifiers that depend on the node id."""
    return _is_pdo(index) or index == OBJECTS["emcy_cob_id"].index


class ObjectAccess(NodeAccess):
    """SDO access to one drive.

    Parameters
    ----------
    bus : Bus
    node_id : int
    profile : DriveProfile
        Its allow-list and time-outs.
    ledger : WriteLedger
        Where every write is entered before it happens.
    """

    def __init__(self, bus: Bus, node_id: int, profile: DriveProfile, ledger: WriteLedger) -> None:
        self.profile = profile
        sdo = SdoClient(bus, node_id, profile.sdo.timeout_s, profile.sdo.slow_timeout_s)
        super().__init__(bus, node_id, profile.name, profile.write.allow, ledger, sdo)

    def _busy(self) -> bool:
        return decode_state(self.read(OBJECTS["statusword"])) not in AT_REST
