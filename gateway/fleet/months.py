"""A row per robot and month: how often and when it was seen, and its means. Fleets are asked for this most often."""

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
    """The schema of the file."""
    pa = library("pyarrow")
    told = [
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
    return pa.schema(told, metadata={SCHEMA_KEY: str(SCHEMA).encode()})


def months_of(robot: str, month: str, rows: Any) -> dict[str, Any]:
    """The row of one robot and month, whose checks are sorted by time."""
    count = rows.num_rows
    out: dict[str, Any] = {
        "robot": robot,
        "month": month,
        "cell": rows["cell"][0].as_py(),
        "arm": rows["arm"][0].as_py(),
        "serial_numbers": rows["serial_numbers"][0].as_py(),
        "checks": count,
        "first_utc": rows["time_utc"][0],
        "last_utc": rows["time_utc"][count - 1],
        "clock_faults": count - rows["clock"].null_count,
    }
    return out | {name: _mean(rows[name]) for name in MEANS}


def by_axis(column: Any) -> np.ndarray:
    """Numbers (n, N) of a column of lists, NaN where there is none; rows of fewer axes are filled with NaN."""
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


def _mean(column: Any) -> list[float | None]:
    values = by_axis(column)
    count = np.isfinite(values).sum(axis=0)
    total = np.nansum(values, axis=0)
    return [float(part) / int(n) if n else None for part, n in zip(total, count, strict=True)]


def with_months(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Put rows in the place of those of the same robot and month.

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
