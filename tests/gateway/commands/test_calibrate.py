"""calibrate from tables of a simulated arm (torque by pinocchio), and what other commands do with what it stores."""

from __future__ import annotations

import json
import re
import shutil
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cell.calibration import calibration_path, calibration_toml, parse_calibration
from gateway.cell.config import load_cell
from gateway.cli import main
from gateway.data.rows import Table, concatenate
from gateway.data.table import write_csv
from gateway.pipeline.inputs import ModelRequest, collect_inputs
from tests.data.resting_arm import SMALL, two_sided

#: Torque by the constants of the cell file over the true torque, less 1.
GAIN = np.array([0.0, 0.02, 0.04, -0.03, 0.05, 0.01])
WEIGHT, TOOL = (5.0, 0.02, -0.01, 0.10), (8.0, 0.05, 0.02, 0.12)
WEIGHED = "weight=5,0.02,-0.01,0.1"
rows = partial(two_sided, gain=GAIN)


def bracket(**more) -> Table:
    """The unloaded arm, the weight, and the unloaded arm again."""
    blocks = (("none", None, 1, 0.0), ("weight", WEIGHT, 1, 300.0), ("none", None, 1001, 600.0))
    return concatenate([rows(load, carried, first=first, start_s=t, **more) for load, carried, first, t in blocks])


@pytest.fixture
def place(tmp_path):
    """A folder with the small cell, and a function that runs a command in it."""
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(SMALL / name, tmp_path / name)

    def run(*words):
        typed = [
            str(tmp_path / word) if str(word).endswith((".toml", ".csv", ".json")) else str(word) for word in words
        ]
        return CliRunner(env={"COLUMNS": "200"}).invoke(main, typed)

    def table(name: str, content: Table) -> str:
        write_csv(content, tmp_path / name)
        return name

    run.folder, run.table = tmp_path, table
    return run


def calibrated(place, *more, known=WEIGHED, content=None):
    name = place.table("run.csv", bracket() if content is None else content)
    return place("calibrate", "cell.toml", "--known", known, "--from", name, "--json", "-", *more)


def stored(place):
    path = calibration_path(place.folder / "cell.toml")
    return parse_calibration(path.read_text(encoding="utf-8"), "test").of("main")


@pytest.mark.parametrize("known", [WEIGHED, "weight=5"])
def test_the_constants_are_found_and_stored_beside_the_cell(place, known):
    before = (place.folder / "cell.toml").read_bytes()
    done = calibrated(place, "--hold-to-run", known=known)
    assert done.exit_code == 0, done.output
    assert "count as exact" in done.stderr
    axes = {axis["joint"]: axis for axis in json.loads(done.stdout)["axes"]}
    for joint in (2, 3):
        assert axes[joint]["is_known"]
        assert abs(axes[joint]["scale"] * (1 + GAIN[joint - 1]) - 1) < 4 * axes[joint]["std"]
        assert axes[joint]["std"] < 0.01
    assert not axes[1]["is_known"], "gravity does not turn axis 1"
    what = {each["where"]: each for each in json.loads(done.stdout)["findings"]}
    assert "gravity causes no torque on this axis" in what["J1"]["advice"]
    assert (place.folder / "cell.toml").read_bytes() == before
    held = stored(place)
    assert set(held) == {joint for joint, axis in axes.items() if axis["is_known"]}
    run, axis = held[3]
    assert (run.load, run.mass_kg, run.data) == ("weight", 5.0, ("run.csv",))
    assert run.com_m == (WEIGHT[1:] if known == WEIGHED else None)
    config = load_cell(place.folder / "cell.toml").cell.arm[0].axis[2]
    assert axis.stated_nm_per_a == config.torque_constant_nm_per_a.value
    assert axis.residual_nm > 0


