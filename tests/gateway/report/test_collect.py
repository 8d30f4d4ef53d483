"""Poses for the drawings against pinocchio's kinematics."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from gateway.model.robot import robot_from_urdf, with_flange
from gateway.report.collect import drawn_poses, flange_spread
from gateway.result.result import LoadResult, Rows

URDF = Path(__file__).parents[3] / "examples" / "small" / "robot.urdf"


@pytest.fixture(scope="module")
def arms():
    text = URDF.read_text(encoding="utf-8")
    return robot_from_urdf(text, str(URDF)), pin.buildModelFromXML(text)


def rows(q_rad, load, pose):
    return Rows(load=tuple(load), pose=tuple(pose), q_rad=tuple(map(tuple, q_rad)))


def test_points_and_centre_of_gravity_stand_where_pinocchio_puts_them(arms):
    robot, model = arms
    q_rad = np.random.default_rng(3).uniform(-1.5, 1.5, (4, 6))
    com = (0.02, -0.03, 0.11)
    entries = drawn_poses(robot, rows(q_rad, ["a"] * 4, [1, 2, 3, 4]), [LoadResult("a", 1.0, 0.1, com, com)])
    data = model.createData()
    for entry, q in zip(entries, q_rad, strict=True):
        pin.forwardKinematics(model, data, q)
        joints = [data.oMi[index].translation for index in range(1, 7)]
        assert np.allclose(entry.points_m[:6], joints, atol=2e-5)
        assert np.allclose(entry.com_m, data.oMi[6].act(np.array(com)), atol=2e-5)
        assert len(entry.points_m) == 7


def test_a_pose_is_drawn_once_with_the_load_that_was_mounted_last(arms):
    q_rad = np.zeros((6, 6))
    measured = rows(q_rad, ["none", "a", "b", "none", "a", "none"], [1, 1, 1, 2, 2, 3])
    entries = drawn_poses(arms[0], measured, [LoadResult("a", 1.0)], ["fit", "fit", "fresh", "fit", "fit", "fit"])
    assert [(entry.pose, entry.load, entry.role) for entry in entries] == [
        (1, "b", "fresh"),
        (2, "a", "fit"),
        (3, "none", "fit"),
    ]
    assert not any(entry.com_m for entry in entries)


def test_of_a_moving_run_a_few_instants_are_drawn(arms):
    entries = drawn_poses(arms[0], rows(np.zeros((500, 6)), ["none"] * 500, [-1] * 500), [])
    assert len(entries) == 10


def test_without_rows_there_is_nothing_to_draw(arms):
    assert drawn_poses(arms[0], Rows(), []) == ()


def test_uncertainty_turns_with_the_flange(arms):
    # a quarter turn about z: x of the flange is y of link 6, y is minus x
    robot = with_flange(arms[0], (0.0, 0.0, 0.1), (0.0, 0.0, np.pi / 2))
    correlation = ((1.0, 0.0, 0.5, 0.0), (0.0, 1.0, 0.2, 0.0), (0.5, 0.2, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    load = LoadResult("a", 5.0, 0.1, (0.0, 0.0, 0.1), (0.001, 0.002, 0.003), correlation=correlation)
    spread = flange_spread(robot, [load])["a"]
    assert np.allclose(spread.com_std_m, [0.002, 0.001, 0.003])
    assert np.allclose(spread.correlation[0], [1.0, 0.5, 0.0, 0.0])
    assert np.isclose(spread.correlation[1][2], -0.2)


def test_without_flange_or_correlation_nothing_is_said_of_its_uncertainty(arms):
    load = LoadResult("a", 5.0, 0.1, (0.0, 0.0, 0.1), (0.001, 0.002, 0.003))
    assert flange_spread(arms[0], [load]) == {}
    assert flange_spread(with_flange(arms[0], (0.0, 0.0, 0.1), (0.0, 0.0, 0.0)), [load]) == {}
