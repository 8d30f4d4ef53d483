"""Kinds of wrong input, each with what the program has to say: where, what, what to do, with which exit code.

python -m tests.data.wrong_inputs: how many of them are answered as they should be.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import socket
import sys
import tempfile
import uuid
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

from click.testing import CliRunner

from drives.profile_file import load_profile
from gateway.cell.config import load_cell
from gateway.cli import main as program
from tests.data.visits import ARM_HEADER, both_sides, header_of, recording_of

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST_LINES = 10
#: A port in use by another process.
TAKEN_PORT = 47321
HEADER = "load,pose," + ",".join(f"q{axis}_rad" for axis in range(1, 7)) + ",tau2_nm"
ROW = "none,1,0.1,0.2,0.3,0.4,0.5,0.6,12.5"
RESULT = {"schema": 1, "robot": "r", "loads": [{"label": "a", "mass_kg": 2.0, "com_m": [0, 0, 0.1]}]}


def nothing(_: Path) -> None:
    """No file."""


@dataclass(frozen=True)
class Kind:
    """A kind of wrong input.

    Attributes
    ----------
    name : str
    arguments : tuple of str
        Command line; `make` has written what it names.
    code : int
    says : str
        Regular expression of what is reported.
    make : callable
        Writes files into the working folder.
    during : callable
        What is broken while the command runs.
    """

    name: str
    arguments: tuple[str, ...]
    code: int
    says: str
    make: Callable[[Path], object] = nothing
    during: Callable[[], object] = mock.DEFAULT


# -- files that are written for a kind ---------------------------------------------------------------------------------


def cell(*changes: tuple[str, str], name: str = "cell.toml") -> Callable[[Path], object]:
    """The small cell with its robot, changed."""

    def make(folder: Path) -> None:
        text = (EXAMPLES / "small" / "cell.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        (folder / name).write_text(text, encoding="utf-8")
        shutil.copy(EXAMPLES / "small" / "robot.urdf", folder)

    return make


def text(content: str | bytes, name: str) -> Callable[[Path], object]:
    """A file."""

    def make(folder: Path) -> None:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())

    return make


def table(*rows: str, header: str = HEADER) -> Callable[[Path], object]:
    """A measured table beside the small robot."""
    return together(text("\n".join([header, *(rows or (ROW,))]) + "\n", "t.csv"), cell())


def robot(pattern: str, new: str | Callable[[re.Match[str]], str]) -> Callable[[Path], object]:
    """A measured table, the small cell, and its robot changed in every place."""

    def make(folder: Path) -> None:
        path = folder / "robot.urdf"
        path.write_text(re.sub(pattern, new, path.read_text(encoding="utf-8")), encoding="utf-8")

    return together(table(), make)


def multiplied(factor: int) -> Callable[[re.Match[str]], str]:
    """The numbers of an attribute times a factor."""
    return lambda found: f'{found[1]}="{" ".join(repr(factor * float(value)) for value in found[2].split())}"'


def together(*makes: Callable[[Path], object]) -> Callable[[Path], object]:
    """All of these files."""

    def make(folder: Path) -> None:
        for each in makes:
            each(folder)

    return make


def recording(folder: Path, name: str = "run.h5", serial: int = 0) -> Path:
    """A recording of two poses of the bare small arm."""
    serials = [{"node_id": node, "serial_number": serial + node} for node in range(1, 7)] if serial else []
    header, arm = header_of(load_cell(EXAMPLES / "small" / "cell.toml")), replace(ARM_HEADER, identities=serials)
    return recording_of(folder / name, header, both_sides(1, 2, seed=serial), arm)


def of_cell(old: str, new: str) -> Callable[[Path], object]:
    """A recording, and its cell with another name in it."""
    return together(recording, cell((f'name = "{old}"', f'name = "{new}"')))


def cut(folder: Path) -> None:
    path = recording(folder)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flipped(folder: Path) -> None:
    path = recording(folder)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def result(change: dict[str, object] | None = None, **load: object) -> Callable[[Path], object]:
    """A result file."""
    body = RESULT | {"loads": [RESULT["loads"][0] | load]} | (change or {})  # type: ignore[index]
    return text(json.dumps(body), "out.json")


def profile(old: str, new: str) -> Callable[[Path], object]:
    """A profile of one's own with a mistake."""
    content = load_profile("generic-cia402").text
    assert old in content, old
    return text(content.replace(old, new, 1), "mine.toml")