@pytest.mark.parametrize(("typed", "is_stored"), [(5.0, True), (5.42, False), (4.56, False)])
def test_a_weight_typed_wrong_is_not_stored(place, typed, is_stored):
    """Less than 3 standard deviations on any axis at a stated 3 %, but one factor on all of them."""
    text = (place.folder / "cell.toml").read_text(encoding="utf-8")
    stated = re.sub(
        r"(torque_constant_nm_per_a = {[^}]*?)(, std_percent = [\d.]+)?\s*}", r"\1, std_percent = 3 }", text
    )
    (place.folder / "cell.toml").write_text(stated, encoding="utf-8")
    done = calibrated(place, known=f"weight={typed},0.02,-0.01,0.1", content=bracket(gain=np.zeros(6)))
    findings = json.loads(done.stdout)["findings"]
    failed = [finding for finding in findings if finding["severity"] == "fail"]
    assert done.exit_code == (0 if is_stored else 7)
    assert calibration_path(place.folder / "cell.toml").exists() == is_stored
    assert bool(failed) == (not is_stored)
    for finding in failed:
        assert finding["advice"].index("weigh") < finding["advice"].index("rms")


def test_the_next_load_is_measured_with_them_and_the_result_says_so(place):
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    words = ("estimate", tool, "--cell", "cell.toml", "--json", "-")
    before = json.loads(place(*words).stdout)
    assert calibrated(place).exit_code == 0
    result = json.loads(place(*words).stdout)
    (load,), (was,) = result["loads"], before["loads"]
    assert load["mass_std_kg"] < 0.5 * was["mass_std_kg"]
    assert abs(load["mass_kg"] - TOOL[0]) < 4 * load["mass_std_kg"]
    (said,) = [each for each in result["findings"] if each["where"] == "calibration"]
    assert said["severity"] == "info"
    assert f"measured {datetime.now(UTC):%Y-%m-%d} with load weight of 5 kg" in said["what"]
    assert result["provenance"]["J3"]["torque_scale"]["source"].startswith("measured")
    assert "torque_scale" not in before["provenance"]["J3"]


@pytest.mark.slow
def test_a_diagnosis_uses_them(place):
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    assert calibrated(place).exit_code == 0
    estimated = json.loads(place("estimate", tool, "--cell", "cell.toml", "--json", "-").stdout)["loads"][0]
    result = json.loads(place("diagnose", tool, "--cell", "cell.toml", "--json", "-").stdout)
    assert abs(result["loads"][0]["mass_kg"] - estimated["mass_kg"]) < estimated["mass_std_kg"]
    assert any(each["where"] == "calibration" for each in result["findings"])


def test_a_warm_arm_is_a_statement_that_narrows_the_mass(place):
    """Not by much: the readings of a calibration on another day may differ as much as those of a cold arm."""
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    assert calibrated(place).exit_code == 0
    words = ("estimate", tool, "--cell", "cell.toml", "--json", "-")
    cold, warm = (json.loads(place(*words, *more).stdout)["loads"][0] for more in ((), ("--warm",)))
    assert 0.7 * cold["mass_std_kg"] < warm["mass_std_kg"] < cold["mass_std_kg"]
    assert abs(warm["mass_kg"] - TOOL[0]) < 4 * warm["mass_std_kg"]


def test_unloaded_runs_that_differ_widen_the_calibration(place):
    steady = {axis["joint"]: axis for axis in json.loads(calibrated(place).stdout)["axes"]}
    blocks = [rows("none", None), rows("weight", WEIGHT, start_s=300.0)]
    later = rows("none", None, first=1001, start_s=600.0, gain=GAIN + np.array([0, 0.02, 0.02, 0.02, 0.02, 0.02]))
    done = calibrated(place, "--force", content=concatenate([*blocks, later]))
    answer = json.loads(done.stdout)
    drifted = {axis["joint"]: axis for axis in answer["axes"]}
    assert drifted[2]["std"] > 1.5 * steady[2]["std"]
    assert any("between both measurements its torque changed" in each["what"] for each in answer["findings"])


def change(place, **values):
    """Rewrite the stored calibration of axis 3, or of the run."""
    path = calibration_path(place.folder / "cell.toml")
    file = parse_calibration(path.read_text(encoding="utf-8"), "test")
    run = file.arm[0]
    of_run = {key: value for key, value in values.items() if key == "measured"}
    of_axis = {key: value for key, value in values.items() if key != "measured"}
    axes = tuple(axis.model_copy(update=of_axis) if axis.joint == 3 else axis for axis in run.axis)
    changed = file.model_copy(update={"arm": (run.model_copy(update={"axis": axes, **of_run}),)})
    path.write_text(calibration_toml(changed, "cell.toml"), encoding="utf-8")


