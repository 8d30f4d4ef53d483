"""What leaves a recording is what its file holds, to the last bit, by readers that are not ours."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import duckdb
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from asammdf import MDF
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gateway.cli import main
from gateway.data.recording import reader
from tests.data.recordings import several
from tests.data.wrong_inputs import recording

SHAPES = {
    "rest of six axes": lambda folder: recording(folder),
    "four axes": lambda folder: several(folder / "run.h5", "four"),
    "seven axes": lambda folder: several(folder / "run.h5", "seven"),
    "two arms": lambda folder: several(folder / "run.h5", "four", "seven"),
    "killed": lambda folder: several(folder / "run.h5", "seven", status=None),
}


@pytest.fixture(params=SHAPES)
def path(request, tmp_path) -> Path:
    return SHAPES[request.param](tmp_path)


def export(path: Path, fmt: str, *more: str) -> Path:
    out = path.with_suffix(f".{fmt}")
    done = CliRunner().invoke(main, ["export", str(path), "--format", fmt, "-o", str(out), *more])
    assert done.exit_code == 0, done.output
    return out


def groups(path: Path) -> Iterator[tuple[str, str, h5py.Group]]:
    """Arm, kind and group of every visit and period, in the order of measuring."""
    with h5py.File(path) as file:
        for arm in file["arms"]:
            found = [
                (kind[:-1], group)
                for kind in ("visits", "periods")
                for group in file[f"arms/{arm}"].get(kind, {}).values()
            ]
            for kind, group in sorted(found, key=lambda pair: pair[1].name.rsplit("/", 1)[1]):
                yield arm, kind, group


def column(name: str, axis: int) -> str:
    """`q_rad` of axis 2 is `q2_rad`."""
    return f"_{axis}".join(name.rsplit("_", 1)).replace(f"_{axis}", f"{axis}_") if "_" in name else f"{name}{axis}"


def expected(group: h5py.Group) -> dict[str, list[Any]]:
    """Columns of a group: datasets and attributes, None where the drive sends no such word."""
    samples = len(group["time_s"])
    out: dict[str, list[Any]] = {}
    columns = {name: np.full((samples, *np.shape(value)), value, dtype=object) for name, value in group.attrs.items()}
    for name, dataset in group.items():
        columns[name] = dataset[()].astype(object)
        if "missing" in dataset.attrs:
            columns[name][dataset[()] == dataset.attrs["missing"]] = None
    for name, values in columns.items():
        if values.ndim == 1:
            out[name] = values.tolist()
        else:
            out |= {column(name, axis + 1): values[:, axis].tolist() for axis in range(values.shape[1])}
    return out


def same(one: Any, two: Any) -> bool:
    """Equal to the last bit; NaN is NaN."""
    if isinstance(one, float) and isinstance(two, float):
        return np.float64(one).tobytes() == np.float64(two).tobytes() or (one != one and two != two)
    return one == two


def agree(read: dict[str, list[Any]], held: dict[str, list[Any]], at: slice) -> None:
    for name, values in held.items():
        assert all(map(same, read[name][at], values)), name
        assert len(read[name][at]) == len(values)


def test_parquet_holds_every_value(path):
    table = pq.read_table(export(path, "parquet"))
    read, start, names = table.to_pydict(), 0, set()
    for arm, kind, group in groups(path):
        held = expected(group)
        at = slice(start, start + len(group["time_s"]))
        agree(read, held | {"arm": [arm] * len(group["time_s"]), "group": [kind] * len(group["time_s"])}, at)
        assert read["number"][at] == [int(group.name.rsplit("/", 1)[1])] * len(group["time_s"])
        absent = set(read) - set(held) - {"arm", "group", "number"}
        assert all(value is None for name in absent for value in read[name][at])
        names |= set(held)
        start = at.stop
    assert start == table.num_rows
    assert set(read) == names | {"arm", "group", "number"}


def test_parquet_carries_units_and_the_whole_cell(path):
    out = export(path, "parquet")
    schema = pq.read_schema(out)
    units = {name: (schema.field(name).metadata or {}).get(b"unit") for name in schema.names}
    assert (units["q1_rad"], units["joint_torque2_nm"], units["time_s"]) == (b"rad", b"Nm", b"s")
    assert schema.field("motor_torque1_nm").metadata[b"remark"] == b"motor side"
    with h5py.File(path) as file:
        for name, text in file.attrs.items():
            assert schema.metadata[name.encode()].decode() == str(text)
        arm = next(iter(file["arms"]))
        constants = schema.metadata[f"arms/{arm}/constants".encode()]
        assert json.loads(constants) == json.loads(file[f"arms/{arm}"].attrs["constants"])


def test_duckdb_reads_the_parquet_file(path):
    out = export(path, "parquet")
    (rows,) = duckdb.sql(f"select count(*), count(distinct load), max(time_s) from '{out}'").fetchall()
    held = [
        (len(group["time_s"]), str(group.attrs["load"]), float(group["time_s"][-1])) for _, _, group in groups(path)
    ]
    assert rows == (sum(n for n, _, _ in held), len({load for _, load, _ in held}), max(end for _, _, end in held))


def messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Decoded messages of every channel, with their times [ns]."""
    found: dict[str, list[tuple[int, Any]]] = {}
    reader = make_reader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.message_encoding == "json":
            decoded = json.loads(message.data)
        else:
            decoded = DecoderFactory().decoder_for("cdr", schema)(message.data)
        found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