@contextmanager
def port_taken() -> Generator[None]:
    """Listen on the port."""
    with socket.socket() as listener:
        with suppress(OSError):  # another process does
            listener.bind(("127.0.0.1", TAKEN_PORT))
            listener.listen()
        yield


@contextmanager
def full_disk() -> Generator[None]:
    """No room for what is written."""

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with mock.patch("os.fsync", full):
        yield


# -- the table ---------------------------------------------------------------------------------------------------------

PLAN = ("plan", "cell.toml")
RECORD = ("record", "cell.toml", "-o", "r.h5", "--load")
UNTIL = (*RECORD, "a", "--until")
THERMAL = ("commission", "cell.toml", "--thermal")
ESTIMATE = ("estimate", "t.csv", "--robot", "robot.urdf")
EXPORT = ("export", "out.json", "--format", "json")
REPORT = ("report", "out.json", "-o", "r.html")
SHOW = ("profiles", "show", "./mine.toml")
DRAFT = ("profiles", "new", "-o", "p.toml", "--eds")
ANSWERS = ("cell", "new", "--answers", "a.toml", "-o", "c.toml")
CHECK = ("check", "cell.toml", "--bus")
UNUSED_BUS = f"virtual:{uuid.uuid4().hex}"
LIVE = ("live", "cell.toml", "--bus", "udp_multicast:239.74.163.2,port=43997", "--constants", "x.h5")
LINE = r"cell\.toml line \d+"
AXIS = r"cell\.toml line \d+, J1: "
RATIO = '{ value = 120, source = "datasheet p. 7" }'
LIMIT = "position_limit_rad = [-2.8, 2.8]"

