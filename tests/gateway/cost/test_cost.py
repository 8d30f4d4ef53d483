"""The command: cycle times, reserves, limits, and what it refuses."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.result.drawn import Drawn
from gateway.result.result import LoadResult, Result, to_json

EXAMPLES = Path(__file__).parents[3] / "examples"
STD = (0.004, 0.004, 0.006)
LOAD = LoadResult("a", 140.0, 1.5, (0.02, 0.01, 0.28), STD)
BAND = (40.0, 60.0, 40.0, 15.0, 15.0, 8.0)
RESULT = Result(robot="qh165", loads=(LOAD,), friction_band_nm=BAND, data=Drawn(cell="large", arm="main"))
SWING = "waypoints_rad = [[0, -0.2, 0, 0, 0.3, 0], [0, 0.5, -0.3, 0, 0.3, 0]]\ndwell_s = 0.0\n"


def changed(text: str, **limits: float) -> str:
    lines = text.splitlines()
    for key, value in limits.items():
        lines = [f"{key} = {value}" if line.startswith(f"{key} =") else line for line in lines]
    return "\n".join(lines)


@pytest.fixture
def folder(tmp_path):
    """A fast arm of the large example: torque limits the swing."""
    urdf = (EXAMPLES / "large" / "robot.urdf").read_text(encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(re.sub(r'velocity="[\d.]+"', 'velocity="5"', urdf), encoding="utf-8")
    text = (EXAMPLES / "large" / "cell.toml").read_text(encoding="utf-8")
    fast = {"speed_limit_rad_s": 2.0, "acceleration_limit_rad_s2": 8.0, "jerk_limit_rad_s3": 80.0}
    (tmp_path / "cell.toml").write_text(changed(text, **fast), encoding="utf-8")
    (tmp_path / "result.json").write_text(to_json(RESULT), encoding="utf-8")
    (tmp_path / "path.toml").write_text(SWING, encoding="utf-8")
    return tmp_path


def slow_down(folder: Path) -> None:
    text = (folder / "cell.toml").read_text(encoding="utf-8")
    (folder / "cell.toml").write_text(changed(text, acceleration_limit_rad_s2=1.0), encoding="utf-8")


def run(folder: Path, *more: str):
    words = ["cost", str(folder / "cell.toml"), str(folder / "result.json"), *more]
    return CliRunner(env={"COLUMNS": "200"}).invoke(main, words)


def settings(folder: Path, *more: str) -> dict[str, dict]:
    done = run(folder, "--path", str(folder / "path.toml"), "--json", str(folder / "cost.json"), *more)
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "cost.json").read_text(encoding="utf-8"))
    return {each["name"]: each for each in found["moves"][0]["settings"]}


def test_the_entered_load_slows_the_path_down_to_the_torque_limit(folder):
    done = run(folder, "--path", str(folder / "path.toml"))
    found = settings(folder)
    before, after = found["no load"], found["entered load"]
    assert after["cycle_time_s"] > 1.02 * before["cycle_time_s"]
    assert min(before["torque_reserve"]) < -0.1
    assert min(after["torque_reserve"]) == pytest.approx(0.0, abs=0.01)
    assert after["segments"][0]["limited_by"] == "torque of J2"
    assert found["rated load"]["mass_kg"] == 165.0
    assert found["rated load"]["cycle_time_s"] >= after["cycle_time_s"]
    assert "slower" in done.stdout
    assert "limited by torque of J2" in done.stdout


@pytest.mark.slow
def test_reserve_has_the_interval_of_the_load(folder):
    """The spread of the reserve over drawn loads, each at the plan for the mean one."""
    from gateway.cell.config import load_cell
    from gateway.cost import job

    slow_down(folder)  # every load has the same time law
    found = settings(folder)["no load"]
    cell = load_cell(folder / "cell.toml")
    rng, reserves = np.random.default_rng(1), []
    for number in range(30):
        drawn = replace(
            LOAD,
            mass_kg=LOAD.mass_kg + 1.5 * rng.standard_normal(),
            com_m=tuple((np.array(LOAD.com_m) + np.array(STD) * rng.standard_normal(3)).tolist()),
        )
        file = folder / f"drawn{number}.json"
        file.write_text(to_json(replace(RESULT, loads=(drawn,))), encoding="utf-8")
        cost = job.cost_of(cell, cell.cell.arm[0], file, None, folder / "path.toml")
        reserves.append(cost.moves[0].settings[0].torque_reserve)
    assert found["torque_reserve_std"][1:3] == pytest.approx(np.std(reserves, axis=0)[1:3], rel=0.35)


def test_a_slow_cell_loses_nothing(folder):
    text = (folder / "cell.toml").read_text(encoding="utf-8")
    slow = {"speed_limit_rad_s": 0.2, "acceleration_limit_rad_s2": 0.3, "jerk_limit_rad_s3": 3.0}
    (folder / "cell.toml").write_text(changed(text, **slow), encoding="utf-8")
    found = settings(folder)
    assert found["entered load"]["cycle_time_s"] == found["no load"]["cycle_time_s"]
    assert found["entered load"]["segments"][0]["limited_by"] == "speed of J2"
    assert "does not change the cycle time" in run(folder, "--path", str(folder / "path.toml")).stdout


def test_the_gripper_limits_where_the_cell_states_its_acceleration(folder):
    text = (folder / "cell.toml").read_text(encoding="utf-8")
    stated = text.replace("floor_m = -0.65", "floor_m = -0.65\nload_acceleration_m_s2 = 2.0")
    (folder / "cell.toml").write_text(stated, encoding="utf-8")
    found = settings(folder)
    assert found["entered load"]["segments"][0]["limited_by"] == "load acceleration"
    assert found["entered load"]["load_acceleration_reserve"] == pytest.approx(0.0, abs=0.03)
    assert found["no load"]["load_acceleration_reserve"] < -1.0


def test_a_timed_path_is_stretched_as_a_whole(folder):
    rows = ["time_s,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad"]
    for time, q2 in ((0.0, -0.2), (0.15, -0.05), (0.3, 0.25), (0.45, 0.45), (0.6, 0.5)):
        rows.append(f"{time},0,{q2},0,0,0.3,0")
    (folder / "path.csv").write_text("\n".join(rows), encoding="utf-8")
    text = (folder / "cell.toml").read_text(encoding="utf-8")
    loose = changed(text, speed_limit_rad_s=5.0, acceleration_limit_rad_s2=60.0, jerk_limit_rad_s3=2000.0)
    (folder / "cell.toml").write_text(loose, encoding="utf-8")
    done = run(folder, "--path", str(folder / "path.csv"), "--json", str(folder / "cost.json"))
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "cost.json").read_text(encoding="utf-8"))["moves"][0]["settings"]
    assert found[-1]["cycle_time_s"] > 0.61
    assert found[-1]["segments"][0]["limited_by"] == "torque of J2"
    assert min(found[-1]["torque_reserve"]) == pytest.approx(0.0, abs=0.01)


def test_standard_moves_are_used_without_a_path(folder):
    slow_down(folder)
    done = run(folder, "--json", str(folder / "cost.json"))
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "cost.json").read_text(encoding="utf-8"))
    assert [move["name"] for move in found["moves"]] == ["J1", "J2", "J3", "J4", "J5", "J6", "all"]


HEAVY = replace(LOAD, mass_kg=700.0)
NOT_IDENTIFIED = replace(LOAD, com_m=None, com_std_m=None, unidentifiable=("com_m",))


@pytest.mark.parametrize(
    ("result", "path", "code", "said"),
    [
        (None, SWING, 3, "result.json: cannot be read"),
        (replace(RESULT, loads=()), SWING, 6, "holds no identified load"),
        (replace(RESULT, loads=(NOT_IDENTIFIED,)), SWING, 6, "is not fully identified"),
        (replace(RESULT, robot="other"), SWING, 3, "was identified on robot 'other', not on 'qh165'"),
        (
            replace(RESULT, data=Drawn(cell="large", arm="left")),
            SWING,
            3,
            "was identified on arm 'left', not on 'main'",
        ),
        (
            replace(RESULT, loads=(HEAVY,)),
            SWING,
            5,
            "the torque limits do not suffice to move the arm with a load of 700",
        ),
        (RESULT, SWING.replace("0.5,", "2.5,"), 5, "joint 2 outside"),
        (RESULT, "waypoints_rad = [[0, 0, 0, 0, 0, 0]]", 3, "path.toml"),
    ],
)
def test_wrong_input_is_refused_with_its_reason(folder, result, path, code, said):
    if result is None:
        (folder / "result.json").unlink()
    else:
        (folder / "result.json").write_text(to_json(result), encoding="utf-8")
    (folder / "path.toml").write_text(path, encoding="utf-8")
    done = run(folder, "--path", str(folder / "path.toml"))
    assert done.exit_code == code, done.output
    assert said in " ".join(done.stderr.split())
