"""Poses that are asked for: numbers that stay, no result of another arm, and nothing that cannot be measured."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio
import pytest

from gateway.acquire.planning import asked_by, plan_asked, postures_to_ask
from gateway.data.visit import RestPose
from gateway.errors import InputError, PlanRefused
from gateway.model.arm_model import arm_robot, robot_text

FIRST, SECOND, THIRD = (
    (0.3, -0.2, 0.4, 0.5, -0.4, 0.6),
    (-0.4, 0.1, 0.3, 0.2, 0.5, 0.0),
    (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
)


@pytest.fixture
def config(small_cell):
    return small_cell.cell.arm[0]


@pytest.fixture
def result(tmp_path, small_cell, config):
    """A result file that asks for poses."""

    def write(poses=(FIRST, SECOND), robot=None, cell=None, arm=None, what="measure"):
        body = {
            "schema": 1,
            "robot": robot or arm_robot(small_cell, config).name,
            "loads": [],
            "next": [{"what": what, "poses_rad": [list(q_rad) for q_rad in poses]}],
            "data": {
                "cell": cell or small_cell.cell.name,
                "arm": arm or config.name,
                "poses": [{"pose": number, "load": "none", "q_rad": list(THIRD)} for number in (2, 9, 4)],
            },
        }
        path = tmp_path / "result.json"
        path.write_text(json.dumps(body), encoding="utf-8")
        return path

    return write


def holding(config, *poses):
    """A recording of these poses."""
    arm = SimpleNamespace(poses=poses)
    return SimpleNamespace(arm=lambda name: arm if name == config.name else None)


def test_one_pose_alone_is_visited_from_both_sides(small_cell, config):
    plan = plan_asked(small_cell, config, {FIRST: "fit"}, None)
    assert sorted(plan.visits) == [(1, -1), (1, 1)]
    assert plan.poses == (RestPose(1, FIRST, "fit"),)
    assert plan.expectation is None


def test_a_posture_of_the_file_keeps_its_number_and_a_new_one_gets_the_next(small_cell, config):
    there = holding(config, RestPose(3, THIRD, "validation"), RestPose(7, FIRST, "fit"))
    plan = plan_asked(small_cell, config, dict.fromkeys((SECOND, FIRST, THIRD), "fit"), there)
    assert {(pose.number, pose.q_rad) for pose in plan.poses} == {(8, SECOND), (7, FIRST), (3, THIRD)}
    assert next(pose for pose in plan.poses if pose.number == 3).purpose == "validation"


def test_what_a_result_asks_for_gets_numbers_beyond_its_own_whatever_is_mounted(small_cell, config, result):
    postures, taken = asked_by(result(), small_cell, config)
    assert (postures, taken) == ((FIRST, SECOND), (2, 4, 9))
    for _load in ("none", "tool"):
        plan = plan_asked(small_cell, config, dict.fromkeys(postures, "fit"), None, taken)
        assert [pose.number for pose in plan.poses] == [10, 11]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"robot": "kr300"}, "robot 'kr300'"),
        ({"cell": "elsewhere"}, "cell 'elsewhere'"),
        ({"arm": "left"}, "arm 'left'"),
        ({"poses": (), "what": "weigh the links"}, "requests no pose under `next`, but: weigh the links"),
        ({"poses": ((0.1, 0.2),)}, "must have 6 axes"),
    ],
)
def test_a_result_that_cannot_be_measured_here_is_refused(small_cell, config, result, change, says):
    with pytest.raises(InputError, match=says) as refused:
        asked_by(result(**change), small_cell, config)
    assert "result.json" in str(refused.value)


def test_a_pose_outside_the_limits_is_refused_with_its_reason(small_cell, config):
    outside = (0.0, 0.0, 0.0, 0.0, 2.5, 0.0)
    with pytest.raises(PlanRefused, match=r"pose 1: joint 5 outside .*, at \[0\.000"):
        plan_asked(small_cell, config, {outside: "fit"}, None)


def test_what_may_be_asked_for_is_inside_the_limits_and_outside_the_boxes(small_cell, config):
    """Joint limits of the cell with the approach to both sides, and the flange by pinocchio."""
    robot = arm_robot(small_cell, config)
    about: Any = SimpleNamespace(arm=config, robot=robot, loaded=small_cell, recordings=())
    q_rad = postures_to_ask(about)
    assert q_rad is not None
    assert len(q_rad) == 160
    limits = np.array([axis.position_limit_rad for axis in config.axis])
    offset = small_cell.cell.poses.approach_offset_rad
    assert (q_rad - offset >= limits[:, 0]).all()
    assert (q_rad + offset <= limits[:, 1]).all()
    model = pinocchio.buildModelFromXML(robot_text(small_cell, config))
    data = model.createData()
    for row in q_rad:
        pinocchio.forwardKinematics(model, data, row)
        flange = data.oMi[6].translation
        assert not any(
            (np.array(box.min_m) < flange).all() and (flange < np.array(box.max_m)).all() for box in config.keep_out
        )
    assert np.array_equal(postures_to_ask(about), q_rad), "the same every time"


def test_without_a_cell_nothing_is_known_of_limits(small_cell, config):
    robot = arm_robot(small_cell, config)
    assert postures_to_ask(SimpleNamespace(arm=None, robot=robot, loaded=None, recordings=())) is None
