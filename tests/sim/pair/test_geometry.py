"""Geometry and drawn errors of the two simulated arms against closed forms, differences and pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from sim.pair import geometry
from sim.pair.pair_errors import draw
from sim.pair.ranges import ranges, six_sensors

SYNC_S = 0.004
START = geometry.START_RAD


def test_forward_kinematics_agrees_with_pinocchio() -> None:
    model, joint = pinocchio.Model(), 0
    before = pinocchio.SE3.Identity()
    for row in range(6):
        joint = model.addJoint(joint, pinocchio.JointModelRZ(), before, f"j{row}")
        turn = geometry.turn("x", geometry.DH_ALPHA_RAD[row])[:3, :3]
        before = pinocchio.SE3(turn, np.array([geometry.DH_A_M[row], 0.0, geometry.DH_D_M[row]]))
    tool = before * pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, geometry.TOOL_M]))
    data, rng = model.createData(), np.random.default_rng(1)
    arm = geometry.nominal_arm(np.eye(4))
    for q in rng.uniform(-2.0, 2.0, (10, 6)):
        pinocchio.forwardKinematics(model, data, q)
        assert np.allclose(geometry.tip(arm, q), (data.oMi[joint] * tool).homogeneous, atol=1e-12)


def test_jacobian_by_differences() -> None:
    for arm in geometry.nominal_arms():
        for column in range(6):
            step = np.zeros(6)
            step[column] = 1e-6
            ahead, back = geometry.tip(arm, START[0] + step), geometry.tip(arm, START[0] - step)
            turned = ahead[:3, :3] @ back[:3, :3].T
            omega = (
                np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
            )
            expected = np.concatenate([ahead[:3, 3] - back[:3, 3], omega]) / 2e-6
            assert np.allclose(geometry.jacobian(arm, START[0])[:, column], expected, atol=1e-8)


def test_path_starts_and_ends_where_it_should_and_rests_there() -> None:
    poses = geometry.part_poses(SYNC_S)
    assert len(poses) == 1501
    assert poses[0, 1, 3] == pytest.approx(-0.35)
    assert poses[-1, 1, 3] == pytest.approx(0.35)
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / SYNC_S
    assert speed[0] < 1e-3
    assert speed[-1] < 1e-3
    assert np.allclose(poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2), np.eye(3))


def test_same_seed_same_errors_and_their_size() -> None:
    one, two = draw(3, geometry.bases()), draw(3, geometry.bases())
    assert np.array_equal(one.master.geometry.base, two.master.geometry.base)
    many = [draw(seed, geometry.bases()) for seed in range(60)]
    zero = np.array([item.slave.geometry.zero_rad for item in many])
    length = np.array([item.master.geometry.a_m - geometry.DH_A_M for item in many])
    assert np.std(zero) == pytest.approx(0.5e-3, rel=0.15)
    assert np.std(length) == pytest.approx(0.4e-3, rel=0.15)
    assert all(0.0 <= item.skew_s <= 1e-3 for item in many)
    assert not np.array_equal(many[0].master.geometry.zero_rad, many[0].slave.geometry.zero_rad)


def test_distances_at_the_demanded_relation_and_moved_away() -> None:
    relation = np.linalg.inv(geometry.grasps()[0]) @ geometry.grasps()[1]
    rig = six_sensors(relation, 0.005)
    first = geometry.turn("z", 0.3)[None]
    assert np.allclose(ranges(rig, first, first @ relation), 0.005)
    closer = relation @ geometry.translation(0.0, 0.0, 0.001)
    assert np.allclose(ranges(rig, first, first @ closer)[0, :3], 0.004)