CELLS = [
    ("a number for a constant", (RATIO, "101"), AXIS, 'write gear_ratio = { value = 101, source = "..." }'),
    ("a constant without source", (', source = "datasheet p. 7"', ""), AXIS, "source is missing: write gear_ratio ="),
    ("an empty source", ('"datasheet p. 7"', '""'), AXIS, 'write source = "..."'),
    ("a missing key", (f"gear_ratio = {RATIO}\n", ""), AXIS, "gear_ratio is missing .*: write gear_ratio ="),
    ("a misspelt key", ("gear_efficiency", "gear_efficency"), AXIS, "unknown key .*: write gear_efficiency"),
    ("a key in another unit", (LIMIT, "position_limit_deg = [-160, 160]"), AXIS, "write position_limit_rad"),
    ("limits in degrees", (LIMIT, "position_limit_rad = [-180, 180]"), AXIS, r"degrees\? write .*\[-3.142, 3.142\]"),
    ("limits exchanged", (LIMIT, "position_limit_rad = [2.8, -2.8]"), AXIS, "write the lower one first"),
    ("one limit", (LIMIT, "position_limit_rad = [2.8]"), AXIS, r"write position_limit_rad = \[NUMBER, NUMBER\]"),
    ("a limit that is none", (LIMIT, "position_limit_rad = [nan, 2.8]"), AXIS, "not a finite number"),
    ("a speed in degrees", ("speed_limit_rad_s = 0.8", "speed_limit_rad_s = 15"), AXIS, "in degrees/s\\? write"),
    ("a speed above the URDF's", ("speed_limit_rad_s = 0.8", "speed_limit_rad_s = 3.6"), "axis 1: ", "3.5 .*lower"),
    ("a speed of nothing", ("speed_limit_rad_s = 0.8", "speed_limit_rad_s = 0"), AXIS, "must be more than 0: write"),
    ("a number in quotes", ("torque_limit_nm = 420", 'torque_limit_nm = "420"'), AXIS, "is no number: write"),
    ("a truth for a number", ("node_id = 1", "node_id = true"), AXIS, "is no integer: write node_id = 1 to 127"),
    ("a node id that cannot be", ("node_id = 1", "node_id = 200"), AXIS, "must be at most 127"),
    ("a node id twice", ("node_id = 1", "node_id = 2"), r"line \d+, J2: ", "node id 2 is used for more than one axis"),
    ("a constant of 120 Nm/A", ("value = 0.31", "value = 120"), AXIS, "0.001 to 10; in mNm/A\\? write value = 0.12"),
    ("a constant below zero", ("value = 0.31", "value = -0.31"), AXIS, "torque_constant_nm_per_a must be positive"),
    ("a ratio upside down", ("value = 120", "value = 0.00833"), AXIS, "between 1 and 10000; inverted\\? write"),
    ("a ratio of nothing", ("value = 120", "value = 0"), AXIS, "gear_ratio must not be 0"),
    ("an efficiency in percent", ("value = 0.85", "value = 85"), AXIS, "in percent\\? write value = 0.85"),
    ("a sign that is none", ("position_sign = 1", "position_sign = 0"), AXIS, "write position_sign = 1 or -1"),
    ("a zero offset in degrees", ("zero_offset_rad = 0.0", "zero_offset_rad = 90"), AXIS, "write .* = 1.571"),
    ("a flange in millimetres", ("[0, 0, 0.02]", "[0, 0, 200]"), LINE, r"millimetres\? write .*\[0, 0, 0.2\]"),
    ("a flange in degrees", ("0.5235987755982988", "30"), LINE, r"degrees\? write flange_rpy_rad = .*0.5236"),
    ("gravity in g", ("-9.80665", "-1"), LINE, r"gravity_m_s2: .* write \[0, 0, -9.80665\]"),
    ("a box inside out", ("min_m = [-0.12", "min_m = [0.5"), LINE, "must be below max_m"),
    ("a bus that is not there", ('bus = "a"', 'bus = "b"'), LINE, r'no \[bus.b\]: write bus = "a"'),
    ("a pacing that is none", ('pacing = "real"', 'pacing = "fast"'), LINE, 'write pacing = "lockstep" or "real"'),
    ("trust of unknown form", ('"prior:0.05"', '"prior"'), LINE, "inertials = .* exact, ignore, prior:S"),
    ("no robot", ('robot = "robot.urdf"\n', ""), LINE, r'either robot = "FILE.urdf" or \[arm.dh\]'),
    (
        "a robot that is not there",
        ("robot.urdf", "nowhere.urdf"),
        "nowhere.urdf: cannot be read",
        "correct the key robot",
    ),
    ("no TOML", ("[poses]", "[poses"), LINE, "not valid TOML: .*; correct that line"),
    ("poses that are not there", ("[poses]", '[poses]\nfile = "p.csv"'), "p.csv: ", "cannot be read"),
]

ROBOTS = [
    (
        "in millimetres",
        r"robot\.urdf: .*millimetres; export it in metres",
        robot(r'(xyz)="([^"]* [^"]*)"', multiplied(1000)),
    ),
    (
        "in grams",
        r"robot\.urdf: .*in grams; export it in kilograms",
        robot(r'(mass value)="([^"]*)"', multiplied(1000)),
    ),
    (
        "as xacro",
        r"robot\.urdf: this is a xacro file: expand it first: `xacro",
        robot(r'upper="[^"]*"', lambda _: 'upper="${pi}"'),
    ),
    (
        "with a jaw",
        r"robot\.urdf: joint 'jaw_joint'.*name the last link of the arm: --tip link_6",
        robot("</robot>", lambda _: JAW),
    ),
]
JAW = (
    '<link name="jaw"/><joint name="jaw_joint" type="revolute"><parent link="link_6"/><child link="jaw"/></joint>'
    "</robot>"
)

