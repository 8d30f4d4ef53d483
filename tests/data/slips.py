"""Slips of people who know their arm and not the program: units, labels, frames, loads mounted at another time.

None of them may end with exit 0 and a wrong load. They are rows of the table `tests.data.wrong_inputs`.
"""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.data.mounted import Payload, table_text
from tests.data.moving_arm import URDF
from tests.data.wrong_inputs import (
    AXIS,
    EXAMPLES,
    EXPORT,
    LINE,
    PLAN,
    REPORT,
    RESULT,
    Kind,
    cell,
    multiplied,
    result,
    robot,
    text,
    together,
)

Make = Callable[[Path], object]
Row = dict[str, str]
LOAD, HEAVIER = (5.0, 0.02, 0.03, 0.11), (7.3, 0.02, 0.03, 0.11)
#: Payload of each pose.
BARE: list[Payload] = [None] * 8
LOADED: list[Payload] = [LOAD] * 8
MODEL = ("t.csv", "--robot", "robot.urdf", "--inertials", "prior:0.05")
BOTH = ("estimate", "diagnose")
ESTIMATE = "estimate"
#: Where the refusal comes from the units and bands of the table, a search for one effect is enough.
QUICK = (ESTIMATE, "diagnose --only base_tilt")


# -- a measured table of the small arm under a load of 5 kg, with a slip -----------------------------------------------


