"""Logs of other programs become measured tables; what cannot be used is said in a sentence, with its line."""

from __future__ import annotations

import math
import os
import re
import sqlite3
import time
import tracemalloc
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from mcap import writer as mcap_writer
from mcap_ros2.writer import Writer

from gateway.cli import main
from gateway.data.table import read_csv
from gateway.errors import InputError
from gateway.formats import ros_bag
from gateway.formats.log_map import TIME_UNITS, UNITS
from gateway.formats.mcap_file import JOINT_STATE, JOINT_STATE_TEXT
from gateway.formats.ros_bag import BagDatabase
from gateway.formats.smooth import rates

UR = """axes = 6
[log]
separator = " "
[time]
column = "timestamp"
[load]
label = "gripper"
[[column]]
log = "actual_q_{}"
table = "q{}_rad"
unit = "rad"
first = 0
[[column]]
log = "actual_qd_{}"
table = "qd{}_rad_s"
unit = "rad/s"
first = 0
[[column]]
log = "target_qdd_{}"
table = "qdd{}_rad_s2"
unit = "rad/s2"
first = 0
[[column]]
log = "actual_current_{}"
table = "i{}_a"
unit = "A"
first = 0
sign = [1, -1, 1, 1, 1, 1]
"""
KUKA = """axes = 2
[log]
separator = ";"
decimal = ","
encoding = "latin-1"
skip_lines = 1
[time]
column = "Zeit [ms]"
unit = "ms"
[rest]
seconds = 0.3
settle_s = 0.05
first_pose = 10
[load]
column = "Werkzeug"
[[column]]
log = "A{} Ist [°]"
table = "q{}_rad"
unit = "deg"
sign = [-1, 1]
offset = [0.0, 0.1]
[[column]]
log = "A{} Moment [%]"
table = "tau{}_nm"
unit = "%"
rated = [200.0, 100.0]
"""


def run(*arguments: object):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def imported(folder: Path, log: str | bytes, text: str, name: str = "log.csv"):
    """Result of the command, and the table's path."""
    (folder / name).write_bytes(log if isinstance(log, bytes) else log.encode())
    (folder / "map.toml").write_text(text, encoding="utf-8")
    return run("import", folder / name, "--map", folder / "map.toml", "-o", folder / "t.csv"), folder / "t.csv"


def ur_log(rows: int = 5, change=lambda row, cells: cells) -> str:
    names = [
        f"{name}_{axis}" for name in ("actual_q", "actual_qd", "target_qdd", "actual_current") for axis in range(6)
    ]
    lines = [" ".join(["timestamp", *names])]
    for row in range(rows):
        cells = {"timestamp": repr(1000.0 + 0.008 * row)}
        cells |= {name: repr(0.01 * row + 0.1 * index) for index, name in enumerate(names)}
        lines.append(" ".join(change(row, cells).values()))
    return "\n".join(lines) + "\n"


def test_a_log_of_the_rtde_client(tmp_path):
    done, out = imported(tmp_path, ur_log(), UR)
    assert done.exit_code == 0, done.output
    lines = out.read_text().splitlines()
    assert lines[0].split(",")[:3] == ["load", "time_s", "q1_rad"]
    table = {name: cells for name, *cells in zip(*(line.split(",") for line in lines), strict=True)}
    assert table["load"] == ["gripper"] * 5
    assert [float(cell) for cell in table["time_s"]] == pytest.approx(0.008 * np.arange(5), abs=1e-9)
    assert [float(cell) for cell in table["q3_rad"]] == pytest.approx(0.2 + 0.01 * np.arange(5))
    assert [float(cell) for cell in table["qdd1_rad_s2"]] == pytest.approx(1.2 + 0.01 * np.arange(5))
    assert [float(cell) for cell in table["i2_a"]] == pytest.approx(-(1.9 + 0.01 * np.arange(5)))