TABLES = [
    ("a header without rows", table("", header=HEADER), r"t\.csv:1: the table has a header but no row"),
    ("a NaN", table(ROW.replace("0.1", "nan")), r"t\.csv:2: q1_rad: 'nan' is not a finite number; .*correct or remove"),
    ("an infinite number", table(ROW.replace("12.5", "inf")), r"t\.csv:2: tau2_nm: 'inf' is not a finite number"),
    ("a word for a number", table(ROW.replace("12.5", "much")), r"t\.csv:2: tau2_nm: 'much' is not a finite number"),
    ("an empty cell", table(ROW.replace("12.5", "")), r"t\.csv:2: tau2_nm: is empty; .*correct or remove"),
    ("degrees", table(ROW, ROW.replace("none,1,0.1", "none,2,90")), r"t\.csv:3: q1_rad = 90 .*degrees; write 1.5708"),
    ("an unknown column", table(header=HEADER.replace("tau2_nm", "torque")), r"t\.csv:1: unknown column 'torque';"),
    ("a column twice", table(header=HEADER.replace("q2_rad", "q1_rad")), r"t\.csv:1: column 'q1_rad' is given twice"),
    ("a missing column", table(header=HEADER.replace("q2_rad", "x_q")), r"t\.csv:1: column 'q2_rad' is missing"),
    ("no torque", table(header=HEADER.replace("tau2_nm", "x_tau")), r"t\.csv:1: no torque or current column"),
    ("currents without a cell", table(header=HEADER.replace("tau2_nm", "i2_a")), r"t\.csv:1: .*give --cell"),
    ("semicolons", table(ROW.replace(",", ";"), header=HEADER.replace(",", ";")), r"t\.csv:1: .*must be a comma"),
    ("a row that is too short", table("none,1,0.1"), r"t\.csv:2: 3 cells where the header names 9 columns"),
    ("rows that contradict", table(ROW, ROW.replace("12.5", "99")), r"t\.csv:3: .*t\.csv:2"),
    (
        "a pose that is not a number",
        table(ROW.replace("none,1,", "none,1.5,")),
        r"t\.csv:2: pose: 1.5 is not an integer",
    ),
    (
        "a label that means bare",
        table(ROW.replace("none", "None")),
        r"t\.csv:2: load 'None' denotes the unloaded arm: write none",
    ),
    ("an empty label", table(ROW.replace("none", "")), r"t\.csv:2: load: a label is needed"),
    ("an empty file", together(text("", "t.csv"), cell()), r"t\.csv:1: the file is empty; a header line"),
    ("bytes that are no text", together(text(b"load,\xff\xfe\n", "t.csv"), cell()), r"t\.csv: not UTF-8 text.*save"),
    ("a recording by another name", together(text(b"\x89HDF\r\n\x1a\n" * 9, "t.csv"), cell()), r"t\.csv"),
    (
        "a table of other axes",
        together(table("none,1,0.1,0.2,1", header="load,pose,q1_rad,q2_rad,tau1_nm")),
        "2 axes.*name",
    ),
    ("a table that is not there", cell(), r"t\.csv: cannot be read: No such file"),
    ("a folder for a table", together(cell(), lambda folder: (folder / "t.csv").mkdir()), "t.csv.*is a directory"),
]

