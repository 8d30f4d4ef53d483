"""`cell new` without a bus: what is asked, what is offered, what the cell says, what is refused."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from gateway.cell.config import load_cell
from gateway.cli import main
from gateway.model.arm_model import arm_robot

OWN = Path(__file__).parents[3] / "examples" / "own"
FOUR = Path(__file__).parents[2] / "cells" / "four"
#: An answer file that leaves nothing out which has to be said.
ENOUGH = """offline = true
bus = "socketcan:can0"
robot = "arm.urdf"
nodes = [11, 12, 13, 14, 15, 16]
profile = "generic-cia402"
gear_ratio = 100
"""
DH = """offline = true
robot = "dh"
dh_convention = "modified"
dh_alpha_rad = [0, 1.5708, 0]
dh_a_m = [0, 0.1, 0.4]
dh_d_m = [0.3, 0, 0]
dh_theta_offset_rad = [0, 0, 0]
nodes = [1, 2, 3]
profile = "generic-cia402"
gear_ratio = 100
position_limit_rad = [[-2.5, 2.5], [-1.5, 1.5], [-2, 2]]
torque_limit_nm = [200, 200, 100]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("COLUMNS", "300")
    shutil.copy(OWN / "arm.urdf", tmp_path / "arm.urdf")
    return tmp_path


def new(folder, *more, **options):
    words = ["cell", "new", "-o", folder / "cell.toml", *more]
    return CliRunner().invoke(main, [str(word) for word in words], **options)


def with_answers(folder, text, *more):
    (folder / "answers.toml").write_text(text, encoding="utf-8")
    return new(folder, "--answers", folder / "answers.toml", *more)


def axes_of(folder):
    (arm,) = load_cell(folder / "cell.toml").cell.arm
    return arm


def test_what_was_not_stated_is_assumed_and_named(folder):
    done = with_answers(folder, ENOUGH, "--json", folder / "out.json")
    assert done.exit_code == 0, done.output
    arm = axes_of(folder)
    assert [axis.node_id for axis in arm.axis] == [11, 12, 13, 14, 15, 16]
    assert {axis.gear_ratio.value for axis in arm.axis} == {100}
    assert {axis.gear_efficiency.source for axis in arm.axis} == {"assumed: typical robot gear"}
    left = {entry["key"]: entry for entry in json.loads((folder / "out.json").read_text())["left"]}
    for key in ("gear_efficiency", "position_sign", "torque_sign", "zero_offset_rad", "speed_limit_rad_s", "mounting"):
        assert left[key]["why"].startswith("assumed")
        assert left[key]["how"]
        assert key in done.output
    assert not {"gear_ratio", "nodes", "position_limit_rad", "torque_limit_nm"} & set(left)
    text = (folder / "cell.toml").read_text(encoding="utf-8")
    assert "speed_limit_rad_s = 0.5   # assumed: slow for a first motion" in text
    assert "# J1, turret: no drive was read" in text


def test_joint_limits_are_those_of_the_urdf(folder):
    assert with_answers(folder, ENOUGH).exit_code == 0
    arm = axes_of(folder)
    assert arm.axis[1].position_limit_rad == (-1.6, 1.9)
    assert arm.axis[0].torque_limit_nm == 140
    assert arm_robot(load_cell(folder / "cell.toml"), arm).joint_names[2] == "elbow"


def test_rows_without_urdf(folder):
    assert with_answers(folder, DH).exit_code == 0
    arm = axes_of(folder)
    assert arm.dh is not None
    assert arm.dh.a_m == (0, 0.1, 0.4)
    assert arm.inertials == "ignore"
    assert arm_robot(load_cell(folder / "cell.toml"), arm).axes == 3


def test_the_answers_of_a_run_give_the_same_cell_again(folder):
    sourced = ENOUGH.replace("gear_ratio = 100", 'gear_ratio = { value = 100, source = "plate" }\nmounting = "ceiling"')
    assert with_answers(folder, sourced, "--save-answers", folder / "said" / "saved.toml").exit_code == 0
    first = (folder / "cell.toml").read_text(encoding="utf-8")
    assert 'source = "plate"' in first
    assert "gravity_m_s2 = [0, 0, 9.80665]" in first
    (folder / "cell.toml").unlink()
    again = new(folder, "--answers", folder / "said" / "saved.toml")
    assert again.exit_code == 0, again.output
    assert (folder / "cell.toml").read_text(encoding="utf-8") == first


