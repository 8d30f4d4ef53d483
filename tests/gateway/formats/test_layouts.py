"""Layouts of text logs: each holds the same numbers, and gives the same table, or a sentence with a remedy."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.formats.log_map import read_map, ready_maps, unit_named
from tests.data.log_columns import COLUMNS

ROWS, STEP_S = 60, 0.01
NAMES = ["t", "q1", "q2", "m1", "m2"]
MAP = f"""axes = 2
[load]
label = "a"
[time]
column = "t"
[motion]
cutoff_hz = 30
{COLUMNS}"""


def numbers() -> np.ndarray:
    """Time, two angles, two torques (n, 5)."""
    time_s = np.arange(ROWS) * STEP_S
    return np.column_stack(
        [time_s, np.sin(time_s), np.cos(2 * time_s), 1500.25 * np.cos(time_s), 12.5 + 1234.5 * time_s]
    )


def text(form: Callable[[float], str] = repr, separator: str = ",", end: str = "\n") -> str:
    rows = [NAMES, *([form(value) for value in row] for row in numbers().tolist())]
    return "".join(separator.join(row) + end for row in rows)


def comma(value: float) -> str:
    return f"{value:.6f}".replace(".", ",")


def european(value: float) -> str:
    return f"{value:,.6f}".translate(str.maketrans(",.", ".,"))


def iso(first: str, zone: str) -> Callable[[str], str]:
    """The time column as ISO 8601."""

    def change(log: str) -> str:
        lines = log.splitlines()
        rows = [line.split(",") for line in lines[1:]]
        seconds = [float(row[0]) for row in rows]
        stamps = [f"{first}:{58 + at:09.6f}{zone}" if at < 2 else "" for at in seconds]
        return "\n".join([lines[0], *(",".join([at, *row[1:]]) for at, row in zip(stamps, rows, strict=True))])

    return change


HEAD, *REST = text().splitlines()
LAYOUTS: dict[str, str | bytes] = {
    "semicolons": text(separator=";"),
    "tabs": text(separator="\t"),
    "blanks": text(separator="   "),
    "separator at the end": text(end=",\n"),
    "separator at the end of the rows": "\n".join([HEAD, *(line + ",," for line in REST)]),
    "decimal commas": text(comma, ";"),
    "decimal commas and tabs": text(comma, "\t"),
    "thousands and decimal commas": text(european, ";"),
    "thousands in quotes": text(lambda value: f'"{value:,.6f}"', ";"),
    "thousands after the first lines": text(lambda value: european(value) if value < 1275 else comma(value), ";"),
    "units below": "\n".join([HEAD, "s,rad,rad,Nm,Nm", *REST]),
    "units in brackets below": "\n".join([HEAD, "[s],[rad],[rad],[Nm],[Nm]", *REST]),
    "descriptions and units below": "\n".join([HEAD, "time,axis one,axis two,torque,torque", "s,rad,rad,Nm,Nm", *REST]),
    "lines above": "\n".join(["Trace of 12 May", "", "Robot;12", HEAD, *REST]),
    "comments": "\n".join(["# trace", "// made by x", HEAD, "# begin", *REST[:30], "% half", *REST[30:], "# end"]),
    "header in a comment": "\n".join([f"# {HEAD}", *REST]),
    "byte order mark": "\ufeff".encode() + text().encode(),
    "UTF-16": text().encode("utf-16"),
    "UTF-16 without a mark": text().encode("utf-16-le"),
    "UTF-16, the other way round": b"\xfe\xff" + text(comma, ";").encode("utf-16-be"),
    "carriage returns": text(end="\r"),
    "Windows": text(end="\r\n"),
    "ISO time": iso("2026-05-12T23:59", "+02:00")(text()),
    "ISO time with a blank": iso("2026-05-12 08:00", "")(text()),
    "time of day": iso("08:00", "")(text()),
    "further columns": "\n".join([f"{HEAD},state", *(f"{line},RUN" for line in REST)]),
}  # fmt: skip


def imported(folder: Path, log: str | bytes, column_map: str = MAP, *words: str):
    (folder / "log.csv").write_bytes(log if isinstance(log, bytes) else log.encode())
    (folder / "map.toml").write_text(column_map)
    command = ["import", folder / "log.csv", "--map", folder / "map.toml", "-o", folder / "table.csv", *words]
    return CliRunner().invoke(main, list(map(str, command)))


@pytest.mark.parametrize("log", LAYOUTS.values(), ids=LAYOUTS)
def test_every_layout_gives_the_same_table(tmp_path, log):
    done = imported(tmp_path, log)
    assert done.exit_code == 0, done.output
    with (tmp_path / "table.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    found = np.array(
        [[float(row[name]) for name in ("time_s", "q1_rad", "q2_rad", "tau1_nm", "tau2_nm")] for row in table]
    )
    assert found == pytest.approx(numbers(), abs=2e-6)


def wider(name: str, value: str) -> str:
    """The fifth row with another cell."""
    cells = REST[3].split(",")
    cells[NAMES.index(name)] = value
    return "\n".join([HEAD, *REST[:3], ",".join(cells), *REST[4:]])


@pytest.mark.parametrize(
    ("log", "says"),
    [
        (text(lambda value: f"{1 + value / 100:.3f}".replace(".", ","), ";"), "log.csv:2: '1,000' is 1.0 or 1000:"),
        (text(comma, ","), "log.csv:2: 10 cells where the header names 5 columns; is the comma also the decimal mark?"),
        ("\n".join([HEAD, "ms,rad,rad,Nm,Nm", *REST]), "log.csv:2: t: the log says 'ms', the map says s; write unit"),
        ("\n".join([HEAD, "s,deg,deg,Nm,Nm", *REST]), "log.csv:2: q1: the log says 'deg', the map says rad"),
        ("\n".join([HEAD, "s,rad,rad,A,A", *REST]), "log.csv:2: m1: the log says 'A', the map says Nm"),
        (wider("m1", "1.234,5"), "log.csv:5: "),
        (wider("m1", "nan"), "log.csv:5: m1: 'nan' is not a finite number"),
        (text().replace("q2", "joint2"), "log.csv:1: column 'q2', which the map names, is missing; the log holds"),
        ("A trace\n\n" + text(separator=";").replace("q2", "joint2"), "log.csv:3: column 'q2', which the map names,"),
        (text().encode("utf-16")[:-1], "log.csv: not UTF-16 text at byte"),
        (iso("2026-05-12T08:00", "")(text()).replace("00:58.05", "00:58;05"), "log.csv:7: t: "),
        (HEAD + "\ns,rad,rad,Nm,Nm\n", "log.csv:1: the log has a header but no row"),
    ],
)  # fmt: skip
def test_a_layout_that_is_not_clear_is_refused_with_line_and_remedy(tmp_path, log, says):
    done = imported(tmp_path, log)
    assert (done.exit_code, (tmp_path / "table.csv").exists()) == (3, False), done.output
    assert says in " ".join(done.stderr.split())


def test_a_unit_in_the_name_of_a_column_is_held_against_the_map(tmp_path):
    done = imported(tmp_path, text().replace("q1,q2", "q1 [deg],q2 [deg]"), MAP.replace('"q{}"', '"q{} [deg]"'))
    assert done.exit_code == 3
    assert "q1 [deg]: the log says 'deg', the map says rad" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("said", "unit"),
    [("[Nm]", "Nm"), ("mNm", "mNm"), ("MNm", None), ("(deg/s)", "deg/s"), ("\N{DEGREE SIGN}", "deg"), ("mA", "mA"),
     ("Ampere", "A"), ("A", "A"), ("a", None), ("1", None), ("target", None), ("rad/s^2", "rad/s2")],
)  # fmt: skip
def test_units_as_logs_spell_them(said, unit):
    assert unit_named(said) == unit


def test_thousands_of_the_map(tmp_path):
    log = text(lambda value: f"{value:,.6f}".replace(",", "\N{NARROW NO-BREAK SPACE}"), ";")
    done = imported(tmp_path, log, MAP.replace("[load]", "[log]\nthousands = ' '\n[load]"))
    assert done.exit_code == 0, done.output
    assert "1500.25" in (tmp_path / "table.csv").read_text()


# -- ready maps --------------------------------------------------------------------------------------------------------

READY = {
    "ur-rtde": ("timestamp", "actual_q_{}", "actual_current_{}", 0, 1.0, 1.0, "i1_a"),
    "kuka-rsi": ("IPOC", "AIPos.A{}", "GearTorque.A{}", 1, 1e3, 180 / math.pi, "tau1_nm"),
    "abb-egm": ("header.tm", "feedBack.joints.joints.{}", "testSignals.signals.{}", 0, 1e3, 180 / math.pi, "taum1_nm"),
}


@pytest.mark.parametrize("name", READY)
def test_a_ready_map_reads_its_layout(tmp_path, name):
    time, angle, torque, first, time_factor, angle_factor, target = READY[name]
    axes = range(first, first + 6)
    lines = [";".join([time, *(angle.format(axis) for axis in axes), *(torque.format(axis) for axis in axes)])]
    for row in range(40):
        q = [math.sin(0.05 * row + axis) for axis in range(6)]
        cells = [4711.0 + time_factor * 0.008 * row, *(angle_factor * each for each in q), *range(6)]
        lines.append(";".join(map(repr, cells)))
    (tmp_path / "log.csv").write_text("\n".join(lines))
    words = ["import", tmp_path / "log.csv", "--map", name, "--load", "gripper", "-o", tmp_path / "table.csv"]
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == 0, done.output
    with (tmp_path / "table.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert {row["load"] for row in table} == {"gripper"}
    assert [float(row["time_s"]) for row in table] == pytest.approx(0.008 * np.arange(40), abs=1e-9)
    assert [float(row["q6_rad"]) for row in table] == pytest.approx([math.sin(0.05 * row + 5) for row in range(40)])
    assert float(table[0][target]) == 0.0
    assert "qd1_rad_s" in table[0]


def test_every_ready_map_is_valid_and_named_in_the_help():
    said = " ".join(CliRunner().invoke(main, ["import", "--help"]).output.split()).replace("- ", "-")
    for name in ready_maps():
        assert read_map(Path(name)).axes == 6
        assert name in said


def test_a_map_that_is_neither_a_file_nor_ready_is_named(tmp_path):
    (tmp_path / "log.csv").write_text(text())
    done = CliRunner().invoke(main, ["import", str(tmp_path / "log.csv"), "--map", "ur", "-o", str(tmp_path / "t.csv")])
    assert done.exit_code == 3
    assert "no ready map (abb-egm, kuka-rsi, ros-joint-states, ur-rtde)" in " ".join(done.stderr.split())


# -- the preview -------------------------------------------------------------------------------------------------------


def previewed(folder: Path, log: str, column_map: str = MAP) -> str:
    (folder / "log.csv").write_text(log)
    (folder / "map.toml").write_text(column_map)
    words = ["import", folder / "log.csv", "--map", folder / "map.toml", "--dry-run"]
    done = CliRunner(env={"COLUMNS": "200"}).invoke(main, list(map(str, words)))
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in folder.iterdir()) == ["log.csv", "map.toml"]
    return " ".join(done.stdout.split())


def test_a_preview_shows_rows_units_and_ranges_and_writes_nothing(tmp_path):
    said = previewed(tmp_path, text())
    assert "q1_rad q1 [rad] 0 0.0099998 0.019999 0 0.5" in said
    assert "60 rows, 0.59 s, load a" in said
    assert "steps of 10 ms" in said
    assert "speeds are taken on the even steps" in said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda cells: [*cells[:3], "5.0", cells[4]], "never changes"),
        (lambda cells: [cells[0], str(20 * float(cells[1])), *cells[2:]], "range above one revolution"),
        (lambda cells: [*cells[:3], str(1e3 * float(cells[3])), cells[4]], "is the unit mNm?"),
    ],
)
def test_a_preview_says_what_looks_wrong(tmp_path, change, says):
    log = "\n".join([HEAD, *(",".join(change(line.split(","))) for line in REST)])
    assert says in previewed(tmp_path, log)


@pytest.mark.parametrize(("factor", "says"), [(57.3, "57.3 times the change of the angle: another unit?"),
                                              (-1.0, "-1 times the change of the angle: the other sign?"),
                                              (1.0, None)])  # fmt: skip
def test_a_preview_holds_speeds_against_angles(tmp_path, factor, says):
    log = "\n".join([f"{HEAD},v1,v2", *(f"{line},{factor * math.cos(float(line.split(',')[0]))},0.5" for line in REST)])
    column_map = MAP + '[[column]]\nlog = "v{}"\ntable = "qd{}_rad_s"\nunit = "rad/s"\n'
    said = previewed(tmp_path, log, column_map)
    assert (says or "qd1_rad_s v1 [rad/s] 1 ") in said


def test_a_preview_says_that_no_load_is_named(tmp_path):
    assert "every row is of the unloaded arm" in previewed(tmp_path, text(), MAP.replace('[load]\nlabel = "a"\n', ""))