RECORDING = ("estimate", "run.h5")
BESIDE = (*RECORDING, "--cell", "cell.toml")
RECORDINGS = [
    ("not there", RECORDING, r"run\.h5: there is no such file", nothing),
    ("cut off", RECORDING, r"run\.h5", cut),
    ("a bit turned", RECORDING, r"run\.h5", flipped),
    ("text", RECORDING, r"run\.h5", text("hello", "run.h5")),
    ("empty", RECORDING, r"run\.h5", text("", "run.h5")),
    (
        "of another cell",
        BESIDE,
        r"run\.h5: was recorded with cell 'small', this is cell 'other'; name the cell",
        of_cell("small", "other"),
    ),
    ("of another arm", BESIDE, r"run\.h5: contains no arm 'left' but 'main'; name", of_cell("main", "left")),
    (
        "wired otherwise",
        BESIDE,
        r"run\.h5: J1 was recorded with node_id 1, the cell says 9; name",
        together(recording, cell(("node_id = 1", "node_id = 9"))),
    ),
    (
        "of another robot",
        (*RECORDING, "--robot", str(EXAMPLES / "large" / "robot.urdf")),
        r"run\.h5: was recorded with robot .*name",
        recording,
    ),
    (
        "other drives",
        (*RECORDING, "b.h5"),
        r"b\.h5: J1 has the drive with serial number",
        lambda folder: (recording(folder, serial=100), recording(folder, "b.h5", serial=200)),
    ),
]

#: Beside a measured table.
OPTIONS = [
    ("no robot", ("estimate", "t.csv"), 3, "give --robot R.urdf or --cell CELL"),
    ("a known load in millimetres", (*ESTIMATE, "--known", "a=2,0,0,110"), 3, "write a=2,0,0,0.11"),
    ("a known load below zero", (*ESTIMATE, "--known", "a=-2,0,0,0.1"), 3, "--known a=-2.*expected"),
    ("a known load that is not there", (*ESTIMATE, "--known", "a=2,0,0,0.1"), 3, r"--known a: no row carries.*t\.csv"),
    ("a method that is none", (*ESTIMATE, "--method", "magic"), 2, "'magic' is not one of"),
    ("an effect that is none", ("diagnose", "t.csv", "--only", "ghost"), 2, "'ghost' is not an effect; choose from"),
    ("a bare file that is not there", (*ESTIMATE, "--bare", "b.json"), 3, r"b\.json: cannot be read"),
    (
        "two arms, none named",
        ("estimate", "t.csv", "--cell", str(EXAMPLES / "pair" / "cell.toml")),
        3,
        "no arm was named; it has .*: name one by --arm",
    ),
]