def test_a_person_is_asked_for_what_cannot_be_read_and_asked_again(folder):
    lines = ["1, 2, 3, 4, 5", "11, 12, 13, 14, 15, 16", "generic-cia402", "many", "101; plate", "", "0.12", *[""] * 9]
    done = new(folder, "--robot", folder / "arm.urdf", "--bus", "socketcan:can0", "--offline", input="\n".join(lines))
    assert done.exit_code == 0, done.output
    assert "has 5 values but the arm has 6 axes" in done.stderr
    assert "holds 'many', which is not a number" in done.stderr
    arm = axes_of(folder)
    assert arm.axis[0].gear_ratio.value == 101
    assert arm.axis[0].gear_ratio.source == "plate"
    assert arm.axis[5].torque_constant_nm_per_a.value == 0.12
    assert "position_limit_rad" not in done.stderr
    assert done.stderr.count("Enter: ") <= 12


def test_without_a_terminal_the_message_says_how_to_answer(folder):
    done = new(folder, "--robot", folder / "arm.urdf", "--offline", input="")
    assert done.exit_code == 3
    assert (
        "bus: no answer was given; write it into an answer file (--answers FILE), or --answer bus=VALUE" in done.stderr
    )


def test_an_option_goes_before_the_file(folder):
    done = with_answers(folder, ENOUGH, "--answer", "gear_ratio=-80", "--answer", "poses={ count = 5 }")
    assert done.exit_code == 0, done.output
    assert axes_of(folder).axis[0].gear_ratio.value == -80
    assert load_cell(folder / "cell.toml").cell.poses.count == 5


def test_nothing_is_replaced_unasked(folder):
    (folder / "cell.toml").write_text("mine", encoding="utf-8")
    done = with_answers(folder, ENOUGH)
    assert done.exit_code == 3
    assert "exists and is not replaced" in done.stderr
    assert (folder / "cell.toml").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("old", "new_", "words"),
    [
        ("gear_ratio = 100\n", "", "gear_ratio is missing: gear ratio, motor turns per joint turn"),
        ("gear_ratio = 100", "gear_ratio = 100\nposition_limit_rad = [-170, 170]", "in degrees? write"),
        ("gear_ratio = 100", "gear_ratio = 100\nposes = { count = 1 }", "line 7: count = 1"),
        ('"generic-cia402"', '"unknown"', "unknown' cannot be read"),
        ('"arm.urdf"', '"dh"', "dh_alpha_rad is missing"),
        ("offline = true", "offline = 1", "line 1: offline is neither true nor false"),
        ("offline = true", 'offline = true\neds = "none.eds"', "none.eds"),
        ("offline = true", "offline = ", "not valid TOML"),
    ],
)
def test_an_answer_that_cannot_be_used_is_named_and_nothing_is_written(folder, old, new_, words):
    assert old in ENOUGH
    done = with_answers(folder, ENOUGH.replace(old, new_))
    assert done.exit_code == 3, done.output
    assert words in done.stderr
    assert len(done.stderr.splitlines()) <= 10
    assert not (folder / "cell.toml").exists()


def test_all_that_is_wrong_is_said_at_once(folder):
    text = ENOUGH.replace("gear_ratio = 100", "gear_efficiency = 2\nposition_sign = 0")
    done = with_answers(folder, text)
    assert done.exit_code == 3
    for words in ("gear_ratio is missing", "gear_efficiency must be in", "position_sign = 0"):
        assert words in done.stderr


def test_rows_of_different_length_are_counted(folder):
    done = with_answers(folder, DH.replace("dh_a_m = [0, 0.1, 0.4]", "dh_a_m = [0, 0.1]"))
    assert done.exit_code == 3
    assert "dh_a_m 2" in done.stderr


def test_the_schema_accepts_every_cell_of_the_examples(folder):
    jsonschema = pytest.importorskip("jsonschema")
    import tomllib

    done = CliRunner().invoke(main, ["cell", "schema"])
    schema = json.loads(done.stdout)
    for path in sorted(OWN.parent.glob("*/*.toml")):
        text = path.read_text(encoding="utf-8")
        if "[[arm]]" in text:
            jsonschema.validate(tomllib.loads(text), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads((FOUR / "cell.toml").read_text()) | {"arms": 1}, schema)


@pytest.mark.parametrize(
    ("effort", "says"),
    [
        ("1000", "the same effort of 1000 Nm on every axis"),
        ("300", "the same effort of 300 Nm on every axis"),
        ("500000", "an effort of 500000 Nm"),
    ],
)
def test_efforts_that_an_exporter_filled_in_are_marked_and_refuse_motion_until_confirmed(folder, effort, says):
    urdf = folder / "arm.urdf"
    urdf.write_text(re.sub(r'effort="\d+"', f'effort="{effort}"', urdf.read_text()))
    done = with_answers(folder, ENOUGH)
    assert done.exit_code == 0, done.output
    assert says in done.stdout
    axes = axes_of(folder).axis
    assert {axis.torque_limit_nm for axis in axes} == {float(effort)}
    assert all(axis.torque_limit_is_assumed for axis in axes)
    words = ("--bus", f"virtual:effort-{effort}", "--to", "home", "--yes")  # the lock of a bus is that of the computer
    refused = CliRunner().invoke(main, ["move", str(folder / "cell.toml"), *words])
    assert refused.exit_code == 3, refused.output
    assert "torque_limit_nm is not confirmed (J1" in " ".join(refused.stderr.split())
    (folder / "cell.toml").unlink()
    confirmed = with_answers(folder, ENOUGH + "torque_limit_nm = [140, 140, 75, 26, 22, 14]\n")
    assert confirmed.exit_code == 0, confirmed.output
    assert not any(axis.torque_limit_is_assumed for axis in axes_of(folder).axis)


