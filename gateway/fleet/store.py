"""The store of a fleet: Parquet files by robot and month (hive folders), which DuckDB reads as one table.

    STORE/store.json                                      what this folder is
    STORE/checks/robot=R/month=YYYY-MM/checks.parquet     a row per check
    STORE/recordings/robot=R/month=YYYY-MM/SHA256.h5      copies of the recordings, to be estimated again
    STORE/months.parquet                                  a row per robot and month: what a fleet is asked for most
    STORE/analysis/                                       what the last analysis said

Every file is written under a temporary name and renamed. The same row is never held twice.
"""

from __future__ import annotations

import json
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from drives.files import place_file, replace_file, temporary_file
from gateway.data.recording.writer import sole_writer
from gateway.errors import InputError
from gateway.fleet.columns import IDENTITY, SCHEMA, SCHEMA_KEY, TEMPERATURE, columns, library
from gateway.result.fleet import FLEET_KIND, QUANTITIES
from gateway.result.values import check_kind, json_object, text_of

MARK: Final = "store.json"
CHECKS: Final = "checks.parquet"
#: How long another ingest may take to come to its end [s].
PATIENCE_S: Final = 60.0
#: Compression settings: fast to write and read; a month of one robot is small.
_WRITING: Final[dict[str, Any]] = {"compression": "snappy", "use_dictionary": False, "write_statistics": False}


@dataclass(frozen=True, slots=True)
class AddedRows:
    """Number of `new` rows, and number `left_out` of rows for unreadable files, which `refused` lists."""

    new: int
    left_out: int
    refused: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Store:
    """A folder that is a fleet store."""

    path: Path

    @property
    def months(self) -> Path:
        """Path of the file with a row per robot and month."""
        return self.path / "months.parquet"

    @property
    def analysis(self) -> Path:
        """Folder of the last analysis."""
        return self.path / "analysis"

    def robots(self) -> list[str]:
        """Return the robots with at least one check."""
        return sorted(folder.name.partition("=")[2] for folder in (self.path / "checks").glob("robot=*"))

    def files(self, robot: str) -> list[Path]:
        """Return the files of one robot, by month."""
        return sorted((self.path / "checks" / f"robot={robot}").glob(f"month=*/{CHECKS}"))

    def recordings(self) -> Iterator[tuple[str, Path]]:
        """Yield robot and path of every recording."""
        for folder in sorted((self.path / "recordings").glob("robot=*")):
            for file in sorted(folder.glob("month=*/*.h5")):
                yield folder.name.partition("=")[2], file

    def place_of_recording(self, robot: str, month: str, sha256: str) -> Path:
        """Return the path of the copy of a recording."""
        return self.path / "recordings" / f"robot={robot}" / f"month={month}" / f"{sha256}.h5"

    def place(self, robot: str, month: str) -> Path:
        """Return the path of the file of one robot and month."""
        return self.path / "checks" / f"robot={robot}" / f"month={month}" / CHECKS

    def read(self, robot: str) -> Any:
        """Return the rows of one robot, all months, as an Arrow table in time order.

        Raises
        ------
        InputError
            A file that cannot be read, or of another schema.
        """
        parts = [read_file(file) for file in self.files(robot)]
        table = library("pyarrow").concat_tables(parts) if parts else columns().empty_table()
        return table.sort_by("time_utc")

    @contextmanager
    def writing(self) -> Generator[None]:
        """Lock the store for writing.

        Raises
        ------
        InputError
            Another process keeps writing.
        """
        with sole_writer(self.path / "store", PATIENCE_S):
            yield

    def add(self, table: Any) -> AddedRows:
        """Add rows to the files of their robots and months; the caller holds `writing`.

        An unreadable file is left unchanged, and the rows for other files are added.

        Parameters
        ----------
        table : Arrow table with the columns of a file, `robot` and `month`

        Raises
        ------
        InputError
            Nothing can be written; the stored data are unchanged.
        """
        added, left_out, refused, ready, places, parts = 0, 0, [], [], [], []
        for robot, month, rows in _by_place(table):
            place = self.place(robot, month)
            if place.exists():
                try:
                    known = read_file(place)
                except InputError as error:
                    left_out += rows.num_rows
                    refused.append(str(error))
                    continue
                held = set(zip(*(known[name].to_pylist() for name in IDENTITY), strict=True))
                new = [key not in held for key in zip(*(rows[name].to_pylist() for name in IDENTITY), strict=True)]
                rows = rows if all(new) else rows.filter(library("pyarrow").array(new))
                if not rows.num_rows:
                    continue
                merged = library("pyarrow").concat_tables([known, rows]).sort_by("time_utc")
            else:
                merged = rows
            added += rows.num_rows
            ready.append((_unreadable_copy(place, merged), place))
            places.append((robot, month))
            parts.append(merged)
        if ready:
            for rejected, place in ready:
                place_file(rejected, place)
            with_months(self.months, months_of(places, parts))
        return AddedRows(added, left_out, tuple(refused))