@pytest.mark.slow
def test_mcap_holds_every_value(path):
    read = messages(export(path, "mcap"))
    rows = {topic: iter(each) for topic, each in read.items()}
    for arm, kind, group in groups(path):
        held = {name: dataset[()] for name, dataset in group.items()}
        for row in range(len(group["time_s"])):
            stamp, sample = next(rows[f"/{arm}/samples"])
            assert stamp == round(float(held["time_s"][row]) * 1e9)
            assert sample["group"] == kind
            assert set(sample) == {"group", "number", *held, *group.attrs}
            for name, values in held.items():
                constants = np.asarray(sample[name], dtype=object)
                missing = group[name].attrs.get("missing")
                null = values[row] != values[row] if values.dtype.kind == "f" else values[row] == missing
                assert np.array_equal(constants == None, np.broadcast_to(null, constants.shape)), name  # noqa: E711
                assert (constants[constants != None] == values[row][~np.asarray(null)]).all(), name  # noqa: E711
            for name, value in group.attrs.items():
                assert np.array_equal(sample[name], value), name
            stamp, state = next(rows[f"/{arm}/joint_states"])
            assert stamp == state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
            assert state.header.frame_id == arm
            assert state.name == [f"J{axis + 1}" for axis in range(len(state.position))]
            assert np.array_equal(state.position, held["q_rad"][row])
            assert np.array_equal(state.effort, held["joint_torque_nm"][row])
            assert list(state.velocity) == []
    assert all(next(left, None) is None for left in rows.values())


def test_mcap_says_units_and_the_whole_cell(path):
    reader = make_reader(io.BytesIO(export(path, "mcap").read_bytes()))
    constants = {record.name: record.metadata for record in reader.iter_metadata()}
    with h5py.File(path) as file:
        assert constants["recording"] == {name: str(text) for name, text in file.attrs.items()}
        assert {name for name in constants if name != "recording"} == {f"arms/{arm}" for arm in file["arms"]}
    for channel in reader.get_summary().channels.values():
        if channel.message_encoding == "json":
            schema = json.loads(reader.get_summary().schemas[channel.schema_id].data)
            assert schema["properties"]["q_rad"]["unit"] == "rad"
            assert schema["properties"]["joint_torque_nm"]["description"].startswith("Nm, joint side")


def test_mf4_holds_every_value(path):
    with MDF(export(path, "mf4")) as file:
        numbers = {group.channel_group.acq_name: number for number, group in enumerate(file.groups)}
        starts = dict.fromkeys(numbers, 0)
        for arm, kind, group in groups(path):
            held = expected(group)
            at = slice(starts[arm], starts[arm] + len(group["time_s"]))
            for name, values in (held | {"group": [kind] * len(group["time_s"])}).items():
                signal = file.get(name, group=numbers[arm], ignore_invalidation_bits=True)
                absent = signal.invalidation_bits
                constants = [
                    value.decode() if isinstance(value, bytes) else value for value in signal.samples[at].tolist()
                ]
                lost = [False] * len(constants) if absent is None else absent[at].tolist()
                read = [None if gone else value for gone, value in zip(lost, constants, strict=True)]
                assert all(map(same, read, values)), name
                assert np.array_equal(signal.timestamps[at], group["time_s"][()])
            starts[arm] = at.stop
        for arm, number in numbers.items():
            assert len(file.get("time_s", group=number).samples) == starts[arm]
            assert file.get("q1_rad", group=number).unit == "rad"
            assert file.get("joint_torque2_nm", group=number).comment == "joint side, gear efficiency not applied"