def kuka_log() -> tuple[bytes, list[tuple[float, float]]]:
    """Two poses, the first of them from both sides; decimal commas, degrees, percent of the rated torque."""
    stops = [(10.0, 20.0), (30.0, 20.0), (10.0, 20.0)]
    lines = ["Trace KR C4", "Zeit [ms];A1 Ist [°];A2 Ist [°];A1 Moment [%];A2 Moment [%];Werkzeug"]
    at, number = (0.0, 0.0), 0
    for stop in stops:
        angles = [np.linspace(at, stop, 50, endpoint=False), np.tile(stop, (100, 1))]
        for place in np.concatenate(angles):
            cells = [12.0 * number, *place, 40.0 + 0.01 * (-1) ** number, -25.0]
            lines.append(";".join([*(f"{cell:.6f}".replace(".", ",") for cell in cells), "greifer"]))
            number += 1
        at = stop
    return "\n".join(lines).encode("latin-1"), stops


def test_a_trace_of_a_kuka_controller_becomes_rest_poses(tmp_path):
    log, stops = kuka_log()
    done, out = imported(tmp_path, log, KUKA)
    assert done.exit_code == 0, done.output
    table = read_csv(out, None)
    assert table.pose.tolist() == [10, 11, 10]
    assert set(table.load) == {"greifer"}
    expected = [[-math.radians(one), math.radians(two) + 0.1] for one, two in stops]
    assert table.q_rad == pytest.approx(np.array(expected), abs=1e-6)
    assert table.direction.tolist() == [[-1, 1], [-1, 1], [1, 1]]
    assert table.tau_nm == pytest.approx(np.tile([80.0, -25.0], (3, 1)), abs=1e-3)
    assert table.tau_std_nm[:, 0] == pytest.approx([0.02] * 3, rel=0.05)
    assert (table.count >= 80).all()
    assert not table.moving.any()


JOINTS = ("base", "arm")
ROS = """axes = 2
joints = ["base", "arm"]
[motion]
cutoff_hz = 20
[[column]]
log = "position/{}"
table = "q{}_rad"
unit = "rad"
[[column]]
log = "velocity/{}"
table = "qd{}_rad_s"
unit = "rad/s"
[[column]]
log = "effort/{}"
table = "tau{}_nm"
unit = "Nm"
"""
STEP_NS = 4_000_000


def states(count: int = 200):
    """Messages of an arm that swings, in turning order of its joints, with those of a gripper between."""
    for number in range(count):
        time_s = number * STEP_NS * 1e-9
        values = {
            name: (math.sin(time_s + at), math.cos(time_s + at), 3.0 * at + number) for at, name in enumerate(JOINTS)
        }
        names = JOINTS if number % 2 else JOINTS[::-1]
        header = {"stamp": {"sec": 1_700_000_000, "nanosec": number * STEP_NS}, "frame_id": ""}
        part = [[values[name][k] for name in names] for k in range(3)]
        yield (
            number,
            {"header": header, "name": list(names), "position": part[0], "velocity": part[1], "effort": part[2]},
        )
        if number == 3:
            yield number, {"header": header, "name": ["finger"], "position": [0.1], "velocity": [], "effort": []}


def bag(path: Path, messages=None, topic: str = "/joint_states") -> Path:
    """Messages as ROS 2 stores them: MCAP or SQLite, by the suffix; encoded by a library that is not ours."""
    mcap = path.with_suffix(".mcap")
    with mcap.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(JOINT_STATE, JOINT_STATE_TEXT)
        for number, message in messages if messages is not None else states():
            writer.write_message(topic, schema, message, log_time=10**18 + number * STEP_NS)
        writer.finish()
    if path.suffix == ".mcap":
        return path
    from mcap.reader import make_reader

    with mcap.open("rb") as stream:
        raw = [(message.log_time, message.data) for _, _, message in make_reader(stream).iter_messages()]
    mcap.unlink()
    file = sqlite3.connect(path)
    file.execute(
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,"
        " offered_qos_profiles TEXT)"
    )
    file.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    file.execute("INSERT INTO topics VALUES (1, '/tf', 'tf2_msgs/msg/TFMessage', 'cdr', '')")
    file.execute("INSERT INTO topics VALUES (2, ?, ?, 'cdr', '')", (topic, JOINT_STATE))
    file.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (2, ?, ?)", raw)
    file.commit()
    file.close()
    return path


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_joint_states_of_ros_2(tmp_path, suffix):
    path = bag(tmp_path / f"bag{suffix}")
    done, out = imported(tmp_path, path.read_bytes(), ROS, path.name)
    assert done.exit_code == 0, done.output
    table = read_csv(out, None)
    time_s = np.arange(200) * STEP_NS * 1e-9
    at = time_s[:, None] + np.arange(2)
    assert table.moving.all()
    assert table.time_s == pytest.approx(time_s, abs=1e-12)
    assert np.array_equal(table.q_rad, np.array([[math.sin(t * 1.0 + k) for k in range(2)] for t in time_s]))
    assert table.qd_rad_s == pytest.approx(np.cos(at), abs=1e-12)
    assert table.tau_nm == pytest.approx(np.arange(200)[:, None] + [0.0, 3.0])
    inner = slice(30, -30)
    assert table.qdd_rad_s2[inner] == pytest.approx(-np.sin(at)[inner], abs=0.02)