def read_file(path: Path) -> Any:
    """Return the rows of one file.

    Raises
    ------
    InputError
        It cannot be read, or its columns are of another version.
    """
    pa, parquet = library("pyarrow"), library("pyarrow.parquet")
    try:
        # Not memory mapped: the file may be replaced meanwhile.
        with path.open("rb") as stream:
            table = parquet.read_table(stream, use_threads=False, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        words = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: cannot be read as Parquet ({words}); remove it from the store and ingest its sources again"
        ) from error
    said = (table.schema.metadata or {}).get(SCHEMA_KEY)
    if said != str(SCHEMA).encode() or table.schema.names != columns().names:
        reported = "none" if said is None else said.decode(errors="replace")
        raise InputError(
            f"{path}: is of schema {reported}, this version reads and writes schema {SCHEMA}: take it out of the store"
            " and ingest its sources again, or use the version that wrote it"
        )
    return table.cast(columns())


def open_store(path: Path) -> Store:
    """Return the store in a folder.

    Raises
    ------
    InputError
        It is not a store, or has another schema.
    """
    mark = path / MARK
    if not mark.is_file():
        raise InputError(f"{path}: not a fleet store; create one with servo-gateway fleet ingest {path} FILE...")
    data = json_object(text_of(mark, "ingest into another folder"), str(mark))
    check_kind(data, SCHEMA, str(mark), FLEET_KIND)
    return Store(path)


def open_or_make(path: Path) -> Store:
    """Return the store in a folder; create it if the folder is empty or missing.

    Raises
    ------
    InputError
        The folder contains other files.
    """
    if (path / MARK).is_file():
        return open_store(path)
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise InputError(f"{path}: not a fleet store, and not empty; name a new folder")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    replace_file(path / MARK, json.dumps({"kind": FLEET_KIND, "schema": SCHEMA}) + "\n")
    return Store(path)


def _by_place(table: Any) -> Iterator[tuple[str, str, Any]]:
    """Yield robot, month and their rows."""
    table = table.sort_by([("robot", "ascending"), ("month", "ascending"), ("time_utc", "ascending")]).combine_chunks()
    robots, months = table["robot"].to_pylist(), table["month"].to_pylist()
    rows = table.select(columns().names).cast(columns())
    first = 0
    for row in range(1, len(robots) + 1):
        if row == len(robots) or robots[row] != robots[first] or months[row] != months[first]:
            yield robots[first], months[first], rows.slice(first, row - first)
            first = row


def _unreadable_copy(place: Path, table: Any) -> Path:
    def write(descriptor: int) -> None:
        with os.fdopen(os.dup(descriptor), "wb") as stream:
            library("pyarrow.parquet").write_table(table, stream, **_WRITING)

    try:
        return temporary_file(place, write)
    except OSError as error:
        raise InputError(f"{place}: cannot be written: {error.strerror or error}") from error


#: What a month keeps the mean of, per axis.
MEANS: Final = (*(each.key for each in QUANTITIES), TEMPERATURE)