def measured(
    change: Callable[[int, Row], Row | None] | None = None,
    bare: Sequence[Payload] = tuple(BARE),
    loaded: Sequence[Payload] = tuple(LOADED),
) -> Make:
    """A table of these payloads, each row changed; None leaves it out."""

    def make(folder: Path) -> None:
        content = table_text(1, [("none", bare), ("tool", loaded)])
        if change is not None:
            rows = [change(number, row) for number, row in enumerate(csv.DictReader(io.StringIO(content)))]
            kept = [row for row in rows if row is not None]
            stream = io.StringIO()
            writer = csv.DictWriter(stream, kept[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(kept)
            content = stream.getvalue()
        (folder / "t.csv").write_text(content)
        (folder / "robot.urdf").write_text(URDF)

    return make


def scaled(column: str, factor: float, axes: Sequence[int] = range(1, 7)) -> Callable[[int, Row], Row]:
    """A column of each axis times a factor."""
    return lambda _, row: row | {column % axis: repr(factor * float(row[column % axis])) for axis in axes}


def where(column: str, *values: str) -> Callable[[int, Row], Row | None]:
    """Rows with one of these values alone."""
    return lambda _, row: row if row[column] in values else None


def swapped(_: int, row: Row) -> Row:
    """Labels of the unloaded and the loaded run in each other's place."""
    return row | {"load": "tool" if row["load"] == "none" else "none"}


def turned(_: int, row: Row) -> Row:
    """Columns of the joints that begin at the second one."""
    return row | {f"q{axis}_rad": row[f"q{axis % 6 + 1}_rad"] for axis in range(1, 7)}


def at(row_number: int, column: str, value: str) -> Callable[[int, Row], Row]:
    """One cell."""
    return lambda number, row: row | ({column: value} if number == row_number else {})


CONTRADICT = r"load tool: refused: its rows contradict each other: "
BEYOND = r"refused: \S+ kg is beyond 33\.75 kg"
FOREIGN = r"the torques contradict the robot model: "
SMALL = r"t\.csv: the torques are [\d.]+ % of the gravity torque of the links: they may be in kNm, of the motors"
REVERSED = "torque sign is reversed"
#: Name, commands, exit code, what is said, table.
TABLES: list[tuple[str, Sequence[str], int, str, Make]] = [
    ("torque in mNm", QUICK, 7, BEYOND + ".*check the units", measured(scaled("tau%d_nm", 1e3))),
    ("torque in Ncm", QUICK, 7, BEYOND + ".*check the units", measured(scaled("tau%d_nm", 100.0))),
    ("torque in kNm", BOTH, 3, SMALL, measured(scaled("tau%d_nm", 1e-3))),
    ("torque of the motors", BOTH, 3, SMALL, measured(scaled("tau%d_nm", 1 / 120))),
    ("all torques reversed", [ESTIMATE], 7, FOREIGN, measured(scaled("tau%d_nm", -1.0))),
    ("torque of J2 reversed", [ESTIMATE], 7, "J2: " + REVERSED, measured(scaled("tau%d_nm", -1.0, [2]))),
    ("all approaches reversed", QUICK, 7, f"J1, J2.*{REVERSED}, or the approach", measured(scaled("dir%d", -1.0))),
    ("approach of J3 reversed", QUICK, 7, f"J3: {REVERSED}, or the approach", measured(scaled("dir%d", -1.0, [3]))),
    (
        "an approach of 2",
        BOTH,
        3,
        r"t\.csv:2: dir1: -2 is not one of -1, 0 \(unknown\), 1",
        measured(scaled("dir%d", 2.0)),
    ),
    ("angles in mrad", BOTH, 3, r"t\.csv:2: q1_rad = .*in radians", measured(scaled("q%d_rad", 1e3))),
    ("angles in turns", [ESTIMATE], 7, FOREIGN, measured(scaled("q%d_rad", 0.159155))),
    ("joints that begin at the second", [ESTIMATE], 7, FOREIGN, measured(turned)),
    ("unloaded and loaded swapped", QUICK, 7, FOREIGN, measured(swapped)),
    ("one posture", BOTH, 6, "measured in one posture: .*add at least one posture", measured(where("pose", "1"))),
    ("a time that is none", BOTH, 3, r"t\.csv:5: time_s: 'nan' is not a finite", measured(at(3, "time_s", "nan"))),
    ("a label that controls a terminal", BOTH, 3, r"t\.csv:4: load: .*printable", measured(at(2, "load", "a\x1b[31m"))),
    ("mounted with delay", BOTH, 7, CONTRADICT, measured(loaded=[None] * 3 + [LOAD] * 5)),
    ("taken off early", BOTH, 7, CONTRADICT, measured(loaded=[LOAD] * 5 + [None] * 3)),
    (
        "two loads of one label",
        BOTH,
        7,
        CONTRADICT + ".*two loads have one label",
        measured(loaded=[LOAD] * 4 + [HEAVIER] * 4),
    ),
    (
        "mounted in the unloaded run",
        BOTH,
        7,
        CONTRADICT + ".*during the unloaded run",
        measured(bare=[None] * 4 + [LOAD] * 4),
    ),
]

KNOWN = [
    ("in grams", "tool=5000,0.02,0.03,0.11", r"5000 kg is beyond 33\.75 kg .*grams\? that is 5 kg"),
    ("with a centre in millimetres", "tool=5,20,30,110", "millimetres; write tool=5,0.02,0.03,0.11"),
    ("with a centre beyond the arm", "tool=5,0,0,2.5", "centre of gravity 2.5 m off, beyond .*millimetres"),
    ("without z", "tool=5,0.02,0.03", "expected LABEL=MASS,X,Y,Z"),
    ("in words", "tool=five,0,0,0", "expected LABEL=MASS,X,Y,Z"),
    ("without end", "tool=inf,0,0,0", "expected LABEL=MASS,X,Y,Z"),
    ("with decimal commas", "tool=5,2;0,02;0,03;0,11", "expected LABEL=MASS,X,Y,Z"),
    ("in the flange without a flange", "tool=5,flange=0,0,0.1", "the flange is not known: give --cell"),
    ("in a frame of a controller", "tool=5,tcp=0,0,0.1", "frame 'tcp' is not known: write link_6= or flange="),
    ("of the unloaded arm", "none=5,0,0,0.1", "is the unloaded arm: name the load that is known"),
    ("without a label", "=5,0,0,0.1", "expected LABEL=MASS,X,Y,Z"),
]

OPTIONS = [
    ("a trust in percent", ("--torque-gain", "prior:5"), "below 0.3, such as 0.03"),
    ("a trust below zero", ("--torque-gain", "prior:-1"), "below 0.3, such as 0.03"),
    ("a trust that is none", ("--inertials", "exakt"), "use a relative standard deviation such as 0.05"),
    ("a last link that is none", ("--tip", "link_9"), "there is no link 'link_9' for the tip; links are link_6"),
]

# -- files that say something ------------------------------------------------------------------------------------------

RATED = '{ value = 10, source = "datasheet p. 1" }'
CONSTANT = 'value = 0.31, source = "datasheet p. 2"'
CELLS = [
    ("a heaviest load in grams", ("rated_load_kg", "max_load_kg = 10000\nrated_load_kg"), LINE, "write .* = 10"),
    ("a rated load in grams", (RATED, RATED.replace("10", "5000")), LINE, "grams\\? write .*value = 5"),
    ("a rated centre in millimetres", ("[0, 0, 0.12]", "[0, 0, 120]"), LINE, r"millimetres\? write .*\[0, 0, 0.12\]"),
    ("a torque in mNm", ("torque_limit_nm = 420", "torque_limit_nm = 420000"), AXIS, "mNm\\? write .* = 420"),
    ("a speed below zero", ("speed_limit_rad_s = 0.8", "speed_limit_rad_s = -0.8"), AXIS, "must be more than 0"),
    ("an offset that is none", ("zero_offset_rad = 0.0", "zero_offset_rad = nan"), AXIS, "is not a finite number"),
    ("a rotor below zero", ("value = 10.3", "value = -10.3"), AXIS, "must not be negative; omit it"),
    (
        "a constant known to -5 %",
        (CONSTANT, CONSTANT + ", std_percent = -5"),
        AXIS,
        "std_percent = -5 must be at least 0",
    ),
    (
        "a constant known to 300 %",
        (CONSTANT, CONSTANT + ", std_percent = 300"),
        AXIS,
        "less than 30 %, or weigh a load",
    ),
    ("a ratio as the maker writes it", ("value = 120,", 'value = "1:120",'), AXIS, '"1:120" is no number: write value'),
    ("a home in degrees", ("home_rad = [0.0, -0.2", "home_rad = [0.0, -20"), LINE, "joint 2 at -20 rad is outside"),
    (
        "a home of five joints",
        ("0.4, 0.0, 0.3, 0.0]       #", "0.4, 0.0, 0.3]       #"),
        LINE,
        "has 5 numbers but the arm has 6",
    ),
    (
        "a last link that is none",
        ('robot = "robot.urdf"', 'robot = "robot.urdf"\ntip = "link_9"'),
        "robot.urdf",
        "links are link_6",
    ),
    ("a flange of two numbers", ("[0, 0, 0.02]", "[0, 0.02]"), LINE, "write flange_xyz_m = .NUMBER, NUMBER, NUMBER"),
    ("a gravity in cm/s2", ("-9.80665]", "-980.665]"), LINE, r"write \[0, 0, -9.80665\]"),
    ("a column in millimetres", ("column_radius_m = 0.12", "column_radius_m = 120"), LINE, "write .* = 0.12"),
    ("a floor in millimetres", ("floor_m = -0.02", "floor_m = -20.5"), LINE, "write floor_m = -0.0205"),
    ("a bit rate in kbit/s", ("1_000_000", "1000"), LINE, "bitrate_bit_s = 1000 must be at least 10000"),
    ("a SYNC in milliseconds", ("sync_period_s = 0.01", "sync_period_s = 10"), LINE, "must be at most 1: write"),
    ("a profile misspelt", ('"generic-cia402"', '"generic-cia420"'), "generic-cia420", "one of .*generic-cia402"),
]

ROBOTS = [
    ("a mass below zero", 'mass value="', 'mass value="-', "mass -.* is negative; correct it"),
    (
        "a mass with a decimal comma",
        r'mass value="(\d+)\.',
        r'mass value="\1,',
        "is not a number; write a number such as",
    ),
    ("an axis of zeros", 'axis xyz="[^"]*"', 'axis xyz="0 0 0"', "write its direction, such as 0 0 1"),
    ("limits in each other's place", 'lower="-[0-9.]+"', 'lower="9"', "lower 9.0 is above upper .*; swap them"),
    ("a link twice", "</robot>", '<link name="link_6"/></robot>', "two links are named 'link_6'"),
    ("a joint of no type", '_3" type="revolute', '_3" type="revolut', "must be one of revolute, .*; correct it"),
    ("a slide", '_3" type="revolute', '_3" type="prismatic', "only revolute and fixed joints .*--tip link_2"),
    (
        "a loop",
        "</robot>",
        '<joint name="j" type="fixed"><parent link="link_2"/><child link="link_6"/></joint></robot>',
        "the child of two joints, .*remove the joint that closes the loop",
    ),
    ("in centimetres", '(xyz)="([^"]* [^"]*)"', None, "centimetres or millimetres; export it in metres"),
]


def other_robot(content: str) -> Make:
    """The small cell with another file for its robot."""
    return together(cell(), text(content, "robot.urdf"))


def answers(old: str, new: str) -> Make:
    """Answers to the questions of a new cell, one of them changed."""

    def make(folder: Path) -> None:
        content = (EXAMPLES / "own" / "answers.toml").read_text(encoding="utf-8") + 'profile = "generic-cia402"\n'
        assert old in content, old
        (folder / "a.toml").write_text(content.replace(old, new, 1), encoding="utf-8")
        shutil.copy(EXAMPLES / "own" / "arm.urdf", folder)

    return make


ANSWERS = [
    (
        "a heaviest load in grams",
        "max_load_kg = 4",
        "max_load_kg = 4000",
        "line 11: max_load_kg: .*grams\\? that is 4 kg",
    ),
    ("a rated load in grams", "max_load_kg = 4", "rated_load_kg = 4000", "rated_load_kg: .*grams\\? that is 4 kg"),
    ("a torque in mNm", "max_load_kg = 4", "torque_limit_nm = 500000", "mNm\\? write torque_limit_nm = 500"),
    ("ratios upside down", "[101, 101, 80, 60, 60, 50]", "0.0099", "line 4: .*inverted\\? write value = 101"),
    ("five ratios", "[101, 101, 80, 60, 60, 50]", "[101, 101, 80, 60, 60]", "has 5 values but the arm has 6 axes"),
    ("constants in mNm/A", "[0.12, 0.12, 0.11, 0.06, 0.06, 0.05]", "120", "in mNm/A\\? write value = 0.12"),
    ("an efficiency in parts of 1000", "value = 0.82", "value = 820", "line 5: gear_efficiency must be in"),
    ("a sign that is none", "position_sign = [1,", "position_sign = [0,", "line 7: .*position_sign = 1 or -1"),
    ("an offset in degrees", "zero_offset_rad = [0, 0.02", "zero_offset_rad = [0, 90", "degrees\\? write .*1.571"),
    ("a speed in degrees", "speed_limit_rad_s = 1.0", "speed_limit_rad_s = 60", "degrees/s\\? write .* = 1.047"),
    ("a flange in millimetres", "[0, 0, 0.03]", "[0, 0, 30]", r"millimetres\? write .*\[0, 0, 0.03\]"),
    ("a turn of the flange in degrees", "max_load_kg = 4", "flange_rpy_rad = [0, 90, 0]", r"write .*\[0, 1.571, 0\]"),
    ("a mounting that is none", '"floor"', '"table"', "how the arm is mounted: floor, ceiling, or gravity"),
    ("a node id twice", "[11, 12,", "[11, 11,", "node id 11 is used for more than one axis"),
    ("five node ids", "[11, 12, 13, 14, 15, 16]", "[11, 12, 13, 14, 15]", "has 5 values but the arm has 6 axes"),
    ("a key misspelt", "gear_efficiency", "gear_eficiency", "line 5: unknown key gear_eficiency; write gear_eff"),
    ("a robot that is not there", '"arm.urdf"', '"nowhere.urdf"', "name the URDF of the arm; or enter dh"),
]

COMPARE = ("compare", "out.json", "b.json")


def loads(*named: tuple[str, float]) -> Make:
    """A result with loads of these names and masses, in the flange too."""
    of = RESULT["loads"][0] | {"com_flange_m": [0, 0, 0.1]}  # type: ignore[index]
    return result({"loads": [of | {"label": label, "mass_kg": mass_kg} for label, mass_kg in named]})


def and_another(**other: object) -> Make:
    """Two results."""
    return together(result(), text(json.dumps(RESULT | other), "b.json"))


RESULTS: list[tuple[str, Sequence[str], int, str, Make]] = [
    ("a load in grams", EXPORT, 6, "grams\\? that is 5.679 kg; measure it again", result(mass_kg=5679.3)),
    (
        "a load that was refused",
        EXPORT,
        6,
        "no mass to export: its rows contra",
        result(mass_kg=None, refused="its rows contra"),
    ),
    ("a load of 0 kg", EXPORT, 6, "a mass of 0 kg: no load weighs that", result(mass_kg=0.0)),
    ("a load that was not mounted", EXPORT, 6, "no load is detected: mount it", result(mass_kg=0.1, mass_std_kg=0.5)),
    ("a deviation below zero", EXPORT, 3, "a standard deviation below 0", result(mass_std_kg=-1.0)),
    ("a centre of two numbers", EXPORT, 3, "three numbers are needed, got 2", result(com_m=[0, 0])),
    ("that was edited", EXPORT, 3, "was edited: its sha256", result({"sha256": "0" * 64})),
    ("that was edited, in a report", REPORT, 3, "was edited: its sha256", result({"sha256": "0" * 64})),
    ("two loads of one name", EXPORT, 6, "get equal names in the file", loads(("a", 2.0), ("a", 3.0))),
    ("of another robot beside it", COMPARE, 3, "only results of one arm are compared", and_another(robot="other")),
    ("of nothing beside it", COMPARE, 3, "hold no quantity in common", and_another(loads=[])),
    ("for a command misspelt", ("exprot", "out.json"), 2, "Did you mean .*export", result()),
    ("for an option misspelt", ("export", "--fromat", "json", "out.json"), 2, "Did you mean .*--format", result()),
    ("as if it were a recording", ("export", "out.json", "--format", "csv"), 2, "csv is for a recording", result()),
]

SLIPS: list[Kind] = [
    *(
        Kind(f"table: {name}, {command}", (*command.split(), *MODEL), code, said, make)
        for name, commands, code, said, make in TABLES
        for command in commands
    ),
    *(
        Kind(f"known load: {name}, {command}", (command, *MODEL, "--known", known), 3, said, measured())
        for name, known, said in KNOWN
        for command in BOTH
    ),
    *(Kind(f"option: {name}", (ESTIMATE, *MODEL, *words), 3, said, measured()) for name, words, said in OPTIONS),
    *(Kind(f"cell: {name}", PLAN, 3, f"{place}.*{said}", cell(change)) for name, change, place, said in CELLS),
    *(
        Kind(f"robot: {name}", PLAN, 3, r"robot\.urdf: .*" + said, robot(pattern, new or multiplied(100)))
        for name, pattern, new, said in ROBOTS
    ),
    *(
        Kind(f"robot: of {name}", PLAN, 3, r"robot\.urdf: .*" + said, other_robot(content))
        for name, content, said in (
            ("MuJoCo", "<mujoco model='a'><worldbody/></mujoco>", r"this is a MuJoCo model \(MJCF\).*convert it first"),
            ("Gazebo", "<sdf version='1.6'/>", "this is an SDF file, not a URDF; convert it first"),
            ("no XML", "{}", "not readable as XML: .*name the URDF of the arm"),
        )
    ),
    *(
        Kind(
            f"answers: {name}",
            ("cell", "new", "--offline", "--bus", "virtual:x", "--answers", "a.toml", "-o", "c.toml"),
            3,
            said,
            answers(old, new),
        )
        for name, old, new, said in ANSWERS
    ),
    *(Kind(f"result: {name}", tuple(words), code, said, make) for name, words, code, said, make in RESULTS),
]