#: `messages` of a bag that computes its rows without end, or holds what no bag holds.
ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 2 AS topic_id, i AS timestamp"
)
NO_TABLES = {
    "view": f"CREATE VIEW messages AS {ENDLESS}, zeroblob(100) AS data FROM n",
    "virtual": "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
    "none": "SELECT 1",
    "without rowid": "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID",
    "generated": "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(1000000000)))",
}


@pytest.mark.parametrize("sql", NO_TABLES.values(), ids=NO_TABLES)
def test_a_bag_is_read_from_its_tables_alone(tmp_path, sql):
    path = bag(tmp_path / "bag.db3")
    with closing(sqlite3.connect(path)) as file:
        file.execute("DROP TABLE messages")
        file.execute(sql)
        if "generated" in sql or "data AS" in sql:
            file.executemany("INSERT INTO messages (topic_id, timestamp) VALUES (2, ?)", [[1], [2]])
        file.commit()
    began_s = time.process_time()
    done, out = imported(tmp_path, path.read_bytes(), ROS, path.name)
    assert (done.exit_code, out.exists()) == (3, False), done.output
    assert "not a bag" in done.stderr
    assert time.process_time() - began_s < 2.0


class Interrupted(BaseException):
    """What a signal raises wherever the program is."""


@pytest.mark.parametrize(("raised", "match"), [(Interrupted, None), (InputError, "too long for a bag of its size")])
def test_a_bag_that_computes_on_and_on_is_stopped(tmp_path, monkeypatch, raised, match):
    path = bag(tmp_path / "bag.db3")
    looks = iter(range(40))
    monkeypatch.setattr(ros_bag, "STEPS", 10)

    def clock() -> float:
        """A signal is raised in whatever Python code runs, here the look at the clock; or the time is over."""
        if next(looks, None) is None:
            if raised is Interrupted:
                raise Interrupted
            return 1e9
        return 0.0

    monkeypatch.setattr(ros_bag, "time", SimpleNamespace(monotonic=clock))
    with ros_bag.open_bag(path) as file:
        opened = BagDatabase(path, file)
        with pytest.raises(raised, match=match):
            list(opened.messages(0))


