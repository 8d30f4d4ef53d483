"""Motor to joint and back: power balance, published coupling, gear efficiency by side."""

import numpy as np
import pytest

from gateway.cell.conversion import AxisConversion


def conversion(**changes) -> AxisConversion:
    values = {
        "ratio": np.array([210.0, 210.0, -180.0, 60.0, 50.0, 40.0]),
        "efficiency": np.array([0.8, 0.75, 0.9, 0.7, 0.85, 0.95]),
        "position_sign": np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0]),
        "torque_sign": np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0]),
        "zero_offset_rad": np.array([0.0, -1.57, 0.1, 0.2, -0.3, 3.0]),
        "torque_constant_nm_per_a": np.array([1.8, 1.8, 1.5, 0.5, 0.4, 0.3]),
        "coupling": np.eye(6),
    }
    return AxisConversion(**(values | changes))


def coupled() -> np.ndarray:
    matrix = np.eye(6)
    matrix[5, 4], matrix[2, 1] = 0.9, 1.0
    return matrix


@pytest.mark.parametrize("coupling", [np.eye(6), coupled()])
def test_position_goes_there_and_back(coupling):
    axes = conversion(coupling=coupling)
    q = np.random.default_rng(1).uniform(-3, 3, (20, 6))
    assert axes.joint_position(axes.motor_position(q)) == pytest.approx(q, abs=1e-12)
    assert axes.joint_velocity(axes.motor_velocity(q)) == pytest.approx(q, abs=1e-12)
    assert axes.joint_position(np.zeros(6)) == pytest.approx(axes.zero_offset_rad)


def test_one_axis_by_hand():
    axes = conversion()
    assert axes.motor_position(np.array([0, -1.47, 0.1, 0.2, -0.3, 3.0])) == pytest.approx([0, -21.0, 0, 0, 0, 0])
    assert axes.joint_torque(np.array([2.0, 2.0, 2.0, 2.0, 2.0, 2.0])) == pytest.approx(
        [420.0, -420.0, -360.0, 120.0, -100.0, 80.0]
    )
    assert axes.motor_torque_of_current(np.full(6, 2.0)) == pytest.approx([3.6, 3.6, 3.0, 1.0, 0.8, 0.6])


def test_power_is_the_same_on_both_sides():
    """With true motor quantities (signs applied) torque . velocity agrees, whatever the coupling."""
    axes = conversion(coupling=coupled())
    random = np.random.default_rng(2)
    qd, motor_torque = random.normal(size=(2, 6))
    true_torque = motor_torque * axes.torque_sign
    true_velocity = axes.motor_velocity(qd) * axes.position_sign
    assert axes.joint_torque(motor_torque) @ qd == pytest.approx(true_torque @ true_velocity)


def test_staubli_wrist():
    """TX40: q_motor = R q, tau = R' tau_motor, R = diag(32, 32, 45, -48, 45, 32) and R[6, 5] = 32."""
    ratio = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    matrix = np.eye(6)
    matrix[5, 4] = 1.0
    ones = np.ones(6)
    axes = conversion(ratio=ratio, coupling=matrix, position_sign=ones, torque_sign=ones, zero_offset_rad=np.zeros(6))
    published = np.diag(ratio)
    published[5, 4] = 32.0
    random = np.random.default_rng(3)
    q, torque = random.normal(size=(2, 6))
    assert axes.motor_position(q) == pytest.approx(published @ q)
    assert axes.joint_torque(torque) == pytest.approx(published.T @ torque)
    assert axes.motor_torque(axes.joint_torque(torque)) == pytest.approx(torque)


def test_unmeasured_motor_blanks_only_the_joints_it_acts_on():
    axes = conversion(coupling=coupled())
    motor_torque = np.ones(6)
    motor_torque[5] = np.nan
    missing = np.isnan(axes.joint_torque(motor_torque))
    assert missing.tolist() == [False, False, False, False, True, True]


def test_spread_of_independent_motors_adds_in_squares():
    axes = conversion(coupling=coupled())
    std = np.array([0.1, 0.1, 0.1, 0.1, 0.3, 0.4])
    expected = np.hypot(0.3 * 50, 0.9 * 0.4 * 40)
    assert axes.joint_torque_std(std)[4] == pytest.approx(expected)


def test_half_sum_with_the_efficiency_of_each_side_is_gravity():
    """A joint that holds 800 Nm behind eta = 0.8: 1000 / N when driving up, 640 / N when let down."""
    axes = conversion(position_sign=np.ones(6), torque_sign=np.ones(6), efficiency=np.full(6, 0.8))
    gravity = np.full(6, 800.0)
    up, down = gravity / 0.8 / axes.ratio, gravity * 0.8 / axes.ratio
    assert axes.joint_torque_by_direction(up, np.ones(6)) == pytest.approx(gravity)
    assert axes.joint_torque_by_direction(down, -np.ones(6)) == pytest.approx(gravity)
    plain = (axes.joint_torque(up) + axes.joint_torque(down)) / 2
    assert plain / gravity == pytest.approx(np.full(6, (0.8 + 1 / 0.8) / 2))


def test_negative_load_swaps_the_sides_and_unknown_direction_applies_none():
    axes = conversion(position_sign=np.ones(6), torque_sign=np.ones(6), efficiency=np.full(6, 0.8))
    motor_torque = np.full(6, -1.0)
    bare = axes.joint_torque(motor_torque)
    positive_load = np.sign(bare)
    assert axes.joint_torque_by_direction(motor_torque, positive_load) == pytest.approx(bare * 0.8)
    assert axes.joint_torque_by_direction(motor_torque, -positive_load) == pytest.approx(bare / 0.8)
    assert axes.joint_torque_by_direction(motor_torque, np.zeros(6)) == pytest.approx(bare)