def test_mf4_has_the_cell_attached(path):
    with MDF(export(path, "mf4")) as file, h5py.File(path) as held:
        texts = {
            str(name): bytes(content) for content, name, _ in map(file.extract_attachment, range(len(file.attachments)))
        }
        assert texts["cell.toml"].decode() == held.attrs["cell"]
        assert texts["robot.urdf"].decode() == held.attrs["robot"]
        assert json.loads(texts["recording.json"])["software"] == held.attrs["software"]


def trace_beside(path: Path, suffix: str = ".blf", frames: int = 300) -> list[can.Message]:
    """A frame trace as a run with --trace leaves it."""
    random = np.random.default_rng(3)
    sent = [
        can.Message(
            timestamp=1.7e9 + 0.0005 * number,
            arbitration_id=int(random.integers(0, 0x800)),
            data=random.bytes(int(random.integers(0, 9))),
            is_extended_id=False,
            is_rx=bool(number % 3),
            channel=0,
        )
        for number in range(frames)
    ]
    with can.Logger(path.with_suffix(suffix)) as log:
        for message in sent:
            log.on_message_received(message)
    return sent


@pytest.mark.parametrize("suffix", [".blf", ".log", ".asc"])
def test_blf_holds_the_frames_of_the_trace(tmp_path, suffix):
    path = several(tmp_path / "run.h5", "four")
    sent = trace_beside(path, suffix)
    out = tmp_path / "out.blf"
    assert CliRunner().invoke(main, ["export", str(path), "--format", "blf", "-o", str(out)]).exit_code == 0
    with can.BLFReader(out) as log:
        read = list(log)
    assert [(each.arbitration_id, bytes(each.data), each.is_rx) for each in read] == [
        (each.arbitration_id, bytes(each.data), each.is_rx) for each in sent
    ]
    gaps = np.diff([each.timestamp for each in read]) - np.diff([each.timestamp for each in sent])
    assert np.abs(gaps).max() < 2e-6


def test_a_recording_to_pass_on_holds_every_sample_and_no_serial_number_or_folder(tmp_path):
    path, out = several(tmp_path / "run.h5", "four"), tmp_path / "passed.h5"
    serial = 0x51AB51
    with h5py.File(path, "r+") as file:
        text = file.attrs["cell"].replace('robot = "', 'robot = "/home/person/')
        assert "/home/person/" in text
        for name in ("a/drive.toml", "b/drive.toml"):
            text = text.replace('"generic-cia402"', f'"{name}"', 1)
        profiles = json.loads(file.attrs["profiles"])
        plain = profiles["generic-cia402"]
        profiles |= {"a/drive.toml": plain + "# first", "b/drive.toml": plain + "# second"}
        file.attrs["profiles"] = json.dumps(profiles)
        file.attrs["cell"] = f"{text}\n# J1: node 1, serial 0x{serial:X}, firmware 2"
        for name in ("identities", "ledger"):
            file["arms/four"].attrs[name] = json.dumps([{"node_id": 1, "serial_number": serial}])
    done = CliRunner().invoke(main, ["export", str(path), "--format", "h5", "-o", str(out)])
    assert done.exit_code == 0, done.output
    content = out.read_bytes()
    private = (b"person", str(serial).encode(), b"51AB51", serial.to_bytes(4, "little"))
    assert not any(each in content for each in private)
    assert b"firmware 2" in content
    for (_, _, before), (_, _, after) in zip(groups(path), groups(out), strict=True):
        assert dict(after.attrs).keys() == dict(before.attrs).keys()
        assert {name: item[()].tobytes() for name, item in after.items()} == {
            name: item[()].tobytes() for name, item in before.items()
        }
    passed = reader.read(out)
    assert passed.arm("four").identities == [{"node_id": 1, "serial_number": None}]
    named = [passed.profiles[name] for name in re.findall('profile = "(.*)"', passed.cell_text)]
    assert [text.rsplit("# ", 1)[1] for text in named[:2]] == ["first", "second"]


