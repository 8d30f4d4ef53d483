"""What the reader makes of a mutated sheet, against the table that the sheet was written from."""

from __future__ import annotations

import time
from pathlib import Path

from benchmarks.chaos.mutated_sheets import NODE_ID, OBJECTS, TEXT, Address, Mutated, Stated
from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet, SheetObject
from drives.errors import ProfileError


def judged(sheet: Mutated, folder: Path) -> tuple[list[str], float]:
    """Objects that are read otherwise than stated without being named, in words, and the seconds that reading took.

    Raises
    ------
    Exception
        Anything but `ProfileError` that the reader raises.
    """
    path = folder / f"{sheet.seed}.dcf"
    path.write_bytes(sheet.content)
    start = time.perf_counter()
    try:
        found = read_sheet(path)
    except ProfileError as error:
        return [f"refused as a whole: {error}"], time.perf_counter() - start
    duration_s = time.perf_counter() - start
    unreported = [
        f"{address[0]:04X}:{address[1]:02X} {_why(address, found)}"
        for address in sorted(OBJECTS.keys() | found.entries.keys())
        if _why(address, found) and not _is_named(address[0], found, sheet.damaged_lines)
    ]
    if found.node_id != NODE_ID:
        unreported.append(f"node id {found.node_id}")
    return unreported, duration_s


def _is_named(index: int, found: Sheet, damaged: frozenset[int]) -> bool:
    return any(remark.line in damaged for remark in found.remarks) or bool(found.remarks_of(index))


def _why(address: Address, found: Sheet) -> str:
    stated, entry = OBJECTS.get(address), found.entries.get(address)
    if stated is None or entry is None:
        return "is not in the sheet" if stated is None else "is left out"
    here = _of_entry(entry)
    wanted = _of_table(stated)
    return ", ".join(f"{key} {here[key]!r} instead of {wanted[key]!r}" for key in wanted if here[key] != wanted[key])


def _of_entry(entry: SheetObject) -> dict[str, object]:
    return {
        "type": entry.data_type,
        "access": entry.access_type,
        "mappable": int(entry.pdo_mappable),
        "default": entry.read(entry.default, NODE_ID),
        "low": entry.read(entry.low, NODE_ID),
        "high": entry.read(entry.high, NODE_ID),
        "value": entry.read(entry.value, NODE_ID) if _is_readable(entry) else entry.value,
    }


def _is_readable(entry: SheetObject) -> bool:
    try:
        entry.read(entry.value, NODE_ID)
    except ValueError:
        return False
    return True


def _of_table(stated: Stated) -> dict[str, object]:
    def number(text: int | str) -> int | str | None:
        if isinstance(text, int) or stated.kind == TEXT:
            return text or None if text == "" else text
        return int(text.removeprefix("$NODEID+"), 0) + NODE_ID if text else None

    return {
        "type": stated.kind,
        "access": stated.access,
        "mappable": stated.mappable,
        "default": number(stated.default),
        "low": number(stated.low),
        "high": number(stated.high),
        "value": number(stated.value),
    }