#: Beside the small cell.
COMMANDS = [
    ("option: an empty load", (*RECORD, ""), 2, "'' is not a label: write"),
    ("option: a load called bare", (*RECORD, "bare"), 2, "'bare' denotes the unloaded arm: write none"),
    ("option: an arm that is not there", (*PLAN, "--arm", "third"), 3, "there is no arm 'third'; it has main"),
    ("motion: an uninformative period", (*PLAN, "--moving", "--period", "2"), 5, "a period of 2 s: use 5 to 20 s"),
    ("motion: one period", (*PLAN, "--moving", "--periods", "1"), 5, "1 periods: use 2 to 100"),
    (
        "motion: a purpose that is none",
        (*PLAN, "--moving", "--for", "weight"),
        2,
        "'weight' is none of load, friction, rotor",
    ),
    ("motion: a purpose of rest poses", (*PLAN, "--for", "load"), 2, "need --moving"),
    ("motion: rest poses counted", (*PLAN, "--moving", "--poses", "5"), 2, "give one of them"),
    ("motion: a plan that is not there", (*RECORD, "none", "--plan", "p.json"), 3, r"p\.json: cannot be read"),
    (
        "motion: with a rest pose",
        (*RECORD, "none", "--plan", "p.json", "--poses", "0,0,0,0,0,0"),
        2,
        "give one of them",
    ),
    ("until: no unit", (*UNTIL, "mass=1"), 3, r"mass=1 lacks its unit \(kg, g, %\)"),
    ("until: unknown quantity", (*UNTIL, "weight=1%"), 3, "must be mass=.. or com=.."),
    ("until: an exact mass", (*UNTIL, "mass=0%"), 3, "a half width must be positive"),
    ("until: a load of an arm that is not known", (*UNTIL, "mass=1%"), 3, "measure the unloaded arm first"),
    (
        "until: the unloaded arm",
        (*RECORD, "none", "--until", "mass=1%"),
        3,
        "is the unloaded arm, for which no mass is estimated",
    ),
    ("thermal: as short as it can", (*THERMAL, "--until", "mass=1%"), 2, "give one of them"),
    ("thermal: a warm-up without it", (*THERMAL[:2], "--warm-up", "5"), 2, "--warm-up needs --thermal"),
    ("thermal: the unloaded arm as a load", (*THERMAL, "--load", "none"), 2, "give only the loads"),
    (
        "thermal: a load twice",
        (*THERMAL, "--load", "a", "--load", "a"),
        2,
        "--load a is given twice: give each load once",
    ),
    ("output: a cell that is there", ("cell", "new", "-o", "cell.toml"), 3, r"cell\.toml exists and is not replaced"),
    (
        "bus: one that the cell does not have",
        (*CHECK, "z=virtual:x"),
        3,
        "the cell has no bus 'z'; give NAME=SPEC;NAME=SPEC with a",
    ),
    (
        "live: bus that lives in one program",
        ("live", "cell.toml", "--bus", "virtual:x"),
        3,
        "virtual:x, which lives in one program alone.*give the command that moves --live",
    ),
    ("live: constants, not there", LIVE, 3, r"x\.h5.*(no such file|cannot be read|does not exist)"),
]

#: Beside a result.
RESULTS = [
    ("a mass below zero", EXPORT, 6, "load 'a' has a mass of -6 kg: .*measure again", {"mass_kg": -6.0}),
    ("a place far away", EXPORT, 6, "110 m off, beyond 5 m: .*measure it again", {"com_m": [0, 0, 110.0]}),
    ("a load that is not there", (*EXPORT, "--load", "b"), 3, "load 'b' is not in the result; it holds: a", {}),
    ("no flange for a controller", (*EXPORT[:3], "ur"), 3, "add flange_xyz_m", {}),
    ("a word for a mass", REPORT, 3, r"out\.json: loads\[0\]\.mass_kg: expected a number", {"mass_kg": "two"}),
]