def test_frames_are_not_made_up(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = several(tmp_path / "run.h5", "four")
    arguments = ["export", "run.h5", "--format", "blf", "-o", "x.blf"]
    done = CliRunner().invoke(main, arguments)
    assert (done.exit_code, "record with --trace run.blf" in done.stderr) == (3, True), done.output
    path.with_suffix(".blf").write_bytes(b"no frames")
    done = CliRunner().invoke(main, arguments)
    assert (done.exit_code, "run.blf: cannot be read as a frame trace" in done.stderr) == (3, True), done.output
    trace_beside(path, frames=0)
    done = CliRunner().invoke(main, arguments)
    assert (done.exit_code, "run.blf: holds no frame" in done.stderr) == (3, True), done.output
    trace_beside(path)
    done = CliRunner().invoke(main, [*arguments, "--load", "none"])
    assert (done.exit_code, "blf is of the complete run" in done.stderr) == (3, True), done.output
    assert not (tmp_path / "x.blf").exists()


@pytest.mark.parametrize("fmt", ["parquet", "mcap", "mf4"])
def test_a_run_without_a_sample_leaves_with_what_is_known_of_it(tmp_path, fmt):
    path = several(tmp_path / "run.h5", "four", samples=0)
    out = path.with_suffix(f".{fmt}")
    done = CliRunner().invoke(main, ["export", str(path), "--format", fmt, "-o", str(out)])
    assert done.exit_code == 0
    assert "contains no sample yet" in done.stderr
    if fmt == "parquet":
        table = pq.read_table(out)
        assert (table.num_rows, table.schema.metadata[b"exit_status"]) == (0, b"abort")
    elif fmt == "mf4":
        with MDF(out) as file:
            assert (len(file.get("time_s").samples), len(file.groups)) == (0, 1)
    else:
        reader = make_reader(io.BytesIO(out.read_bytes()))
        assert next(reader.iter_metadata()).metadata["exit_status"] == "abort"
        assert list(reader.iter_messages()) == []


def test_only_one_arm_and_one_load(tmp_path):
    path = several(tmp_path / "run.h5", "four", "seven")
    table = pq.read_table(export(path, "parquet", "--arm", "seven", "--load", "tool ä"))
    assert set(table["arm"].to_pylist()) == {"seven"}
    assert set(table["load"].to_pylist()) == {"tool ä"}
    assert "q7_rad" in table.column_names


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("--format", "mcap"), 2, "--format mcap is a binary format: give a file with -o"),
        (("--format", "mcap", "-o", "x", "--arm", "left"), 3, "contains the arms four: name one of them with --arm"),
        (("--format", "parquet", "-o", "x", "--load", "b"), 3, "load 'b' is not in the recording; it contains none"),
    ],
)
def test_what_cannot_leave_is_said(tmp_path, monkeypatch, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    several(tmp_path / "run.h5", "four")
    done = CliRunner().invoke(main, ["export", "run.h5", *arguments])
    assert (done.exit_code, says in done.stderr) == (code, True), done.output
    assert not (tmp_path / "x").exists()


def test_a_truncated_recording_is_refused_and_nothing_is_written(tmp_path):
    path = several(tmp_path / "run.h5", "four")
    path.write_bytes(path.read_bytes()[:-5000])
    done = CliRunner().invoke(main, ["export", str(path), "--format", "mcap", "-o", str(tmp_path / "x")])
    assert done.exit_code == 3
    assert "run.h5: is truncated" in done.stderr
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(("fmt", "library"), [("mcap", "mcap"), ("parquet", "pyarrow"), ("mf4", "asammdf")])
def test_a_missing_library_is_named_with_what_brings_it(tmp_path, monkeypatch, fmt, library):
    path = several(tmp_path / "run.h5", "four")
    for name in ("mcap", "mcap.writer", "pyarrow", "pyarrow.parquet", "asammdf"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    done = CliRunner().invoke(main, ["export", str(path), "--format", fmt, "-o", str(tmp_path / "x")])
    assert done.exit_code == 3
    assert f'needs {library}: pip install "servo-gateway[formats]"' in " ".join(done.stderr.split())
