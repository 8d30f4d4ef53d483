"""Inverse kinematics: the forward kinematics of pinocchio must bring every posture back."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from gateway.errors import LimitExceeded, PlanRefused
from gateway.model.robot import Robot
from gateway.pair.inverse import chain_of, joint_angles, path_joint_angles, smallest_singular


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
