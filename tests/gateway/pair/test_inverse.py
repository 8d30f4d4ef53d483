"""Inverse kinematics: the forward kinematics of pinocchio must bring every posture back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from gateway.errors import LimitExceeded, PlanRefused
from gateway.model.robot import Robot
from gateway.pair.inverse import (
    ForwardChain,
    chain_of,
    joint_angles,
    path_joint_angles,
    smallest_singular,
    solve,
    turns,
)
from gateway.pair.pair_cell import PairArm, load_pair


@pytest.fixture(scope="module")
def oracle(arm: Robot) -> pinocchio.Model:
    model = pinocchio.Model()
    joint = 0
    for i in range(6):
        axis = arm.axis[i]
        placement = pinocchio.SE3(arm.placement[i][:3, :3], arm.placement[i][:3, 3])
        joint = model.addJoint(joint, pinocchio.JointModelRevoluteUnaligned(axis), placement, f"j{i}")
    flange = pinocchio.SE3(arm.flange[:3, :3], arm.flange[:3, 3])
    model.addFrame(pinocchio.Frame("tip", joint, flange, pinocchio.FrameType.OP_FRAME))
    return model


def postures(count: int) -> np.ndarray:
    rng = np.random.default_rng(2)
    middle = np.array([0.0, 1.4, -3.0, 0.0, -1.3, 0.0])
    return middle + rng.uniform(-0.4, 0.4, (count, 6))


def test_forward_kinematics_and_jacobian(arm: Robot, oracle: pinocchio.Model) -> None:
    data = oracle.createData()
    q = postures(10)
    tips, jacobians = chain_of(arm).poses(q)
    for row in range(10):
        jacobian = pinocchio.computeFrameJacobian(
            oracle, data, q[row], 0 + oracle.getFrameId("tip"), pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pinocchio.framesForwardKinematics(oracle, data, q[row])
        tip = data.oMf[oracle.getFrameId("tip")]
        assert np.allclose(tips[row], tip.homogeneous, atol=1e-12)
        assert np.allclose(jacobians[row], jacobian, atol=1e-12)


def test_every_posture_comes_back(arm: Robot) -> None:
    chain = chain_of(arm)
    for q in postures(20):
        target = chain.poses(q[None])[0][0]
        found = joint_angles(chain, target, q + 0.15)
        assert np.allclose(chain.poses(found[None])[0][0], target, atol=1e-9)
        assert np.allclose(found, q, atol=1e-7)


def test_whole_path_follows_its_branch(arm: Robot) -> None:
    chain = chain_of(arm)
    u = np.linspace(0.0, 1.0, 87)[:, None]
    truth = np.array([0.0, 1.4, -3.0, 0.0, -1.3, 0.0]) + 0.5 * np.sin(3.0 * u + np.arange(6))
    q, singular = path_joint_angles(arm, chain.poses(truth)[0], truth[0] + 0.05)
    assert np.allclose(q, truth, atol=1e-7)
    assert np.allclose(singular, smallest_singular(chain, truth), atol=1e-6)


def test_out_of_reach_is_refused(arm: Robot) -> None:
    target = np.eye(4)
    target[0, 3] = 5.0
    with pytest.raises(PlanRefused, match="out of reach"):
        joint_angles(arm, target, postures(1)[0])


def test_singular_posture_is_refused(arm: Robot) -> None:
    chain = chain_of(arm)
    wrist = np.array([0.0, 1.4, -3.0, 0.2, -0.01, 0.1])
    with pytest.raises(PlanRefused, match="singular"):
        joint_angles(chain, chain.poses(wrist[None])[0][0], wrist)


def test_joint_limit_is_named(arm: Robot) -> None:
    from dataclasses import replace

    limited = replace(arm, upper_rad=np.array([9.0, 9.0, 9.0, 9.0, -1.5, 9.0]))
    q = np.array([0.0, 1.4, -3.0, 0.0, -1.3, 0.0])
    with pytest.raises(LimitExceeded, match="joint 5"):
        joint_angles(limited, chain_of(arm).poses(q[None])[0][0], q)


# -- more axes than a pose needs ---------------------------------------------------------------------------------------


SEVEN = Path(__file__).resolve().parents[3] / "examples" / "pair-unequal" / "seven-six.toml"
SPEED = 1.5


@pytest.fixture(scope="module")
def seven() -> PairArm:
    return load_pair(SEVEN).arms[0]


@pytest.fixture(scope="module")
def commands() -> np.ndarray:
    return load_pair(SEVEN).path(SPEED).commands


def tip_of(arm: PairArm, q: np.ndarray) -> np.ndarray:
    """Fingertip (4, 4) by the placements of the joints, one after the other."""
    frame = np.eye(4)
    for placed, axis, angle in zip(arm.robot.placement, arm.robot.axis, q, strict=True):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(axis * angle).as_matrix()
        frame = frame @ placed @ turn
    return frame @ arm.robot.flange


def unseen(arm: PairArm, q: np.ndarray) -> np.ndarray:
    """Direction (7,) in which the joints turn and the fingertip stays, by differences."""
    columns = []
    for unit in np.eye(7):
        ahead, behind = (tip_of(arm, q + side * 1e-6 * unit) for side in (1, -1))
        turn = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec()
        columns.append(np.concatenate([ahead[:3, 3] - behind[:3, 3], turn]) / 2e-6)
    return null_space(np.array(columns).T, rcond=1e-6)[:, 0]


def test_a_seven_axis_arm_follows_a_path_exactly_and_evenly(seven: PairArm, commands: np.ndarray) -> None:
    """The hand is slower than 0.8 m/s and its joints than 1.5 rad/s: 6 mrad a cycle, 0.1 mrad more or less the next."""
    q, singular = path_joint_angles(seven.chain, commands, seven.start_rad)
    for row in range(0, len(q), 20):
        assert np.allclose(tip_of(seven, q[row]), commands[row], atol=1e-9)
    assert q[0] == pytest.approx(seven.start_rad, abs=1e-6)
    assert np.abs(np.diff(q, axis=0)).max() < 6e-3
    assert np.abs(np.diff(q, 2, axis=0)).max() < 1e-4
    assert singular.min() > 0.2


def test_of_all_postures_that_reach_a_pose_the_one_nearest_to_the_start_is_taken(
    seven: PairArm, commands: np.ndarray
) -> None:
    """Nothing of the transfer to the start is left in the null space of the fingertip, and it is not a maximum."""
    free = replace(seven.chain, rest_rad=None)
    for row in (0, 300, 620, len(commands) - 1):
        q = path_joint_angles(seven.chain, commands[: row + 2], seven.start_rad)[0][row]
        direction = unseen(seven, q)
        assert abs(direction @ (q - seven.start_rad)) < 1e-5
        for side in (-0.1, 0.1):
            other = solve(free, commands[row][None], (q + side * direction)[None])[0]
            assert np.allclose(tip_of(seven, other), commands[row], atol=1e-9)
            assert np.linalg.norm(other - q) > 0.05
            assert np.linalg.norm(other - seven.start_rad) > np.linalg.norm(q - seven.start_rad)


def test_a_pose_has_one_posture_whatever_the_approach(seven: PairArm, commands: np.ndarray) -> None:
    there = path_joint_angles(seven.chain, commands, seven.start_rad)[0]
    back = path_joint_angles(seven.chain, commands[::-1], there[-1] + 0.2 * unseen(seven, there[-1]))[0]
    assert back[::-1] == pytest.approx(there, abs=1e-5)


def test_a_posture_far_from_the_nearest_is_brought_there_in_few_steps(
    seven: PairArm, commands: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Newton's steps to the nearest to a posture 0.5 rad off in joint 2, from 0.5 rad beside; without curvature 7."""
    chain = replace(seven.chain, rest_rad=seven.start_rad + 0.5 * np.eye(7)[1])
    looks, plain = [], ForwardChain.poses
    monkeypatch.setattr(ForwardChain, "poses", lambda self, q: (looks.append(1), plain(self, q))[1])
    q = solve(chain, commands[:1], (seven.start_rad + 0.5 * unseen(seven, seven.start_rad))[None])[0]
    assert np.allclose(tip_of(seven, q), commands[0], atol=1e-9)
    assert abs(unseen(seven, q) @ (q - chain.rest_rad)) < 1e-5
    assert len(looks) <= 6


def test_joints_turn_by_the_least_that_moves_a_hand(seven: PairArm) -> None:
    jacobian = seven.chain.poses(seven.start_rad[None])[1]
    twists = np.random.default_rng(5).standard_normal((6, 3))
    assert turns(jacobian, twists)[0] == pytest.approx(np.linalg.pinv(jacobian[0]) @ twists)
    assert turns(jacobian[:, :, 1:], twists)[0] == pytest.approx(np.linalg.inv(jacobian[0][:, 1:]) @ twists)
