"""Add files to the store: invalid files do not affect the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from drives.files import replace_file
from gateway.data.table import is_recording
from gateway.errors import GatewayError, InputError
from gateway.fleet.checks import Row, rows_of_recording, rows_of_result
from gateway.fleet.columns import columns, library
from gateway.fleet.store import Store
from gateway.fleet.summaries import SUFFIXES, summary_blocks

#: Recordings, results and blocks of tables that are held before they are written, and rows of tables: files of months
#: are written once for many.
_HELD: Final = 2000
_HELD_OF_TABLES: Final = 100_000


@dataclass(frozen=True, slots=True)
class Ingested:
    """Result of adding files: `added` rows, `known` rows already stored, `refused` messages, `clock` remarks.

    Rows rejected by an unreadable file of the store are not counted; `refused` names that file.
    """

    files: int
    added: int
    known: int
    refused: tuple[str, ...]
    clock: tuple[str, ...]


def ingest(
    store: Store, paths: Iterable[Path], now: datetime, notify: Callable[[str], None] = lambda _: None
) -> Ingested:
    """Add recordings (.h5), results (.json) and summary tables (.csv, .parquet), or folders of them.

    Parameters
    ----------
    store : Store
    paths : iterable of Path
    now : datetime
        In UTC: later times are refused.
    notify : callable
        Called for every file.

    Raises
    ------
    InputError
        The store cannot be written. A file that cannot be used is in `refused` instead.
    """
    files = added = known = 0
    refused: list[str] = []
    faults: dict[str, tuple[int, str]] = {}
    with store.writing():
        held: list[Any] = []

        def put() -> None:
            nonlocal added, known
            table = library("pyarrow").concat_tables(held)
            done = store.add(table)
            added += done.new
            known += table.num_rows - done.new - done.left_out
            refused.extend(done.refused)
            held.clear()

        for path in _files(paths):
            files += 1
            notify(path.name)
            try:
                for block in _blocks(store, path, now):
                    held.append(block)
                    bad = block.num_rows - block["clock"].null_count
                    if bad:
                        before = faults.get(str(path), (0, ""))
                        first = next(said for said in block["clock"].to_pylist() if said)
                        faults[str(path)] = (before[0] + bad, before[1] or first)
            except GatewayError as error:
                refused.append(str(error))
            if len(held) >= _HELD or sum(block.num_rows for block in held) >= _HELD_OF_TABLES:
                put()
        if held:
            put()
    clock = [
        f"{where}: {count} {'check has' if count == 1 else 'checks have'} an implausible time ({why}); stored, but"
        " excluded from trends: set the clock of the robot"
        for where, (count, why) in faults.items()
    ]
    return Ingested(files, added, known, tuple(dict.fromkeys(refused)), tuple(clock))


def _files(paths: Iterable[Path]) -> Iterator[Path]:
    kinds = {".h5", ".hdf5", ".json", *SUFFIXES}
    for path in paths:
        if path.is_dir():
            found = (each for each in sorted(path.rglob("*")) if each.suffix.lower() in kinds and each.is_file())
            yield from (each for each in found if not each.name.startswith("."))
        else:
            yield path


def _blocks(store: Store, path: Path, now: datetime) -> Iterator[Any]:
    if is_recording(path):
        rows = rows_of_recording(path, now)
        if not rows:
            raise InputError(f"{path}: contains no arm: nothing was recorded")
        _keep(store, path, rows[0])
        yield _table(rows)
    elif path.suffix.lower() == ".json":
        yield _table(rows_of_result(path, now))
    elif path.suffix.lower() in SUFFIXES:
        yield from summary_blocks(path, now)
    else:
        raise InputError(f"{path}: not a recording (.h5), result (.json) or table of summaries ({', '.join(SUFFIXES)})")


def _table(rows: list[Row]) -> Any:
    pa = library("pyarrow")
    schema = columns()
    reported = pa.schema([("robot", pa.string()), ("month", pa.string()), *schema])
    return pa.Table.from_pylist(rows, schema=reported)


def _keep(store: Store, path: Path, row: Row) -> None:
    """Copy a recording to the store for repeated estimation."""
    place = store.place_of_recording(row["robot"], row["month"], row["sha256"])
    if place.exists():
        return
    try:
        replace_file(place, path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be copied into the store: {error.strerror or error}") from error
