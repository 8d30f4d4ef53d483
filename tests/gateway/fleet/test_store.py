"""Files into the store and out of it: once, whole, by robot and month; what cannot be used is named."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gateway.cell.config import load_cell
from gateway.errors import InputError
from gateway.fleet.columns import SCHEMA_KEY
from gateway.fleet.history import history
from gateway.fleet.ingest import ingest
from gateway.fleet.store import Store, open_or_make, open_store
from gateway.result.result import LoadResult, Result, to_json
from tests.data.fleets import checks, write_table
from tests.data.visits import ARM_HEADER, CELL, header_of, recording_of, visit

NOW = datetime(2026, 6, 1, tzinfo=UTC)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return open_or_make(tmp_path / "store")


def recording(path: Path, created: str = "2026-02-03T04:05:06+00:00") -> Path:
    arm = replace(ARM_HEADER, identities=[{"serial_number": 100 + joint} for joint in range(6)])
    return recording_of(path, replace(header_of(load_cell(CELL)), created=created), [visit(1, -1)], arm)


def test_rows_lie_by_robot_and_month_and_duckdb_reads_them(store: Store, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", [*checks("one", days=range(40)), *checks("two", days=range(3))])
    done = ingest(store, [table], NOW)
    assert (done.added, done.known, done.refused, done.clock) == (43, 0, (), ())
    places = sorted(str(path.relative_to(store.path)) for path in store.path.glob("checks/*/*/*"))
    one, two = store.robots()
    assert places == [f"checks/robot={one}/month=2026-0{m}/checks.parquet" for m in (1, 2)] + [
        f"checks/robot={two}/month=2026-01/checks.parquet"
    ]
    held = f"read_parquet('{store.path}/checks/*/*/*.parquet')"
    asked = f"select robot, month, count(*) from {held} group by all order by all"
    assert duckdb.sql(asked).fetchall() == [(one, "2026-01", 31), (one, "2026-02", 9), (two, "2026-01", 3)]
    assert pq.read_schema(store.files(one)[0]).metadata[SCHEMA_KEY] == b"1"
    assert not list(store.path.rglob("*.tmp"))


def test_the_same_file_is_held_once_and_later_ones_are_added(store: Store, tmp_path: Path) -> None:
    first = write_table(tmp_path / "a.csv", checks("one", days=range(5)))
    assert ingest(store, [first], NOW).added == 5
    assert ingest(store, [first, first], NOW).known == 10
    later = write_table(tmp_path / "b.csv", checks("one", days=range(5, 8)))
    assert ingest(store, [later], NOW).added == 3
    (robot,) = store.robots()
    times = store.read(robot)["time_utc"].to_pylist()
    assert len(times) == 8
    assert times == sorted(times)


def test_values_stay_as_they_were(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=range(2))
    rows[1]["gain2"] = ""
    ingest(store, [write_table(tmp_path / "a.csv", rows)], NOW)
    (robot,) = store.robots()
    held = store.read(robot)
    assert held["gain"].to_pylist() == [[rows[0]["gain1"], rows[0]["gain2"]], [rows[1]["gain1"], None]]
    assert held["temperature_c"].to_pylist()[0] == [rows[0]["temp1_c"], rows[0]["temp2_c"]]
    assert held["coulomb_nm"].to_pylist() == [None, None]
    assert held["serial_numbers"].to_pylist()[0] == [11, 12]
    load = held["loads"].to_pylist()[0][0]
    assert (load["program"], load["mass_kg"], load["outcome"]) == ("pick", rows[0]["mass_kg"], None)


def test_months_are_reported_with_their_means(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=range(4))
    ingest(store, [write_table(tmp_path / "a.csv", rows[:2])], NOW)
    ingest(store, [write_table(tmp_path / "b.csv", rows[2:])], NOW)
    (month,) = pq.read_table(store.months).to_pylist()
    assert (month["checks"], month["month"], month["cell"]) == (4, "2026-01", "one")
    assert month["gain"][0] == pytest.approx(sum(float(str(row["gain1"])) for row in rows) / 4, rel=1e-12)
    assert month["coulomb_nm"] == []


def test_another_drive_is_another_robot(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=range(4))
    for row in rows[2:]:
        row["serial2"] = 99
    ingest(store, [write_table(tmp_path / "a.csv", rows)], NOW)
    assert len(store.robots()) == 2


def test_recording_is_copied_and_is_of_the_robot_that_it_names(store: Store, tmp_path: Path) -> None:
    path = recording(tmp_path / "run.h5")
    assert ingest(store, [path], NOW).added == 1
    assert ingest(store, [path], NOW).known == 1
    ((robot, copy),) = store.recordings()
    assert copy.read_bytes() == path.read_bytes()
    (row,) = store.read(robot).to_pylist()
    assert row["time_utc"] == datetime(2026, 2, 3, 4, 5, 6)
    assert (row["cell"], row["arm"], row["kind"]) == ("small", "main", "recording")
    assert row["serial_numbers"] == [100, 101, 102, 103, 104, 105]
    assert copy.stem == row["sha256"]


def test_half_a_recording_is_named_and_the_others_are_added(store: Store, tmp_path: Path) -> None:
    complete = recording(tmp_path / "whole.h5")
    half = tmp_path / "half.h5"
    half.write_bytes(complete.read_bytes()[: complete.stat().st_size // 2])
    done = ingest(store, [half, complete, tmp_path / "odd.txt"], NOW)
    assert done.added == 1
    assert [said.split(": ")[0] for said in done.refused] == [str(half), str(tmp_path / "odd.txt")]
    assert "truncated" in done.refused[0] or "damaged" in done.refused[0]


def test_result_that_names_no_robot_is_refused(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(to_json(Result(robot="r", loads=(LoadResult("a", 1.0, 0.1),))))
    (said,) = ingest(store, [path], NOW).refused
    assert "does not state its robot" in said


def test_a_clock_set_back_is_reported_and_nothing_is_lost(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=[0, 1, 2, 1, 3])
    done = ingest(store, [write_table(tmp_path / "a.csv", rows)], NOW)
    assert done.added == 5
    assert len(done.clock) == 1
    assert "1 check has an implausible time (the clock was set back" in done.clock[0]
    (robot,) = store.robots()
    held = store.read(robot)
    wrong = [said is not None for said in held["clock"].to_pylist()]
    assert [line for line, odd in zip(held["line"].to_pylist(), wrong, strict=True) if odd] == [5]


def test_recordings_of_a_clock_that_went_back_run_into_each_other(store: Store, tmp_path: Path) -> None:
    """The second was made by a clock that was set back while the first ran, as long as one visit."""
    begun = datetime(2026, 2, 3, 4, 5, 6, tzinfo=UTC)
    paths = [
        recording(tmp_path / f"run{number}.h5", (begun + timedelta(seconds=delay)).isoformat())
        for number, delay in enumerate([0.0, 0.01])
    ]
    assert ingest(store, paths, NOW).added == 2
    (robot,) = store.robots()
    assert history(store.read(robot)).remarks == (
        "1 recordings overlap the next one: the clock was set back; check their times",
    )
    assert len(list(store.recordings())) == 2


@pytest.mark.parametrize("when", ["1970-01-01T00:00:00", "2031-01-01T00:00:00"])
def test_an_impossible_time_is_reported(store: Store, tmp_path: Path, when: str) -> None:
    rows = checks("one", days=range(3))
    rows[1]["time_utc"] = when
    done = ingest(store, [write_table(tmp_path / "a.csv", rows)], NOW)
    assert (done.added, len(done.clock)) == (3, 1)


def test_store_of_two_schemas_is_named_by_its_file(store: Store, tmp_path: Path) -> None:
    ingest(store, [write_table(tmp_path / "a.csv", checks("one", days=range(3)))], NOW)
    (robot,) = store.robots()
    place = store.place(robot, "2026-02")
    place.parent.mkdir()
    other = pq.read_table(store.files(robot)[0], partitioning=None).replace_schema_metadata({SCHEMA_KEY: b"7"})
    pq.write_table(other, place)
    with pytest.raises(InputError, match=r"month=2026-02.*schema 7, this version reads and writes schema 1"):
        store.read(robot)


def test_file_of_another_schema_stops_no_other_robot_and_stays_as_it_is(store: Store, tmp_path: Path) -> None:
    both = [*checks("one", days=range(3)), *checks("two", days=range(3))]
    ingest(store, [write_table(tmp_path / "a.csv", both)], NOW)
    place = next(store.files(robot)[0] for robot in store.robots() if robot.startswith("one"))
    pq.write_table(pq.read_table(place, partitioning=None).replace_schema_metadata({SCHEMA_KEY: b"7"}), place)
    before = place.read_bytes()
    more = [*checks("one", days=range(3, 6)), *checks("two", days=range(3, 8))]
    done = ingest(store, [write_table(tmp_path / "b.csv", more)], NOW)
    assert (done.added, done.known, len(done.refused)) == (5, 0, 1)
    assert "is of schema 7" in done.refused[0]
    assert str(place) in done.refused[0]
    assert place.read_bytes() == before
    assert store.read(next(robot for robot in store.robots() if robot.startswith("two"))).num_rows == 8
    assert not list(store.path.rglob("*.tmp"))


def test_file_that_is_no_parquet_is_named(store: Store, tmp_path: Path) -> None:
    ingest(store, [write_table(tmp_path / "a.csv", checks("one", days=range(3)))], NOW)
    (file,) = store.files(store.robots()[0])
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(InputError, match=r"checks\.parquet: cannot be read as Parquet"):
        store.read(store.robots()[0])


def test_folder_of_other_things_is_no_store(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="not empty"):
        open_or_make(tmp_path)
    with pytest.raises(InputError, match="not a fleet store"):
        open_store(tmp_path)


def test_store_of_another_version_is_refused(store: Store) -> None:
    (store.path / "store.json").write_text(json.dumps({"kind": "servo-gateway fleet", "schema": 2}))
    with pytest.raises(InputError, match="schema"):
        open_store(store.path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gian1": 1.0}, "column 'gian1' is not known"),
        ({"cell": ""}, r"a\.csv:2: cell is empty"),
        ({"time_utc": "yesterday"}, "time_utc: write times as"),
        ({"gain1": "much"}, "cannot be read as a table of summaries"),
        ({"outcome": "perhaps"}, "outcome: one of"),
    ],
)
def test_table_that_cannot_be_used_is_refused(
    store: Store, tmp_path: Path, change: dict[str, object], said: str
) -> None:
    rows = [row | change for row in checks("one", days=range(2))]
    (refused,) = ingest(store, [write_table(tmp_path / "a.csv", rows)], NOW).refused
    assert re.search(said, refused)
    assert store.robots() == []


COUNT = 100_000
#: Tables that a few kilobytes unpack to gigabytes, or that hold what no table of summaries holds.
HOSTILE = {
    "long text": lambda: {"cell": pa.DictionaryArray.from_arrays(pa.array([0] * COUNT), pa.array(["x" * 80_000]))},
    "many rows": lambda: {"gain1": pa.array(np.ones(5_000_000))},
    "other kinds": lambda: {"gain1": pa.array([[1.0]] * COUNT)},
    "bytes": lambda: {"load": pa.array([b"\xff\xfe"] * COUNT)},
    "text for number": lambda: {"gain1": pa.array(["much"] * COUNT)},
    "number for text": lambda: {"cell": pa.array([1.5] * COUNT)},
    "number for time": lambda: {"time_utc": pa.array([1e300] * COUNT)},
    "nothing": lambda: {"cell": pa.nulls(COUNT)},
}


@pytest.mark.parametrize("change", HOSTILE.values(), ids=HOSTILE)
def test_one_hostile_file_costs_little_and_the_others_are_added(store: Store, tmp_path: Path, change) -> None:
    good = write_table(tmp_path / "z.csv", checks("one", days=range(3)))
    changed = change()
    count = len(next(iter(changed.values())))
    table_values = {"cell": pa.array(["a"]), "time_utc": pa.array(["2026-03-01"]), "gain1": pa.array([1.0]),
            "gain2": pa.array([1.0])}  # fmt: skip
    complete = {name: pa.repeat(values[0], count) for name, values in table_values.items()} | changed
    pq.write_table(pa.table(complete), tmp_path / "a.parquet", compression="zstd")
    before, pool = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(pool)
    try:
        done = ingest(store, [tmp_path / "a.parquet", good], NOW)
    finally:
        pa.set_memory_pool(before)
    assert done.added == 3
    assert [said.split(": ")[0] for said in done.refused] == [str(tmp_path / "a.parquet")]
    assert (pool.max_memory() or 0) < 200e6


def test_a_column_of_ones_own_is_not_even_read(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=range(3))
    table = pa.Table.from_pylist(rows).append_column("x_deep", pa.array([[["x" * 1000]]] * 3))
    pq.write_table(table, tmp_path / "a.parquet", compression="zstd")
    assert ingest(store, [tmp_path / "a.parquet"], NOW).added == 3


def test_table_as_parquet_gives_the_same_rows(store: Store, tmp_path: Path) -> None:
    rows = checks("one", days=range(3))
    pq.write_table(pa.Table.from_pylist(rows), tmp_path / "a.parquet")
    assert ingest(store, [tmp_path / "a.parquet"], NOW).added == 3
    (robot,) = store.robots()
    assert store.read(robot)["gain"].to_pylist() == [[row["gain1"], row["gain2"]] for row in rows]