def gains_std(place, *more) -> np.ndarray:
    """Prior standard deviation of the constants of an analysis that uses the calibration."""
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    request = ModelRequest(cell=place.folder / "cell.toml", is_warm="--warm" in more)
    return np.array(collect_inputs(request, [place.folder / tool]).knowledge.gain_std)


@pytest.mark.parametrize(("days", "moved"), [(0, 0.0), (61, 0.002), (3650, 0.01)])
def test_the_age_of_a_calibration_is_in_its_standard_deviation(place, days, moved):
    """0.1 % a month and at most 1 %; a warm arm keeps the change from day to day of 0.4 % an axis and 0.3 % common."""
    assert calibrated(place).exit_code == 0
    _, axis = stored(place)[3]
    change(place, measured=datetime.now(UTC) - timedelta(days=days))
    cold, warm = gains_std(place)[2], gains_std(place, "--warm")[2]
    assert cold == pytest.approx(np.hypot(axis.std_percent / 100, moved), rel=0.01)
    assert warm == pytest.approx(np.sqrt(cold**2 + 0.004**2 + 0.003**2), rel=0.01)
    assert axis.std_percent > 0.5 * 100 * np.hypot(0.004, 0.003), "its own occasions changed, although none is seen"


def test_an_old_calibration_is_reported(place):
    assert calibrated(place).exit_code == 0
    change(place, measured=datetime.now(UTC) - timedelta(days=200))
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    result = json.loads(place("estimate", tool, "--cell", "cell.toml", "--json", "-").stdout)
    assert [each["severity"] for each in result["findings"] if "200 days ago" in each["what"]] == ["warn"]


def test_a_constant_that_the_cell_states_otherwise_since_is_not_used(place):
    assert calibrated(place).exit_code == 0
    change(place, stated_nm_per_a=0.5)
    tool = place.table("tool.csv", concatenate([rows("none", None), rows("tool", TOOL, start_s=300.0)]))
    result = json.loads(place("estimate", tool, "--cell", "cell.toml", "--json", "-").stdout)
    (said,) = [each for each in result["findings"] if each["where"] == "J3" and "is not used" in each["what"]]
    assert said["severity"] == "warn"
    assert "torque_constant_nm_per_a" in said["what"]
    assert "torque_scale" not in result["provenance"]["J3"]
    assert "torque_scale" in result["provenance"]["J2"]


def test_a_stored_unloaded_arm_of_other_constants_is_refused(place):
    bare = place.table("bare.csv", rows("none", None))
    assert place("estimate", bare, "--cell", "cell.toml", "--json", "bare.json").exit_code == 0
    assert calibrated(place).exit_code == 0
    tool = place.table("tool.csv", rows("tool", TOOL))
    done = place("estimate", tool, "--cell", "cell.toml", "--bare", "bare.json", "--json", "-")
    assert done.exit_code == 3
    assert "estimate the samples of the unloaded arm again" in done.stderr
    assert place("estimate", bare, "--cell", "cell.toml", "--json", "bare.json").exit_code == 0
    assert place("estimate", tool, "--cell", "cell.toml", "--bare", "bare.json", "--json", "-").exit_code == 0


@pytest.mark.parametrize(
    ("known", "code", "message"),
    [
        ("weight=0", 3, "a load of 0 kg is not allowed"),
        ("weight=0,0,0,0.1", 3, "a load of 0 kg cannot calibrate an axis"),
        ("weight=5000", 3, "grams? that is 5 kg"),
        ("wieght=5", 3, "run.csv) hold none, weight"),
        ("none=5", 3, "is the unloaded arm"),
        ("weight=5,20,0,100", 3, "these are millimetres"),
    ],
)
def test_a_load_that_cannot_be_meant_is_refused(place, known, code, message):
    done = calibrated(place, known=known)
    assert (done.exit_code, message in " ".join(done.stderr.split())) == (code, True), done.output
    assert not calibration_path(place.folder / "cell.toml").exists()


