"""Objects of one node: read, write under an allow-list with a ledger entry before and a read-back after."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NoReturn

from drives.abort import ABSENT
from drives.bus import Bus
from drives.cia402 import AT_REST, decode_state
from drives.errors import ConfigurationRefused, DriveError, DriveFault, IdentityMismatch, SdoAbort, SdoTimeout
from drives.heartbeat import NmtCommand, send_nmt
from drives.ledger import LedgerEntry, WriteLedger
from drives.objects import OBJECTS, ObjectEntry, object_name
from drives.pdo import PdoPlan, Step, differences, mapping_steps, restore_steps
from drives.profile import DriveProfile, ObjectReference
from drives.sdo import NORMAL, SLOW, SdoClient, Transfer

Entry = ObjectEntry | ObjectReference


@dataclass(frozen=True, slots=True)
class AccessRules:
    """What may be written to a node, by the profile of this name, and how long its answers may take."""

    name: str
    allow: Collection[int]
    timeout_s: float = 0.3
    slow_timeout_s: float = 2.0


class NodeAccess:
    """SDO access to one node.

    Parameters
    ----------
    bus : Bus
    node_id : int
    rules : AccessRules
    ledger : WriteLedger
        Where every write is entered before it happens.
    """

    def __init__(self, bus: Bus, node_id: int, rules: AccessRules, ledger: WriteLedger) -> None:
        self.node_id = node_id
        self.rules = rules
        self.bus = bus
        self.sdo = SdoClient(bus, node_id, rules.timeout_s, rules.slow_timeout_s)
        #: Serial number of the device, entered in the ledger.
        self.serial_number: int | None = None
        self._ledger = ledger

    def read(self, entry: Entry, options: Transfer = NORMAL) -> int:
        """Read an object."""
        return self.sdo.read(entry.index, entry.subindex, entry.type, options)

    def read_optional(self, entry: Entry) -> int | None:
        """Read an object that the drive may not have; None = it does not."""
        try:
            return self.read(entry)
        except SdoAbort as abort:
            if abort.code in ABSENT:
                return None
            raise

    def write(self, entry: Entry, value: int, reason: str, options: Transfer = NORMAL) -> None:
        """Write an object and read it back; nothing is written if it holds the value already.

        Raises
        ------
        ConfigurationRefused
            The profile does not allow it, or it does not read back as written.
        SdoError
            The transfer failed.
        """
        self._check_allowed(entry.index, entry.subindex)
        now = self.read(entry, options)
        if now == value:
            return
        step = Step(entry.index, entry.subindex, entry.type, value, reason)
        self._ledger.note(self._entry(step, now))
        self._send(step)
        back = self.read(entry, options)
        if back != value:
            what = f"{value:#x} was written, {back:#x} reads back"
            self.refuse(entry, what, "the drive limits or ignores this value")

    def write_step(self, step: Step, old: dict[tuple[int, int], tuple[str, int]]) -> None:
        """Write a parameter that a person has asked for, whatever the profile allows: entered before, read back after.

        Parameters
        ----------
        step : Step
        old : dict
            (index, subindex) -> (type, value): what the object held is added before it is written first.

        Raises
        ------
        ConfigurationRefused
            It does not read back as written.
        SdoError
            The transfer failed.
        """
        now = self._before(step)
        old.setdefault((step.index, step.subindex), (step.data_type, now))
        self._ledger.note(self._entry(step, now))
        self._send(step)
        back = self.sdo.read(step.index, step.subindex, step.data_type)
        if back != step.value:
            raise ConfigurationRefused(
                f"{step.value:#x} was written, {back:#x} reads back",
                node=self.node_id,
                index=step.index,
                subindex=step.subindex,
                advice="the drive limits or ignores this value",
            )

    @property
    def noted(self) -> tuple[LedgerEntry, ...]:
        """What the ledger holds of this node."""
        return self._ledger.of_node(self.node_id)

    def undo(self, old: dict[tuple[int, int], tuple[str, int]], noted: tuple[LedgerEntry, ...]) -> list[str]:
        """Put back what was written since a moment; the ledger is then as it was at that moment.

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
        for step in restore_steps(old):
            try:
                self.sdo.write(step.index, step.subindex, step.data_type, step.value, SLOW)
            except SdoTimeout:
                break
            except DriveError:
                continue
        left = self._not_as(old)
        back = [entry for entry in self.noted if (entry.index, entry.subindex) in old.keys() - left]
        self._ledger.forget(*back)
        self._ledger.note(*(entry for entry in noted if (entry.index, entry.subindex) in old.keys() - left))
        return [f"node {self.node_id}:{object_name(*address)}" for address in sorted(left)]

    def _not_as(self, old: dict[tuple[int, int], tuple[str, int]]) -> set[tuple[int, int]]:
        left = set(old)
        for address, (data_type, value) in old.items():
            try:
                now = self._before(Step(*address, data_type, value, ""))
            except SdoTimeout:
                break
            except DriveError:
                continue
            if now == value:
                left.discard(address)
        return left

    def may_write(self, index: int) -> bool:
        """Whether the profile allows writing this object."""
        return index in self.rules.allow

    def original(self, entry: Entry) -> int | None:
        """What an object held before it was written first; None = it was not written, or has been put back."""
        address = (entry.index, entry.subindex)
        found = (note.old for note in self._ledger.of_node(self.node_id) if (note.index, note.subindex) == address)
        return next(found, None)

    def write_if_taken(self, entry: Entry, value: int, reason: str) -> bool:
        """As `write`, where the drive may refuse it for good; whether it took the value."""
        known = self.original(entry)
        try:
            self.write(entry, value, reason)
        except SdoAbort:
            if known is None:
                address = (entry.index, entry.subindex)
                notes = self._ledger.of_node(self.node_id)
                self._ledger.forget(*(note for note in notes if (note.index, note.subindex) == address))
            return False
        return True

    def is_in_ledger(self, *indices: int) -> bool:
        """Whether the ledger holds a write to one of these objects of this node that was not put back."""
        return any(entry.index in indices for entry in self._ledger.of_node(self.node_id))

    def _send(self, step: Step) -> None:
        """Write a parameter; where the answer stays away it is read back, and written once more if it is not there."""
        words = (step.index, step.subindex, step.data_type, step.value)
        try:
            self.sdo.write(*words)
        except SdoTimeout:
            if self.sdo.read(step.index, step.subindex, step.data_type) != step.value:
                self.sdo.write(*words)

    def _entry(self, step: Step, old: int) -> LedgerEntry:
        address = (step.index, step.subindex)
        return LedgerEntry(self.node_id, *address, step.data_type, old, step.value, step.reason, self.serial_number)

    def _check_allowed(self, index: int, subindex: int) -> None:
        if not self.may_write(index):
            raise ConfigurationRefused(
                f"must not be written: profile {self.rules.name} does not allow it",
                node=self.node_id,
                index=index,
                subindex=subindex,
                advice="add it to write.allow if that is safe on this drive",
            )

    def refuse(self, entry: Entry, what: str, advice: str) -> NoReturn:
        """Raise `ConfigurationRefused` about an object."""
        raise ConfigurationRefused(what, node=self.node_id, index=entry.index, subindex=entry.subindex, advice=advice)

    def map_pdo(self, plan: PdoPlan) -> None:
        """Write a PDO and read it back; one that is right already is left alone.

        Its inhibit time is never written: it has no meaning for a synchronous PDO (CiA 301, 7.5.2.37), and many drives
        refuse to change it while the PDO exists.

        Raises
        ------
        ConfigurationRefused
            It does not read back as written.
        SdoError
            A transfer failed.
        """
        if differences(plan, self.sdo.read):
            cob_id = self.sdo.read(plan.communication, 1, "u32")
            steps = mapping_steps(plan, cob_id)
            for step in steps:
                self._check_allowed(step.index, step.subindex)
            self._ledger.note(*(self._entry(step, self._before(step)) for step in steps))
            for step in steps:
                self._send(step)
            left = differences(plan, self.sdo.read)
            if left:
                what = f"{plan.name} {', '.join(left)} after it was written"
                advice = "the drive's PDOs may be fixed: see its manual"
                raise ConfigurationRefused(what, node=self.node_id, index=plan.mapping, advice=advice)

    def _before(self, step: Step) -> int:
        """What an object holds before it is written; a mapping entry beyond the mapped ones may not exist yet."""
        try:
            return self.sdo.read(step.index, step.subindex, step.data_type)
        except SdoAbort as abort:
            if abort.code in ABSENT and 0x1600 <= step.index < 0x1C00:
                return 0
            raise

    def restore(self) -> list[DriveError]:
        """Put back what the ledger holds of this node; what fails stays in the ledger.

        Returns
        -------
        list of DriveError
            What could not be put back.
        """
        entries = self._ledger.of_node(self.node_id)
        if not entries:
            return []
        if any(entry.serial_number not in (None, self.serial_number) for entry in entries):
            what = f"serial number {self.serial_number} is not that of the drive in the write ledger"
            return [IdentityMismatch(what, node=self.node_id, index=0x1018, subindex=4, advice="check by hand")]
        if self._busy():
            return [DriveFault("is enabled", node=self.node_id, advice="disable it before restoring")]
        send_nmt(self.bus, NmtCommand.ENTER_PREOPERATIONAL, self.node_id)
        failures = self._put_back({(entry.index, entry.subindex): (entry.data_type, entry.old) for entry in entries})
        failed = {(failure.index, failure.subindex) for failure in failures}
        self._ledger.forget(*(entry for entry in entries if (entry.index, entry.subindex) not in failed))
        return failures

    def _busy(self) -> bool:
        """Whether nothing may be put back now."""
        return False

    def _put_back(self, old: dict[tuple[int, int], tuple[str, int]]) -> list[DriveError]:
        failures: list[DriveError] = []
        for step in restore_steps(old):
            try:
                self.sdo.write(step.index, step.subindex, step.data_type, step.value, SLOW)
            except DriveError as error:
                failures.append(error)
        return failures


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
        rules = AccessRules(profile.name, profile.write.allow, profile.sdo.timeout_s, profile.sdo.slow_timeout_s)
        super().__init__(bus, node_id, rules, ledger)

    def _busy(self) -> bool:
        return decode_state(self.read(OBJECTS["statusword"])) not in AT_REST