def test_a_bag_gives_no_more_than_its_file_has(tmp_path):
    path = bag(tmp_path / "bag.db3")
    with closing(sqlite3.connect(path)) as file:
        file.execute("DROP TABLE messages")
        file.execute("CREATE TABLE messages (topic_id, timestamp, data AS (zeroblob(50000)))")
        file.executemany("INSERT INTO messages (topic_id, timestamp) VALUES (2, ?)", [[n] for n in range(100)])
        file.commit()
    with ros_bag.open_bag(path) as file, pytest.raises(InputError, match="more bytes than the file contains"):
        list(BagDatabase(path, file).messages(2))


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_a_chunk_is_unpacked_no_further_than_a_bag_may_reach(tmp_path, compression):
    path = tmp_path / "bag.mcap"
    with path.open("wb") as stream:
        writer = mcap_writer.Writer(stream, compression=mcap_writer.CompressionType[compression])
        writer.start()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        writer.add_message(channel, 0, bytes(40_000_000), 0)
        writer.finish()
    assert path.stat().st_size < 500_000
    tracemalloc.start()
    done, _ = imported(tmp_path, path.read_bytes(), ROS, path.name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert done.exit_code == 3
    assert "a chunk unpacks to more than 32 MB" in done.stderr
    assert peak < 100e6


@pytest.mark.parametrize("name", ["bag.db3", "bag.mcap", "log.csv"])
def test_a_log_that_is_a_pipe_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    (tmp_path / "map.toml").write_text(ROS)
    words = ["import", str(tmp_path / name), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "out.csv")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 3, done.output
    assert "device, pipe or socket; name a regular file" in " ".join(done.stderr.split())


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_bags_that_cannot_be_used(tmp_path, suffix):
    def said(path: Path, text: str = ROS) -> str:
        done, out = imported(tmp_path, path.read_bytes(), text, path.name)
        assert (done.exit_code, out.exists()) == (3, False), done.output
        return " ".join(done.stderr.split())

    path = bag(tmp_path / f"bag{suffix}", topic="/other")
    assert "contains no topic '/joint_states' but" in said(path)
    assert "/other (sensor_msgs/msg/JointState)" in said(path)
    path.unlink()
    path = bag(tmp_path / f"bag{suffix}")
    assert "write joints = [..] in the map" in said(path, ROS.replace('joints = ["base", "arm"]\n', ""))
    assert "names the joints one, two" in said(path, ROS.replace('"base", "arm"', '"one", "two"'))
    assert f"bag{suffix}:message 1: names arm, base, and not joint 'x'" in said(
        path, ROS.replace('"base", "arm"', '"base", "x"')
    )
    path.write_bytes(path.read_bytes()[:700])
    assert "is damaged, or not a bag" in said(path)
    path.write_bytes(b"nothing")
    assert "is damaged, or not a bag" in said(path)
    path.unlink()
    arm_states = [(number, message) for number, message in states() if "finger" not in message["name"]]
    arm_states[50] = (50, arm_states[50][1] | {"effort": [1.0, math.nan]})
    path = bag(tmp_path / f"bag{suffix}", arm_states)
    assert f"bag{suffix}:message 51: effort/base: 'nan' is not a finite number" in said(path)


def at(row: int, name: str, cell: str):
    """That one cell is another one."""
    return lambda number, cells: cells | ({name: cell} if number == row else {})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (at(2, "actual_q_2", "nan"), "log.csv:4: actual_q_2: 'nan' is not a finite number; nothing is filled in"),
        (at(2, "actual_q_2", "1,5"), "log.csv:4: actual_q_2: '1,5' is not a finite number"),
        (at(3, "timestamp", "3"), "log.csv:5: timestamp: time goes back, 3 s after 1000.016 s"),
        (at(1, "timestamp", "1000.0"), "log.csv:3: timestamp: time stands still"),
        (at(3, "x", "1"), "log.csv:5: 26 cells where the header names 25 columns"),
        (at(0, "actual_q_1", "90.0"), "log.csv:2: actual_q_1 makes q2_rad = 90, beyond"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused_with_its_line(tmp_path, change, says):
    done, out = imported(tmp_path, ur_log(change=change), UR)
    assert (done.exit_code, out.exists()) == (3, False), done.output
    assert says in " ".join(done.stderr.split())


SPEEDS = '[[column]]\nlog = "actual_qd_{}"\ntable = "qd{}_rad_s"\nunit = "rad/s"\nfirst = 0\n'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("actual_q_{}", "actual_p_{}", "log.csv:1: column 'actual_p_0', which the map names, is missing"),
        ('"rad"', '"turns"', "map.toml line 11: unit 'turns' is not one of angle: write rad, mrad, deg"),
        ('"A"', '"permille"', "map.toml line 26: unit 'permille' and rated cannot be combined"),
        ('"q{}_rad"', '"angle{}"', "map.toml line 10: 'angle{}' is not a column of the measured table"),
        ("[1, -1, 1, 1, 1, 1]", "[1, -1]", "map.toml line 28: sign: 2 values for 6 axes"),
        ("axes = 6", "axes = 6\ncolour = 1", "map.toml line 2: colour: unknown key"),
        (SPEEDS, "", "map.toml line 1: state the motion: [rest], or [motion]"),
        ("[load]", "[rows]\nfrom_s = 5.0\n[load]", "[rows] of the map keeps none of the log's 5 rows"),
        ("[load]", "[rest]\n[load]", "the arm is never at rest for 0.5 s"),
        (SPEEDS, "[motion]\ncutoff_hz = 10\n", "5 rows are too few for the speeds of [motion]: 20 at least"),
        ('"gripper"', '"empty"', "map.toml line 7: load 'empty' denotes the unloaded arm"),
        ("axes = 6", "axes = ", "map.toml line 1"),
        ("axes = 6", "axes = 0", "map.toml line 1: axes = 0 must be at least 1"),
    ],
)
def test_a_map_that_cannot_be_used_is_refused_with_its_line(tmp_path, old, new, says):
    assert old in UR
    done, out = imported(tmp_path, ur_log(), UR.replace(old, new))
    assert (done.exit_code, out.exists()) == (3, False), done.output
    assert says in " ".join(done.stderr.split())