def test_another_mass_than_the_one_that_was_mounted_is_not_stored_unasked(place):
    done = calibrated(place, known="weight=6.2")
    assert done.exit_code == 7, done.output
    said = " ".join(done.stderr.split())
    assert "stated as 6.2 kg, but estimated as 5" in said
    factor = float(said.split("wrong by a common factor of ")[1].split(",")[0])
    assert factor == pytest.approx(6.2 / 5.0, rel=0.05)
    assert "weigh the mass" in said
    assert not calibration_path(place.folder / "cell.toml").exists()
    assert calibrated(place, "--force", known="weight=6.2").exit_code == 0
    assert calibration_path(place.folder / "cell.toml").exists()


def test_a_load_that_no_axis_carries_is_refused(place):
    q = np.zeros((3, 6))  # stretched upwards, turned about the vertical alone
    q[:, 0] = (-1.0, 0.0, 1.0)
    light = (0.05, 0.0, 0.0, 0.0)
    content = concatenate([rows("none", None, q=q), rows("weight", light, q=q, start_s=300.0)])
    done = calibrated(place, known="weight=0.05,0,0,0", content=content)
    assert done.exit_code == 6, done.output
    assert "no axis carries enough of the load" in done.stderr
    assert "nothing is stored" in done.stderr


def test_data_without_the_unloaded_arm_are_refused(place):
    done = calibrated(place, content=rows("weight", WEIGHT))
    assert done.exit_code == 6
    assert "no rest pose of the unloaded arm" in " ".join(done.stderr.split())


def test_a_constant_that_is_far_from_the_stated_one_is_reported_with_both_numbers(place):
    gain = GAIN + np.array([0, 0, 0, 0, 0, -0.16])
    done = calibrated(place, content=bracket(gain=gain))
    assert done.exit_code == 0, done.output
    (said,) = [each for each in json.loads(done.stdout)["findings"] if each["severity"] == "warn"]
    assert said["where"] == "J6"
    assert "differ by" in said["what"]
    assert "(to 3 %)" in said["what"]


def test_a_calibration_that_contradicts_the_stored_one_is_not_stored_unasked(place):
    assert calibrated(place).exit_code == 0
    first = stored(place)[2][1].torque_scale
    other = bracket(gain=GAIN + np.array([0, 0.05, 0, 0, 0, 0]), seed=2)
    done = calibrated(place, content=other)
    assert done.exit_code == 7, done.output
    assert "J2" in done.stderr
    assert f"says {first:.4f}" in " ".join(done.stderr.split())
    assert stored(place)[2][1].torque_scale == first
    assert calibrated(place, "--force", content=other).exit_code == 0
    assert stored(place)[2][1].torque_scale == pytest.approx(1 / 1.07, rel=0.02)


def test_a_damaged_calibration_file_stops_every_command_that_reads_the_cell(place):
    path = calibration_path(place.folder / "cell.toml")
    path.write_text("[[arm]]\nname = 5\n", encoding="utf-8")
    done = place("plan", "cell.toml", "--poses", "3")
    assert done.exit_code == 3
    assert "cell.calibration.toml line" in " ".join(done.stderr.split())


def test_axes_of_an_earlier_calibration_are_kept_where_the_new_one_cannot_determine_them(place):
    assert calibrated(place).exit_code == 0
    before = stored(place)
    assert {2, 3} <= set(before)
    change(place, serial_number=17)
    file = parse_calibration(calibration_path(place.folder / "cell.toml").read_text(encoding="utf-8"), "test")
    new = file.arm[0].model_copy(
        update={
            "measured": datetime.now(UTC),
            "load": "other",
            "axis": tuple(a for a in file.arm[0].axis if a.joint == 2),
        }
    )
    both = file.with_new(new).of("main")
    assert set(both) == set(before)
    assert {joint: run.load for joint, (run, _) in both.items()} == dict.fromkeys(before, "weight") | {2: "other"}
    last = file.with_new(new).with_new(replace_run(file.arm[0], "last"))
    assert len(last.arm) == 1, "a table of which nothing holds is dropped"


def replace_run(run, load):
    return run.model_copy(update={"load": load})
