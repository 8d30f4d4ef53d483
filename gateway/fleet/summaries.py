"""Tables of summaries, CSV or Parquet: a row per check, a column per axis and quantity, read in blocks.

Needed: `cell`, `time_utc`. Not needed: `arm` (`main`), `software`, `serial1` .., the quantities (`gain1`, `gain1_std`,
`friction_band1_nm`, `friction_band1_std_nm`, ..), `temp1_c` .., `load` with `mass_kg`, `mass_std_kg`, `com_x_m` ..,
`outcome`. Rows of one robot are in the order of measurement.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.data.regular_file import regular_size
from gateway.errors import InputError
from gateway.fleet.checks import AHEAD_S, EARLIEST
from gateway.fleet.columns import SUMMARY, TEMPERATURE, columns, library, robot_name
from gateway.result.fleet import QUANTITIES
from gateway.result.origin import file_sha256

SUFFIXES: Final = (".csv", ".parquet")
#: Text that is read at a time [bytes]: memory does not grow with the table.
_BLOCK: Final = 1 << 23
_ROWS: Final = 50_000
#: Texts of a table (names of cells, loads, programs) and its header are no longer than that [bytes].
_LONGEST_TEXT: Final = 200
_LONGEST_HEADER: Final = 1 << 16
#: Size of the columns of a Parquet file, unpacked, as a multiple of the file.
_UNPACKED_RATIO: Final = 100
_TEXTS: Final = ("cell", "arm", "software", "load", "outcome", "time_utc")
_OUTCOMES: Final = ("pass", "fail", "cannot tell")
WENT_BACK: Final = "the clock was set back: an earlier row of the same robot has a later time"


def summary_blocks(path: Path, now: datetime) -> Iterator[Any]:
    """Yield the rows of a table of summaries in blocks, as rows of the store with `robot` and `month`.

    Raises
    ------
    InputError
        With file and column or line: not readable, an unknown or a missing column, no number, no time.
    """
    pa = library("pyarrow")
    size_bytes = regular_size(path)
    sha256 = file_sha256(path)
    seen: dict[str, int] = {}
    line = 2
    try:
        with path.open("rb") as stream:
            axes, blocks = (_parquet if path.suffix.lower() == ".parquet" else _csv)(path, stream, size_bytes)
            for block in blocks:
                if block.num_rows:
                    yield _rows(block, axes, (str(path), path.name, sha256, line), (now, seen))
                line += block.num_rows
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (pa.ArrowException, ValueError, TypeError, KeyError, OverflowError) as error:
        words = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: cannot be read as a table of summaries: {words}") from error


def _parquet(path: Path, stream: IO[bytes], size_bytes: int) -> tuple[int, Iterator[Any]]:
    """Return the number of axes, and an iterator over blocks of rows; texts stay dictionary-encoded until checked."""
    pa, parquet = library("pyarrow"), library("pyarrow.parquet")
    axes, wanted = _axes(parquet.ParquetFile(stream).schema_arrow.names, str(path))
    file = parquet.ParquetFile(stream, read_dictionary=[name for name in wanted if name in _TEXTS])
    for field in file.schema_arrow:
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        if field.name in wanted and (pa.types.is_nested(kind) or pa.types.is_binary(kind)):
            raise InputError(f"{path}: column '{field.name}' holds {kind}; write numbers, texts and times")
    about = file.metadata
    unpacked = sum(about.row_group(group).total_byte_size for group in range(about.num_row_groups))
    if about.num_rows > size_bytes or unpacked > _UNPACKED_RATIO * size_bytes + _BLOCK:
        raise InputError(
            f"{path}: {size_bytes} bytes claim {about.num_rows} rows and {unpacked / 1e6:.0f} MB: implausible"
            " compression for a table of summaries; write it again"
        )
    return axes, (_plain(path, batch) for batch in file.iter_batches(_ROWS, columns=wanted, use_threads=False))


def _plain(path: Path, batch: Any) -> Any:
    """Return a block with its dictionaries decoded."""
    pa, pc = library("pyarrow"), library("pyarrow.compute")
    columns = []
    for name, column in zip(batch.schema.names, batch.columns, strict=True):
        if pa.types.is_dictionary(column.type):
            if (pc.max(pc.binary_length(column.dictionary)).as_py() or 0) > _LONGEST_TEXT:
                raise InputError(f"{path}: column '{name}' holds a text of more than {_LONGEST_TEXT} bytes")
            column = column.cast(pa.string())
        columns.append(column)
    return pa.Table.from_arrays(columns, names=batch.schema.names)


def _csv(path: Path, stream: IO[bytes], size_bytes: int) -> tuple[int, Iterator[Any]]:
    """Return the number of axes, and an iterator over blocks of rows."""
    del size_bytes
    pa, csv = library("pyarrow"), library("pyarrow.csv")
    names = stream.readline(_LONGEST_HEADER).decode("utf-8").strip().split(",")
    stream.seek(0)
    axes, wanted = _axes(names, str(path))
    kinds = {name: pa.string() if name in _TEXTS else pa.float64() for name in wanted}
    kinds |= {name: pa.int64() for name in wanted if name.startswith("serial")}
    reader = csv.open_csv(
        stream,
        read_options=csv.ReadOptions(block_size=_BLOCK, use_threads=False),
        convert_options=csv.ConvertOptions(column_types=kinds, strings_can_be_null=True, include_columns=wanted),
    )
    return axes, (pa.Table.from_batches([batch]) for batch in reader)


def _axes(names: Sequence[str], where: str) -> tuple[int, list[str]]:
    """Return the number of axes and the columns to read; raise an error for an unknown column."""
    if len(set(names)) != len(names):
        raise InputError(f"{where}:1: a column occurs twice")
    for needed in ("cell", "time_utc"):
        if needed not in names:
            raise InputError(f"{where}:1: column '{needed}' is missing; a table of summaries needs it")
    axes = max((int(found[1]) for name in names if (found := re.match(r"[a-z_]+?(\d+)(_|$)", name))), default=0)
    if not FEWEST_AXES <= axes <= MOST_AXES:
        raise InputError(f"{where}:1: columns of {axes} axes; {FEWEST_AXES} to {MOST_AXES} are handled")
    known = {*_TEXTS, "mass_kg", "mass_std_kg", *(f"com_{axis}{std}_m" for axis in "xyz" for std in ("", "_std"))}
    for joint in range(1, axes + 1):
        known |= {f"serial{joint}", f"temp{joint}_c"}
        known |= {name for each in QUANTITIES for name in each.flat(joint)}
    unknown = [name for name in names if name not in known and not name.startswith("x_")]
    if unknown:
        raise InputError(f"{where}:1: column '{unknown[0]}' is not known; a column of your own begins with x_")
    return axes, [name for name in names if name in known]


def _rows(block: Any, axes: int, source: tuple[str, str, str, int], clock: tuple[datetime, dict[str, int]]) -> Any:
    pa = library("pyarrow")
    where, name, sha256, first_line = source
    count = block.num_rows
    times = _times(block["time_utc"], where, first_line)
    which, robots = _robots(block, axes, where, first_line)
    keys = pa.array([robot.key for robot in robots]).take(which)
    reported: dict[str, Any] = {
        "robot": keys,
        "month": pa.array(np.datetime_as_string(times, unit="M")),
        "time_utc": pa.array(times),
        "duration_s": pa.nulls(count, pa.float64()),
        "cell": pa.array([robot.cell for robot in robots]).take(which),
        "arm": pa.array([robot.arm for robot in robots]).take(which),
        "serial_numbers": pa.array([list(robot.serial_numbers) for robot in robots], pa.list_(pa.int64())).take(which),
        "kind": _always(SUMMARY, count),
        "source": _always(name, count),
        "sha256": _always(sha256, count),
        "line": pa.array(np.arange(first_line, first_line + count)),
        "recordings": _empty(count, pa.string()),
        "software": _text(block, "software", ""),
        "clock": _clock(times, which.to_numpy(), [robot.key for robot in robots], clock),
        "loads": _loads(block, where, first_line),
        "failing": _empty(count, pa.string()),
    }
    for each in QUANTITIES:
        flat = [each.flat(joint) for joint in range(1, axes + 1)]
        reported[each.key] = _lists(block, [value for value, _ in flat])
        reported[each.std_key] = _lists(block, [std for _, std in flat])
    reported[TEMPERATURE] = _lists(block, [f"temp{joint}_c" for joint in range(1, axes + 1)])
    schema = columns()
    return pa.table(reported).select(["robot", "month", *schema.names])


def _always(text: str, count: int) -> Any:
    pa = library("pyarrow")
    return pa.repeat(pa.scalar(text), count)


def _empty(count: int, kind: Any) -> Any:
    pa = library("pyarrow")
    return pa.ListArray.from_arrays(pa.array(np.zeros(count + 1, dtype=np.int32)), pa.array([], kind))


def _text(block: Any, name: str, default: str) -> Any:
    if name not in block.schema.names:
        return _always(default, block.num_rows)
    return library("pyarrow.compute").fill_null(block[name].combine_chunks(), default)


def _number(block: Any, name: str) -> np.ndarray:
    """Return a column of finite numbers (n,), NaN where it is empty or absent."""
    if name not in block.schema.names:
        return np.full(block.num_rows, np.nan)
    values = block[name].combine_chunks().to_numpy(zero_copy_only=False).astype(float)
    return np.where(np.isfinite(values), values, np.nan)


def _lists(block: Any, names: Sequence[str]) -> Any:
    """Return a list per row from several columns, null where all are absent."""
    pa = library("pyarrow")
    count = block.num_rows
    if not any(name in block.schema.names for name in names):
        return pa.nulls(count, pa.list_(pa.float64()))
    values = np.stack([_number(block, name) for name in names], axis=1)
    offsets = np.arange(0, values.size + 1, len(names), dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), from_pandas=True))


def _times(column: Any, where: str, first_line: int) -> np.ndarray:
    """Return the times (n,) in UTC [us]."""
    pa, pc = library("pyarrow"), library("pyarrow.compute")
    column = column.combine_chunks()
    if column.null_count:
        row = int(np.argmax(np.asarray(column.is_null())))
        raise InputError(f"{where}:{first_line + row}: time_utc is empty")
    if pa.types.is_string(column.type):
        plain = pc.replace_substring_regex(column, r"(Z|\+00:?00| UTC)$", "")
        try:
            column = pc.cast(plain, pa.timestamp("us"))
        except pa.ArrowInvalid as error:
            words = " ".join(str(error).split())[:120]
            raise InputError(f"{where}: time_utc: write times as 2026-03-01T08:30:00, in UTC ({words})") from error
    return column.cast(pa.timestamp("us")).to_numpy(zero_copy_only=False).astype("datetime64[us]")


def _robots(block: Any, axes: int, where: str, first_line: int) -> tuple[Any, list[Any]]:
    """Return the index of the robot of every row (n,), and the robots."""
    pc, pa = library("pyarrow.compute"), library("pyarrow")
    cell, arm = block["cell"].combine_chunks(), _text(block, "arm", "main")
    if cell.null_count:
        row = int(np.argmax(np.asarray(cell.is_null())))
        raise InputError(f"{where}:{first_line + row}: cell is empty: write the cell name of the robot")
    names = [name for name in (f"serial{joint}" for joint in range(1, axes + 1)) if name in block.schema.names]
    serials = [pc.fill_null(block[name].combine_chunks().cast(pa.int64()), 0) for name in names]
    key = pc.binary_join_element_wise(cell, arm, *(serial.cast(pa.string()) for serial in serials), "\x1f")
    encoded = key.dictionary_encode()
    first = np.unique(encoded.indices.to_numpy(), return_index=True)[1]
    robots = [
        robot_name(cell[int(row)].as_py(), arm[int(row)].as_py(), [serial[int(row)].as_py() for serial in serials])
        for row in first
    ]
    return encoded.indices, robots


def _clock(times: np.ndarray, which: np.ndarray, keys: Sequence[str], clock: tuple[datetime, dict[str, int]]) -> Any:
    """Return why the time of a row is implausible, null where it is plausible."""
    now, seen = clock
    at = times.astype(np.int64)
    latest = int(now.astimezone(UTC).timestamp() * 1e6 + AHEAD_S * 1e6)
    wrong = np.full(len(at), None, dtype=object)
    order = np.argsort(which, kind="stable")
    bounds = np.flatnonzero(np.diff(which[order], prepend=-1))
    possible = (at >= int(EARLIEST.timestamp() * 1e6)) & (at <= latest)
    for start, end in zip(bounds, [*bounds[1:], len(order)], strict=True):
        rows = order[start:end]
        key = keys[int(which[rows[0]])]
        own = np.where(possible[rows], at[rows], -1)
        before = np.maximum.accumulate(np.concatenate([[seen.get(key, -1)], own]))
        seen[key] = int(before[-1])
        wrong[rows[possible[rows] & (at[rows] < before[:-1])]] = WENT_BACK
    wrong[~possible] = "implausible time: the clock was never set, or is ahead"
    return library("pyarrow").array(wrong, library("pyarrow").string())


def _loads(block: Any, where: str, first_line: int) -> Any:
    """Return one load per row, or none."""
    pa = library("pyarrow")
    count, kind = block.num_rows, columns().field("loads").type
    if "load" not in block.schema.names:
        return pa.ListArray.from_arrays(pa.array(np.zeros(count + 1, dtype=np.int32)), pa.array([], kind.value_type))
    program = block["load"].combine_chunks()
    there = np.asarray(program.is_valid())
    outcome = block["outcome"].combine_chunks() if "outcome" in block.schema.names else pa.nulls(count, pa.string())
    odd = [row for row, said in enumerate(outcome.to_pylist()) if said is not None and said not in _OUTCOMES]
    if odd:
        raise InputError(f"{where}:{first_line + odd[0]}: outcome: one of {', '.join(_OUTCOMES)}")
    com, com_std = (_lists(block, [f"com_{axis}{std}_m" for axis in "xyz"]) for std in ("", "_std"))
    masses = [pa.array(_number(block, name), from_pandas=True) for name in ("mass_kg", "mass_std_kg")]
    parts = [program, *masses, com, com_std, outcome]
    mask = pa.array(there)
    values = pa.StructArray.from_arrays([part.filter(mask) for part in parts], fields=list(kind.value_type))
    offsets = np.concatenate([[0], np.cumsum(there)]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), values)