def test_a_gap_has_no_speed(tmp_path):
    def change(row, cells):
        return cells | ({"timestamp": repr(1000.1 + 0.008 * row)} if row >= 30 else {})

    done, _ = imported(tmp_path, ur_log(60, change), UR.replace(SPEEDS, "[motion]\ncutoff_hz = 10\n"))
    assert done.exit_code == 3
    assert "log.csv:32: 0.108 s after the row before, where steps are 0.008 s" in " ".join(done.stderr.split())


def test_rows_that_the_map_leaves_out_may_hold_anything(tmp_path):
    def change(row, cells):
        return cells | ({"actual_q_0": "nan"} if row == 1 else {}) | {"actual_qd_0": "7" if row in (2, 3) else "6"}

    text = UR + '[rows]\nfrom_s = 0.012\ncolumn = "actual_qd_0"\nequals = [7.0]\n'
    done, out = imported(tmp_path, ur_log(change=change), text)
    assert done.exit_code == 0, done.output
    assert len(out.read_text().splitlines()) == 3


def test_a_missing_file_is_named(tmp_path):
    (tmp_path / "map.toml").write_text(UR)
    for arguments in (
        ["no.csv", "--map", "map.toml"],
        ["no.db3", "--map", "map.toml"],
        ["map.toml", "--map", "no.toml"],
    ):
        done = run(
            "import", *(tmp_path / name if "." in name else name for name in arguments), "-o", tmp_path / "t.csv"
        )
        assert done.exit_code == 3
        assert "cannot be read" in done.stderr or "joints" in done.stderr


@pytest.mark.parametrize("kind", UNITS)
@given(value=st.floats(-3.0, 3.0))
def test_units_are_those_of_the_books(kind, value):
    books = {
        "deg": math.radians, "mrad": lambda v: v / 1000, "rev": lambda v: v * 2 * math.pi,
        "rpm": lambda v: v * math.pi / 30,
        "deg/s": math.radians, "deg/s2": math.radians, "rev/s": lambda v: v * 2 * math.pi, "mNm": lambda v: v / 1000,
        "kNm": lambda v: 1000 * v, "mA": lambda v: v / 1000, "K": lambda v: v - 273.15, "F": lambda v: (v - 32) / 1.8,
        "%": lambda v: v / 100, "permille": lambda v: v / 1000, "counts": lambda v: v * 2 * math.pi,
        "counts/s": lambda v: v * 2 * math.pi,
    }  # fmt: skip
    for unit, (factor, shift) in UNITS[kind].items():
        assert factor * value + shift == pytest.approx(books.get(unit, lambda v: v)(value), rel=1e-12, abs=1e-12)
    assert TIME_UNITS == {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def test_half_the_power_is_left_at_the_cutoff():
    time_s = np.arange(4000) * 0.001
    q = np.sin(2 * np.pi * 5.0 * time_s)[:, None]
    qd, qdd = rates(time_s, q, 5.0)
    inner = slice(1000, -1000)
    assert np.ptp(qd[inner]) / 2 == pytest.approx(2 * np.pi * 5.0 / math.sqrt(2), rel=1e-2)
    assert np.ptp(qdd[inner]) / 2 == pytest.approx((2 * np.pi * 5.0) ** 2 / math.sqrt(2), rel=1e-2)


def test_the_example_of_the_documentation(tmp_path):
    page = Path(__file__).parents[3] / "docs" / "how-to" / "open-formats.md"
    blocks = dict(re.findall(r"(?s)```\w+ (log|map|table)\n(.*?)```", page.read_text(encoding="utf-8")))
    done, out = imported(tmp_path, blocks["log"], blocks["map"])
    assert done.exit_code == 0, done.output
    assert out.read_text().splitlines() == blocks["table"].splitlines()
    table = read_csv(out, None)
    assert table.q_rad[1] == pytest.approx([math.radians(20), math.radians(45) + 0.5])
    assert table.tau_nm[1] == pytest.approx([40.0, -60.0])