def test_efforts_of_a_maker_are_limits(folder):
    assert with_answers(folder, ENOUGH).exit_code == 0
    axes = axes_of(folder).axis
    assert [axis.torque_limit_nm for axis in axes] == [140, 140, 75, 26, 22, 14]
    assert not any(axis.torque_limit_is_assumed for axis in axes)


JAW = (
    '<link name="jaw"/><joint name="jaw_joint" type="revolute"><parent link="{last}"/><child link="jaw"/>'
    '<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="5" velocity="1"/></joint></robot>'
)


def test_a_jaw_in_the_urdf_asks_for_the_tip_and_the_cell_says_it(folder):
    urdf = folder / "arm.urdf"
    text = urdf.read_text(encoding="utf-8")
    last = "hand_link"
    urdf.write_text(text.replace("</robot>", JAW.format(last=last)), encoding="utf-8")
    refused = with_answers(folder, ENOUGH)
    assert refused.exit_code == 3
    assert f"--tip {last}" in refused.stderr
    done = with_answers(folder, ENOUGH, "--tip", last)
    assert done.exit_code == 0, done.output
    assert "joints taken as fixed at zero: 'jaw_joint' (revolute)" in done.stderr
    arm = axes_of(folder)
    assert (arm.tip, len(arm.axis)) == (last, 6)
    assert arm_robot(load_cell(folder / "cell.toml"), arm).axes == 6


AT_FIRST = ["11-16", "generic-cia402", "1:101; plate"]


def at_the_terminal(folder, lines, ends=None):
    """A run in which a person types these lines, and then does something else."""
    typed_lines = iter(lines)

    def prompt(*_args, **_named):
        line = next(typed_lines, None)
        if line is None and ends is not None:
            raise ends
        return line or ""

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("click.prompt", prompt)
        patch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        return new(folder, "--robot", folder / "arm.urdf", "--bus", "socketcan:can0", "--offline")


@pytest.mark.parametrize("ends", [KeyboardInterrupt(), click.Abort(), RuntimeError("a defect")])
def test_answers_are_kept_on_every_exit_and_taken_up_again(folder, ends):
    first = at_the_terminal(folder, AT_FIRST, ends)
    assert first.exit_code in (1, 3, 130)
    assert "cell.answers.toml: run the same command again" in first.stderr
    assert not (folder / "cell.toml").exists()
    again = at_the_terminal(folder, ["", "0.12"])
    assert again.exit_code == 0, again.output
    axis = axes_of(folder).axis[5]
    assert (axis.node_id, axis.gear_ratio.value, axis.gear_ratio.source) == (16, 101, "plate")
    assert axis.torque_constant_nm_per_a.value == 0.12
    assert not (folder / "cell.answers.toml").exists()


def test_a_kept_answer_that_does_not_hold_is_asked_again(folder):
    (folder / "cell.answers.toml").write_text('nodes = [1, 2, 3]\nprofile = "gone"\n', encoding="utf-8")
    done = at_the_terminal(folder, [*AT_FIRST, "", "0.12"])
    assert done.exit_code == 0, done.output
    assert axes_of(folder).axis[0].node_id == 11


def test_a_wrong_profile_name_is_asked_again_with_similar_names(folder):
    lines = ["11-16", "generic-cia403", "generic", "1:101", "", "0.12"]
    done = at_the_terminal(folder, lines)
    assert done.exit_code == 0, done.output
    assert "did you mean generic-cia402" in done.stderr
    assert {axis.profile for axis in axes_of(folder).axis} == {"generic-cia402"}


def test_questions_are_counted(folder):
    done = at_the_terminal(folder, [*AT_FIRST, "", "0.12"])
    counts = [tuple(map(int, pair)) for pair in re.findall(r"question (\d+) of (\d+)", done.stderr)]
    assert [number for number, _ in counts] == list(range(1, len(counts) + 1))
    assert len(counts) <= 14
    assert all(number <= most for number, most in counts)
    assert sorted((most for _, most in counts), reverse=True) == [most for _, most in counts]
