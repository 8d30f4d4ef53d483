"""The physical finding on measured runs of real robots, the error on blocks held out, and nothing that is not there."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from gateway.data.table import read_csv
from gateway.diagnose.moving.diagnosis import diagnose_motion
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf
from gateway.result.result import from_json, to_json

FOLDER = os.environ.get("SERVO_GATEWAY_DATA")
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(FOLDER is None, reason="SERVO_GATEWAY_DATA does not point to the measured runs"),
]
FRICTION = {"velocity_friction", "load_dependent_friction"}
KR300_LACKS = frozenset({"balancer_spring"} | FRICTION)


def load(robot, run):
    folder = Path(str(FOLDER)) / robot
    table = read_csv(folder / f"{run}.csv", None)
    return table, robot_from_urdf((folder / "robot.urdf").read_text(), str(folder / "robot.urdf"))


def named(result):
    return {(effect.name, effect.joints) for effect in result.effects}


def held(result):
    return np.array(result.before.holdout_rms_nm), np.array(result.after.holdout_rms_nm)


@pytest.mark.slow
def test_kr300_lacks_a_balancer_and_carries_a_believable_load():
    table, robot = load("kr300", "run_A")
    result = diagnose_motion(table, robot, Knowledge())
    before, after = held(result)
    assert ("balancer_spring", (2,)) in named(result)
    assert {name for name, _ in named(result)} <= KR300_LACKS
    assert after[1] < 0.5 * before[1]
    assert np.all(after < 1.2 * before), "blocks that chose nothing: little is lost where nothing was found"
    assert result.verdict == "improved"
    assert np.isnan(result.noise_floor_nm).all()
    found = result.loads[0]
    assert 120 < found.mass_kg < 190
    assert 3 < found.mass_std_kg < 30
    assert found.com_m is not None
    assert abs(found.com_m[0]) < 0.1
    assert abs(found.com_m[1]) < 0.1
    assert -0.6 < found.com_m[2] < -0.24, "beyond the flange, which is at z = -0.24 m"
    assert from_json(to_json(result)).effects[0].name == "balancer_spring"


@pytest.mark.slow
def test_kr300_load_under_any_trust_in_the_cad_is_the_same_within_its_intervals():
    table, robot = load("kr300", "run_A")
    loads = [
        diagnose_motion(table, robot, Knowledge(link_std=trust), only=KR300_LACKS).loads[0] for trust in (0.0, 0.05)
    ]
    for one in loads:
        for other in loads:
            both = np.hypot(one.mass_std_kg, other.mass_std_kg)
            assert abs(one.mass_kg - other.mass_kg) < 2.5 * both
        assert one.mass_std_kg < 15


@pytest.mark.slow
def test_tx40_motor_6_turns_with_joint_5():
    table, robot = load("tx40", "run_1_first")
    result = diagnose_motion(table, robot, Knowledge())
    before, after = held(result)
    assert ("axis_coupling", (5, 6)) in named(result)
    assert {name for name, _ in named(result)} <= {"axis_coupling"} | FRICTION
    coupling = next(effect for effect in result.effects if effect.name == "axis_coupling")
    assert coupling.parameters["coefficient"] == pytest.approx(1.0, abs=0.1)
    assert before[4] > 4.0
    assert after[4] < 1.6
    assert after[5] < 0.35 * before[5]
    assert np.all(after < 1.12 * before)
    assert result.verdict == "improved"


@pytest.mark.slow
def test_tx40_parts_of_the_run_predict_each_other():
    table, robot = load("tx40", "run_1_first")
    first, last = table.take(table.time_s < 3.6), table.take(table.time_s > 3.8)
    result = diagnose_motion(first, robot, Knowledge(), holdout=last)
    before, after = held(result)
    assert result.holdout_kind == "given"
    assert ("axis_coupling", (5, 6)) in named(result)
    assert {name for name, _ in named(result)} <= {"axis_coupling"} | FRICTION
    assert after[4] < 0.3 * before[4]


@pytest.mark.slow
def test_ur10_friction_follows_speed_and_the_load_as_any_gears_does():
    table, robot = load("ur10", "run_1_first")
    result = diagnose_motion(table, robot, Knowledge())
    before, after = held(result)
    assert {("velocity_friction", (1,)), ("velocity_friction", (2,))} <= named(result)
    assert {name for name, _ in named(result)} <= {"velocity_friction"}, "a loss of some 5 % is usual"
    assert 0.02 < result.nuisance["load_friction"].value[1] < 0.08
    assert result.nuisance["load_friction"].std[1] < 0.03
    assert after[1] < 0.7 * before[1]
    assert after[0] < 0.6 * before[0]
    assert np.all(after < 1.05 * before)
    assert result.verdict == "improved"