def month_columns() -> Any:
    """Return the Arrow schema of the monthly summary."""
    pa = library("pyarrow")
    reported = [
        ("robot", pa.string()),
        ("month", pa.string()),
        ("cell", pa.string()),
        ("arm", pa.string()),
        ("serial_numbers", pa.list_(pa.int64())),
        ("checks", pa.int64()),
        ("first_utc", pa.timestamp("us")),
        ("last_utc", pa.timestamp("us")),
        ("clock_faults", pa.int64()),
        *((name, pa.list_(pa.float64())) for name in MEANS),
    ]
    return pa.schema(reported, metadata={SCHEMA_KEY: str(SCHEMA).encode()})


def months_of(places: Sequence[tuple[str, str]], parts: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the summary rows of robots and months.

    Parameters
    ----------
    places : sequence of (robot, month)
    parts : sequence of Arrow tables
        The checks of each, at least one, sorted by time.
    """
    rows = library("pyarrow").concat_tables(parts)
    starts = np.concatenate([[0], np.cumsum([part.num_rows for part in parts])])
    first, last = starts[:-1].tolist(), (starts[1:] - 1).tolist()
    means = {name: _means(rows[name], starts) for name in MEANS}
    plain = rows.select(["cell", "arm", "serial_numbers", "time_utc"])
    begin, end = plain.take(first).to_pylist(), plain.take(last).to_pylist()
    faults = np.add.reduceat(np.asarray(rows["clock"].is_valid(), dtype=int), first)
    return [
        {
            "robot": robot,
            "month": month,
            "cell": begin[index]["cell"],
            "arm": begin[index]["arm"],
            "serial_numbers": begin[index]["serial_numbers"],
            "checks": last[index] + 1 - first[index],
            "first_utc": begin[index]["time_utc"],
            "last_utc": end[index]["time_utc"],
            "clock_faults": int(faults[index]),
            **{name: reported[index] for name, reported in means.items()},
        }
        for index, (robot, month) in enumerate(places)
    ]


def by_axis(column: Any) -> np.ndarray:
    """Return a column of lists as numbers (n, N), NaN where missing; shorter rows are filled with NaN."""
    flat = column.combine_chunks()
    lengths = np.diff(flat.offsets.to_numpy()) if len(flat) else np.zeros(0, dtype=int)
    lengths = np.where(np.asarray(flat.is_valid()), lengths, 0)
    most = int(lengths.max(initial=0))
    values = flat.flatten().to_numpy(zero_copy_only=False).astype(float)
    if (lengths == most).all():
        return values.reshape(len(lengths), most)
    out = np.full((len(lengths), most), np.nan)
    out[np.arange(most) < lengths[:, None]] = values
    return out


def _means(column: Any, starts: np.ndarray) -> list[list[float | None]]:
    """Return the means per axis of the rows from each start to the next; null for axes without measurement."""
    values = by_axis(column)
    if not values.shape[1]:
        return [[] for _ in starts[1:]]
    known = np.isfinite(values)
    count = np.add.reduceat(known, starts[:-1], axis=0, dtype=int)
    mean = np.add.reduceat(np.where(known, values, 0.0), starts[:-1], axis=0) / np.maximum(count, 1)
    return [
        [value if n else None for value, n in zip(row, reported, strict=True)]
        for row, reported in zip(mean.tolist(), count.tolist(), strict=True)
    ]


def with_months(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Return the summary with the rows of the same robot and month replaced.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    if not rows:
        return
    pa, parquet = library("pyarrow"), library("pyarrow.parquet")
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=month_columns())
    if path.exists():
        with path.open("rb") as stream:
            before = parquet.read_table(stream, use_threads=False, partitioning=None)
        new = {(row["robot"], row["month"]) for row in rows}
        keys = zip(before["robot"].to_pylist(), before["month"].to_pylist(), strict=True)
        table = pa.concat_tables([before.filter(pa.array([key not in new for key in keys])), table])
    sink = pa.BufferOutputStream()
    parquet.write_table(table.sort_by([("robot", "ascending"), ("month", "ascending")]), sink)
    replace_file(path, sink.getvalue().to_pybytes())