#: Of various commands, with files of their own.
OTHERS = [
    ("cell: not there", ("plan", "no.toml"), 3, r"no\.toml: cannot be read", nothing),
    ("cell: bytes", PLAN, 3, r"cell\.toml: cannot be read.*utf-8", text(b"\xff\xfe\x00", "cell.toml")),
    ("cell: a folder", PLAN, 2, "is a directory", lambda folder: (folder / "cell.toml").mkdir()),
    (
        "cell: several mistakes",
        PLAN,
        3,
        "line 9: pacing.*J1: gear_ratio.*J4: torque_limit",
        cell(('"real"', '"fast"'), (RATIO, "101"), ("torque_limit_nm = 70", "torque_limit_nm = -70")),
    ),
    (
        "cell: a profile that is not there",
        (*CHECK, UNUSED_BUS),
        3,
        "unknown' cannot be read.*one of .*generic-cia402",
        cell(('"generic-cia402"', '"unknown"')),
    ),
    (
        "cell: a speed in degrees above the URDF's, on a wrist joint",
        (*CHECK, UNUSED_BUS),
        3,
        "arm 'main', axis 4: speed_limit_rad_s 15 is above the velocity 5 rad/s .*lower it",
        cell(("speed_limit_rad_s = 1.2", "speed_limit_rad_s = 15")),
    ),
    ("robot: no XML", PLAN, 3, r"robot\.urdf", together(cell(), text("<robot", "robot.urdf"))),
    ("robot: no joints", PLAN, 3, r"robot\.urdf", together(cell(), text('<robot name="a"/>', "robot.urdf"))),
    (
        "profile: unknown key",
        SHOW,
        3,
        r"mine\.toml line \d+, \[torque\]: .*write filter_s",
        profile("filter_s = 0.001", "filter_z = 1"),
    ),
    (
        "profile: wrong word",
        SHOW,
        3,
        r'line \d+, \[torque.object\]: .*write type = "u8"',
        profile('type = "i16"', 'type = "i24"'),
    ),
    ("profile: no TOML", SHOW, 3, r"mine\.toml line 1: not valid TOML", text("name = ", "mine.toml")),
    (
        "data: of no known kind",
        ("estimate", "t.txt"),
        3,
        r"t\.txt: neither a recording \(\.h5\) nor",
        text("x", "t.txt"),
    ),
    (
        "motion: a plan of one's own",
        (*RECORD, "none", "--plan", "p.json"),
        3,
        r"p\.json: has no sha256, .*write it again with servo-gateway plan",
        together(cell(), text('{"schema": 1, "kind": "moving_plan"}', "p.json")),
    ),
    ("result: not there", REPORT, 3, r"out\.json: cannot be read", nothing),
    ("result: no JSON", REPORT, 3, r"out\.json:1: not valid JSON", text("{", "out.json")),
    ("result: another version", REPORT, 3, r"out\.json: schema: this version reads", result({"schema": 9})),
    (
        "output: a table of measured values that is there",
        (*ESTIMATE, "--json", "mine.csv"),
        3,
        r"mine\.csv exists and is not replaced",
        together(table(), text("mine", "mine.csv")),
    ),
    (
        "output: the file that is read",
        (*ESTIMATE, "--bare", "bare.json", "--json", "bare.json"),
        2,
        r"bare\.json is used for another argument",
        together(table(), text("{}", "bare.json")),
    ),
    (
        "output: two results in one file",
        (*ESTIMATE, "--json", "o.json", "--archive", "o.json"),
        2,
        r"o\.json is used for another argument",
        table(),
    ),
    (
        "output: a recording that is there",
        (*RECORD, "none", "--yes"),
        3,
        r"r\.h5 exists; continue it with --resume, or choose another name",
        together(cell(), text("mine", "r.h5")),
    ),
    ("output: below a file", (*REPORT[:3], "out.json/r.html"), 3, r"out\.json: .*check the path", result()),
    ("answers: unknown key", ANSWERS, 3, "line 1: unknown key colour", text("colour = 3\n", "a.toml")),
    ("answers: no TOML", ANSWERS, 3, r"a\.toml line 2: not valid TOML", text("# a\nratio = \n", "a.toml")),
    ("EDS: not there", (*DRAFT, "no.eds"), 3, r"no\.eds", nothing),
    ("EDS: no EDS", (*DRAFT, "x.eds"), 3, r"x\.eds", text("hello", "x.eds")),
    ("live: constants, no recording", LIVE, 3, r"x\.h5", together(cell(), text("no", "x.h5"))),
    ("bus: no SPEC", ("scan", "--bus", "can0"), 4, "can0.*INTERFACE:CHANNEL", nothing),
    (
        "bus: no drive there",
        ("scan", "--bus", UNUSED_BUS, "--listen", "0.05"),
        4,
        "no node answered; check supply, wiring, termination, bit rate",
        nothing,
    ),
]

DRIVERS = [
    ("kvaser", "Kvaser's driver"),
    ("slcan", "pip install pyserial"),
    ("pcan", "PCAN-Basic"),
    ("gs_usb", "pip install gs_usb"),
    ("ixxat", "Ixxat's driver"),
    ("nonsense", "check the name of the interface"),
]

