"""Limits, boxes and torque shares, against points and torques worked out by pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from gateway.arm_model import arm_named, arm_robot, robot_text
from gateway.config import AxisConfig, KeepOut
from gateway.errors import ConfigError
from gateway.motion.workspace import TORQUE_SHARE, body_points, path_points, workspace_of


@pytest.fixture(scope="module")
def postures(workspace) -> np.ndarray:
    return np.random.default_rng(3).uniform(workspace.lower_rad, workspace.upper_rad, (60, 6))


@pytest.fixture(scope="module")
def model(small_cell):
    return pinocchio.buildModelFromXML(robot_text(small_cell, small_cell.cell.arm[0]))


def test_joint_limits_and_margin(workspace):
    middle = (workspace.lower_rad + workspace.upper_rad) / 2
    q_rad = np.tile(middle, (3, 1))
    q_rad[1, 3] = workspace.upper_rad[3] + 1e-6
    q_rad[2, 3] = workspace.upper_rad[3] - 0.01
    joint_4 = workspace.violations(q_rad)[3]
    assert joint_4[1].tolist() == [False, True, False]
    assert workspace.violations(q_rad, margin_rad=0.02)[3][1].tolist() == [False, True, True]
    assert "joint 4 outside" in workspace.why_not(q_rad[1])


def test_points_of_the_arm_are_those_of_the_model(workspace, model, postures):
    """Joint origins 3 to 6, points between them, and a point of the load."""
    corner = np.array([[0.1, -0.2, 0.3]])
    points = body_points(workspace.robot, postures, corner)
    data = model.createData()
    for row, q_rad in enumerate(postures):
        pinocchio.forwardKinematics(model, data, q_rad)
        origins = np.array([data.oMi[joint].translation for joint in range(2, 7)])
        load = data.oMi[6].act(corner[0])
        assert points[row, :4] == pytest.approx(origins[1:], abs=1e-9)
        assert points[row, -1] == pytest.approx(load, abs=1e-9)
        middle = (origins[1] + origins[0]) / 2
        assert np.abs(points[row] - middle).max(axis=1).min() < 1e-9


def test_boxes_keep_points_out(workspace, postures):
    ends = body_points(workspace.robot, postures, workspace.points_m)[:, -1]
    box = np.array([[ends[0] - 0.01, ends[0] + 0.01]])
    boxed = replace(workspace, boxes_m=box)
    words, inside = boxed.violations(postures[:1])[6]
    assert inside.tolist() == [True]
    assert words == "a point of the arm or load in keep_out box 1"
    touching = np.array([[ends[0], ends[0] + 0.001]])
    assert replace(workspace, boxes_m=touching).violations(postures[:1])[6][1].tolist() == [False]


def test_holding_torque_is_gravity_over_efficiency(workspace, model, postures):
    data = model.createData()
    gravity = np.array([np.abs(pinocchio.computeGeneralizedGravity(model, data, q)) for q in postures])
    torque = workspace.holding_torque(postures)
    scale = np.linalg.norm(workspace.gravity_m_s2) / 9.81
    assert torque == pytest.approx(gravity * scale / workspace.efficiency, rel=1e-6, abs=1e-9)


def test_heaviest_load_counts(workspace, postures):
    load = replace(workspace, max_load=10.0 * np.array([1.0, 0.0, 0.0, 0.2]))
    assert (load.holding_torque(postures)[:, 1] >= workspace.holding_torque(postures)[:, 1]).all()
    assert load.holding_torque(postures)[:, 1].max() > 1.2 * workspace.holding_torque(postures)[:, 1].max()
    assert load.rest_share > workspace.rest_share
    tight = replace(workspace, torque_nm=workspace.torque_nm * 0.1)
    assert "holding torque of joint" in tight.why_not(postures[0] * 0, TORQUE_SHARE)


def test_unknown_links_leave_torque_unchecked(small_cell):
    arm = small_cell.cell.arm[0].model_copy(update={"inertials": "ignore"})
    unknown = workspace_of(arm, arm_robot(small_cell, arm))
    assert unknown.links is None
    assert unknown.holding_torque(np.zeros((1, 6))) is None
    assert len(unknown.violations(np.zeros((1, 6)))) == 6 + len(arm.keep_out)


def test_path_between_feasible_postures_may_be_blocked(workspace, postures):
    start, end = postures[0], postures[1]
    middle = body_points(workspace.robot, (start + end)[None] / 2, workspace.points_m)[0, -1]
    free = replace(workspace, boxes_m=np.empty((0, 2, 3)), links=None)
    assert free.path_clear(start[None], end[None]).tolist() == [True]
    blocked = replace(free, boxes_m=np.array([[middle - 0.02, middle + 0.02]]))
    assert blocked.feasible(np.array([start, end])).all()
    assert blocked.path_clear(start[None], end[None]).tolist() == [False]


def test_path_points_are_close_and_reach_both_ends():
    points = path_points(np.zeros(6), np.array([1.0, 0, 0, 0, 0, -0.2]))
    assert points[0].tolist() == [0.0] * 6
    assert points[-1].tolist() == [1.0, 0, 0, 0, 0, -0.2]
    assert np.abs(np.diff(points, axis=0)).max() <= 0.05


def test_limits_of_cell_and_robot_are_joined(small_cell):
    arm = small_cell.cell.arm[0]
    robot = replace(arm_robot(small_cell, arm), upper_rad=np.full(6, 0.5))
    assert workspace_of(arm, robot).upper_rad.tolist() == [0.5] * 6
    with pytest.raises(ConfigError, match=r"axis 1: .* do not overlap"):
        workspace_of(arm, replace(robot, upper_rad=np.full(6, -3.0), lower_rad=np.full(6, -4.0)))


def test_rates_without_a_limit_follow_from_the_speed_limit():
    axis = AxisConfig.model_validate(
        {
            "node_id": 1,
            "profile": "generic-cia402",
            "torque_constant_nm_per_a": {"value": 1, "source": "x"},
            "gear_ratio": {"value": 100, "source": "x"},
            "gear_efficiency": {"value": 0.8, "source": "x"},
            "position_limit_rad": [-1, 1],
            "speed_limit_rad_s": 0.6,
            "torque_limit_nm": 100,
        }
    )
    assert axis.acceleration_rad_s2 == pytest.approx(1.0)
    assert axis.jerk_rad_s3 == pytest.approx(5.0)


def test_box_corners_must_be_in_order():
    with pytest.raises(ValueError, match="must lie below"):
        KeepOut(min_m=(0, 0, 0), max_m=(1, 0, 1))


def test_arm_by_name(small_cell):
    assert arm_named(small_cell).name == "main"
    with pytest.raises(ConfigError, match="there is no arm 'left'; it has main"):
        arm_named(small_cell, "left")
