"""Monthly summary: one row per robot and month with number and times of checks, and means."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from drives.files import replace_file
from gateway.fleet.columns import SCHEMA, SCHEMA_KEY, TEMPERATURE
from gateway.fleet.libraries import library
from gateway.result.fleet import QUANTITIES

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