KINDS: list[Kind] = [
    *(Kind(f"cell: {name}", PLAN, 3, f"{where}.*{say}", cell(change)) for name, change, where, say in CELLS),
    *(Kind(f"table: {name}", ESTIMATE, 2 if "folder" in name else 3, says, make) for name, make, says in TABLES),
    *(
        Kind(f"robot: {name}, {words[0]}", words, 3, says, make)
        for name, says, make in ROBOTS
        for words in (PLAN, ESTIMATE, ("diagnose", *ESTIMATE[1:]))
    ),
    *(Kind(f"recording: {name}", words, 3, says, make) for name, words, says, make in RECORDINGS),
    *(Kind(f"option: {name}", words, code, says, table()) for name, words, code, says in OPTIONS),
    *(Kind(name, words, code, says, cell()) for name, words, code, says in COMMANDS),
    *(Kind(f"result: {name}", words, code, says, result(**load)) for name, words, code, says, load in RESULTS),
    *(Kind(*row) for row in OTHERS),
    *(
        Kind(
            f"bus: {name} without its driver",
            ("scan", "--bus", f"{name}:0"),
            4,
            f"bus {name}:0.* cannot be opened.*{say}",
        )
        for name, say in DRIVERS
    ),
    Kind("disk: full, report", REPORT, 3, r"r\.html: .*No space left.*free some space", result(), full_disk),
    Kind("disk: full, export", (*EXPORT, "-o", "o.json"), 3, r"o\.json: .*No space left.*free", result(), full_disk),
    Kind(
        "live: port that is taken",
        ("live", "cell.toml", "--port", str(TAKEN_PORT)),
        3,
        rf"--port {TAKEN_PORT}: Address already in use; choose another one, or omit --port",
        cell(),
        port_taken,
    ),
]


# -- how it is judged --------------------------------------------------------------------------------------------------


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "state" not in path.parts
    }


def complaints(kind: Kind, folder: Path) -> list[str]:
    """Run a kind in an empty folder: what is not as it should be."""
    kind.make(folder)
    before, here = _files(folder), Path.cwd()
    os.chdir(folder)
    try:
        with mock.patch.dict(os.environ, XDG_STATE_HOME=str(folder / "state")):
            if kind.during is mock.DEFAULT:
                done = CliRunner().invoke(program, kind.arguments)
            else:
                with kind.during():  # type: ignore[attr-defined]
                    done = CliRunner().invoke(program, kind.arguments)
    finally:
        os.chdir(here)
    message = done.stderr
    return [
        *([] if done.exit_code == kind.code else [f"exit code {done.exit_code}, not {kind.code}"]),
        *([] if re.search(kind.says, message, re.DOTALL) else [f"does not say {kind.says!r}"]),
        *(f"says {word!r}" for word in ("defect", "Traceback", "pydantic", "Input should") if word in done.output),
        *([f"{len(message.splitlines())} lines"] if len(message.splitlines()) > MOST_LINES else []),
        *([] if _files(folder) == before else ["files are lost, changed or left over"]),
        *([message] if message else ["says nothing"]),
    ]


def wrong(kind: Kind) -> list[str]:
    """Complaints about a kind, run in a folder of its own; the last one is what it said. Empty if there are none."""
    with tempfile.TemporaryDirectory() as folder:
        found = complaints(kind, Path(folder))
    return found if len(found) > 1 or found == ["says nothing"] else []


def main(names: Sequence[str]) -> int:
    """Print which kinds are not answered as they should be, and how many are; exit 1 unless all are."""
    from tests.data.slips import SLIPS  # which is made of this content

    kinds = [kind for kind in (*KINDS, *SLIPS) if not names or any(name in kind.name for name in names)]
    failed = {kind.name: found for kind in kinds if (found := wrong(kind))}
    for name, found in failed.items():
        sys.stdout.write(f"{name}: {'; '.join(found)}\n")
    sys.stdout.write(f"wrong inputs answered as they should be: {len(kinds) - len(failed)} of {len(kinds)} kinds\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
