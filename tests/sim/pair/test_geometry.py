"""Geometry and drawn errors of the two simulated arms against closed forms, differences and pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from sim.pair import geometry
from sim.pair.gap import Rig, ranges
from sim.pair.pair_errors import draw
from sim.urdf import translation, turn
from tests.sim.conftest import reference_arms

REFERENCE = reference_arms()
#: Elbow up, tool down.
START_RAD = np.deg2rad([-25.0, 85.0, -182.0, 0.0, -83.0, -25.0])


def test_forward_kinematics_agrees_with_pinocchio() -> None:
    model, joint, arm = pinocchio.Model(), 0, REFERENCE[0].geometry
    before = pinocchio.SE3.Identity()
    for row in range(6):
        joint = model.addJoint(joint, pinocchio.JointModelRZ(), before, f"j{row}")
        twist = turn("x", arm.alpha_rad[row])[:3, :3]
        before = pinocchio.SE3(twist, np.array([arm.a_m[row], 0.0, arm.d_m[row]]))
    tool = before * pinocchio.SE3(arm.tool)
    data, rng = model.createData(), np.random.default_rng(1)
    for q in rng.uniform(-2.0, 2.0, (10, 6)):
        pinocchio.forwardKinematics(model, data, q)
        assert np.allclose(geometry.tip(arm, q), (data.oMi[joint] * tool).homogeneous, atol=1e-12)


def test_jacobian_by_differences() -> None:
    for arm in (sheet.geometry for sheet in REFERENCE):
        for column in range(6):
            step = np.zeros(6)
            step[column] = 1e-6
            ahead, back = geometry.tip(arm, START_RAD + step), geometry.tip(arm, START_RAD - step)
            turned = ahead[:3, :3] @ back[:3, :3].T
            omega = (
                np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
            )
            expected = np.concatenate([ahead[:3, 3] - back[:3, 3], omega]) / 2e-6
            assert np.allclose(geometry.jacobian(arm, START_RAD)[:, column], expected, atol=1e-8)


def test_same_seed_same_errors_and_their_size() -> None:
    one, two = draw(3, REFERENCE), draw(3, REFERENCE)
    assert np.array_equal(one.master.geometry.base, two.master.geometry.base)
    many = [draw(seed, REFERENCE) for seed in range(60)]
    zero = np.array([item.slave.geometry.zero_rad for item in many])
    length = np.array([item.master.geometry.a_m - REFERENCE[0].geometry.a_m for item in many])
    assert np.std(zero) == pytest.approx(0.5e-3, rel=0.15)
    assert np.std(length) == pytest.approx(0.4e-3, rel=0.15)
    assert all(0.0 <= item.skew_s <= 1e-3 for item in many)
    assert not np.array_equal(many[0].master.geometry.zero_rad, many[0].slave.geometry.zero_rad)


def test_distances_at_the_demanded_relation_and_moved_away() -> None:
    relation = translation(-0.4, 0.0, 0.0) @ turn("z", np.pi)
    origin, beam = np.array([[0.06, 0.0, 0.0], [-0.04, 0.05, 0.0], [0.0, 0.06, 0.02]]), np.eye(3)[[2, 2, 0]]
    hit = (origin + 0.005 * beam) @ relation[:3, :3].T + relation[:3, 3]
    rig = Rig(origin, beam, hit, -beam @ relation[:3, :3].T)
    first = turn("z", 0.3)[None]
    assert np.allclose(ranges(rig, first, first @ relation), 0.005)
    closer = relation @ translation(0.0, 0.0, 0.001)
    assert np.allclose(ranges(rig, first, first @ closer)[0], [0.004, 0.004, 0.005])
