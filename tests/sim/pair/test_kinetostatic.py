"""Geometry, drawn errors and the kinetostatic pair against closed forms, differences and pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from sim.pair import geometry
from sim.pair.errors import DRIFT_M, draw, ideal, warmed, without_lag, without_local
from sim.pair.kinetostatic import (
    LINK_MASS_KG,
    KinetostaticPair,
    chain_stiffness,
    gravity_torque,
    path_constants,
    torque_noise,
)
from sim.pair.ranges import ranges, six_sensors

SYNC_S = 0.004
START = geometry.START_RAD


def standing(count: int = 400) -> np.ndarray:
    return np.tile(START, (count, 1, 1))


def pair_of(errors: list, q: np.ndarray | None = None) -> KinetostaticPair:
    constants = path_constants(standing() if q is None else q, SYNC_S)
    return KinetostaticPair(constants, errors, [chain_stiffness(constants, item) for item in errors])


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


def test_gravity_torque_is_the_slope_of_the_potential() -> None:
    arm = geometry.nominal_arms()[1]

    def potential(q: np.ndarray) -> float:
        own = np.concatenate([np.eye(4)[None], geometry.frames(arm, q)])
        height = (arm.base @ own)[:, 2, 3]
        return float(geometry.GRAVITY_M_S2 * (LINK_MASS_KG * 0.5 * (height[1:] + height[:-1])).sum())

    torque = gravity_torque(arm, START[1][None])[0]
    for joint in range(6):
        step = np.zeros(6)
        step[joint] = 1e-6
        slope = (potential(START[1] + step) - potential(START[1] - step)) / 2e-6
        assert torque[joint] == pytest.approx(slope, abs=1e-5)


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


def test_errors_can_be_taken_away_one_by_one() -> None:
    errors = draw(1, geometry.bases())
    assert not without_local(errors).slave.backlash_rad.any()
    assert not without_lag(errors).master.lag_s.any()
    assert np.array_equal(ideal(errors).slave.geometry.tool, geometry.nominal_arms()[1].tool)
    assert ideal(errors).master.gravity_scale is errors.master.gravity_scale
    grown = warmed(errors, 300.0).master.geometry.a_m - errors.master.geometry.a_m
    assert grown == pytest.approx([0.0, 0.5 * DRIFT_M, 0.0, 0.0, 0.0, 0.0])


def test_gripped_part_is_free_of_force_and_a_gap_becomes_force() -> None:
    errors = without_lag(without_local(draw(2, geometry.bases())))
    plant = pair_of([errors])
    plant.place(standing(1))
    plant.grip()
    silent = np.zeros((1, 2, 6))
    assert np.abs(plant.step(0, standing(1), silent).internal).max() < 1e-6
    moved = standing(1)
    moved[0, 1] += 1e-4 * np.array([1.0, -1.0, 0.5, 1.0, 0.0, 2.0])
    for _ in range(3):
        reading = plant.step(0, moved, silent)
    constants = path_constants(standing(), SYNC_S)
    gap = geometry.jacobian(errors.slave.geometry, START[1]) @ (moved - standing(1))[0, 1]
    expected = -chain_stiffness(constants, errors)[0] @ gap
    assert np.allclose(reading.internal[0, :3], expected[:3], rtol=0.02, atol=0.1)


def test_stiffness_of_the_chain_lies_in_its_known_range() -> None:
    constants = path_constants(standing(3), SYNC_S)
    stiffness = chain_stiffness(constants, ideal(draw(0, geometry.bases())))[0]
    force, moment = np.linalg.eigvalsh(stiffness[:3, :3]), np.linalg.eigvalsh(stiffness[3:, 3:])
    assert 4e4 < force[0] < force[-1] < 2e5
    assert 2.8e3 < moment[0] < moment[-1] < 4e3
    assert np.allclose(stiffness, stiffness.T)


def test_servo_follows_a_cycle_late_by_its_time_constant() -> None:
    errors = without_local(draw(4, geometry.bases()))
    plant = pair_of([errors])
    plant.place(standing(1))
    plant.delay(np.zeros(1))
    target = standing(1) + 1e-3
    motion = [plant.step(0, target, np.zeros((1, 2, 6))).encoder_rad[0] - START for _ in range(12)]
    for cycle, moved in enumerate(motion):
        for arm, lag in enumerate((errors.master.lag_s, errors.slave.lag_s)):
            assert np.allclose(moved[arm], 1e-3 * (1.0 - np.exp(-cycle * SYNC_S / lag)), atol=1e-9)


def test_play_keeps_the_link_back_at_a_reversal() -> None:
    errors = without_lag(draw(5, geometry.bases()))
    plant = pair_of([errors])
    plant.place(standing(1))
    tips = []
    for offset in (0.0, 1e-3, 1e-3, 1e-3, 0.9e-3, 0.9e-3, 0.9e-3):
        target = standing(1)
        target[0, 0, 5] += offset
        plant.step(0, target, np.zeros((1, 2, 6)))
        tips.append(plant.tips()[0][0])
    turned = np.arccos(np.clip(0.5 * (np.trace(tips[-1][:3, :3] @ tips[3][:3, :3].T) - 1.0), -1.0, 1.0))
    assert turned < 1e-6


def test_estimate_comes_a_cycle_late_and_carries_half_the_part() -> None:
    plant = pair_of([ideal(draw(6, geometry.bases()))])
    plant.place(standing(1))
    plant.grip()
    quiet = np.zeros((1, 2, 6))
    reading = plant.step(0, standing(1), quiet, 0.0)
    weight = -0.5 * geometry.PART_MASS_KG * geometry.GRAVITY_M_S2
    assert reading.wrench[0, :, 2] == pytest.approx([weight, weight], abs=20.0)
    plant.snag_n[0, 0] = 20.0
    same = plant.step(0, standing(1), quiet, 0.0)
    later = plant.step(0, standing(1), quiet, 0.0)
    assert np.array_equal(same.wrench, reading.wrench)
    assert later.wrench[0, 1, 0] < reading.wrench[0, 1, 0]


def test_noise_is_the_same_for_every_method_of_a_seed() -> None:
    assert np.array_equal(torque_noise(1, 2, 50), torque_noise(1, 2, 50))
    assert not np.array_equal(torque_noise(1, 2, 50), torque_noise(1, 3, 50))
    assert np.std(torque_noise(1, 2, 4000)[..., 0]) == pytest.approx(0.003 * 600.0, rel=0.03)


def test_distances_at_the_demanded_relation_and_moved_away() -> None:
    relation = np.linalg.inv(geometry.grasps()[0]) @ geometry.grasps()[1]
    rig = six_sensors(relation, 0.005)
    first = geometry.turn("z", 0.3)[None]
    assert np.allclose(ranges(rig, first, first @ relation), 0.005)
    closer = relation @ geometry.translation(0.0, 0.0, 0.001)
    assert np.allclose(ranges(rig, first, first @ closer)[0, :3], 0.004)
