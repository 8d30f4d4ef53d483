"""Write ledger: every object that was written, what it held before, and why, on disk so that a crash can be undone.

An entry is on disk before its object is written. The first old value of an object stays: a restore puts it back.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from drives.errors import ConfigurationRefused
from drives.files import replace_file
from drives.objects import STRUCT_CODE, object_name

SCHEMA = 1


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
        What it held before the first write, and what was written last.
    reason : str
        Why it was written.
    serial_number : int or None
        Of the device, so that a restore does not write to its successor.
    """

    node_id: int
    index: int
    subindex: int
    data_type: str
    old: int
    new: int
    reason: str
    serial_number: int | None = None

    def __str__(self) -> str:
        where = f"node {self.node_id}:{object_name(self.index, self.subindex)}"
        return f"{where}: {self.old:#x} -> {self.new:#x} ({self.reason})"


class WriteLedger:
    """Entries in the order of their first write.

    Parameters
    ----------
    path : Path, optional
        JSON file, rewritten whole at each entry; what an earlier run left in it is taken over.

    Raises
    ------
    ConfigurationRefused
        The file exists and is no ledger.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._entries: dict[tuple[int, int, int], LedgerEntry] = {}
        if path is not None and path.exists():
            self._entries = {(entry.node_id, entry.index, entry.subindex): entry for entry in _load(path)}

    @property
    def entries(self) -> tuple[LedgerEntry, ...]:
        """All entries."""
        return tuple(self._entries.values())

    def of_node(self, node_id: int) -> tuple[LedgerEntry, ...]:
        """Entries of one node."""
        return tuple(entry for entry in self._entries.values() if entry.node_id == node_id)

    def note(self, *entries: LedgerEntry) -> None:
        """Enter writes that are about to happen; the old value of an object that is already here stays."""
        for entry in entries:
            key = (entry.node_id, entry.index, entry.subindex)
            known = self._entries.get(key)
            self._entries[key] = entry if known is None else replace(known, new=entry.new, reason=entry.reason)
        self._save()

    def forget(self, *entries: LedgerEntry) -> None:
        """Take out entries whose old value is back."""
        for entry in entries:
            self._entries.pop((entry.node_id, entry.index, entry.subindex), None)
        self._save()

    def _save(self) -> None:
        if self.path is None:
            return
        document = {"schema": SCHEMA, "entries": [asdict(entry) for entry in self._entries.values()]}
        try:
            replace_file(self.path, json.dumps(document, indent=1))
        except OSError as error:
            raise ConfigurationRefused(
                f"write ledger {self.path} cannot be written: {error}",
                advice="nothing is written to a drive without it; free some space or choose another folder",
            ) from error


def _load(path: Path) -> list[LedgerEntry]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise ValueError(f"schema {SCHEMA} expected")
        return [_entry(item) for item in document["entries"]]
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        advice = "move the file away if the drives need no restore"
        raise ConfigurationRefused(f"{path} is no write ledger: {error}", advice=advice) from error


def _entry(item: Any) -> LedgerEntry:
    entry = LedgerEntry(**item)
    numbers: tuple[Any, ...] = (entry.node_id, entry.index, entry.subindex, entry.old, entry.new)
    if not all(isinstance(number, int) for number in numbers) or entry.data_type not in STRUCT_CODE:
        raise ValueError(f"entry {item} is damaged")
    return entry
