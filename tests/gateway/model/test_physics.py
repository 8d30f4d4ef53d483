"""Laws that hold for every arm: energy, symmetry, dimensions, and that nothing depends on the frames chosen."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.identify.links import link_values
from gateway.model.kinematics import joint_axes_origins, kinematic_difference, link_frames
from gateway.model.regressor import regressor
from gateway.model.robot import Robot, robot_from_urdf

GRAVITY = np.array([1.0, -2.0, -9.0])


@pytest.fixture(params=range(3))
def robot(request, random_urdf) -> Robot:
    return robot_from_urdf(random_urdf(request.param), "random.urdf")


def state(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = np.random.default_rng(seed).uniform(-1.5, 1.5, (3, 6))
    return q, qd, qdd


def torque(robot: Robot, q, qd, qdd, gravity=GRAVITY) -> np.ndarray:
    rows = regressor(robot, q[None], qd[None], qdd[None], tuple(gravity))[0]
    return rows @ link_values(robot).ravel()


def mass_matrix(robot: Robot, q) -> np.ndarray:
    still = np.zeros(6)
    return np.column_stack([torque(robot, q, still, unit, np.zeros(3)) for unit in np.eye(6)])


def potential(robot: Robot, q) -> float:
    frames = link_frames(robot, q[None])[0]
    places = frames[:, :3, 3] + np.einsum("ijk,ik->ij", frames[:, :3, :3], robot.com_m)
    return float(-(robot.mass_kg * (places @ GRAVITY)).sum())


def energy(robot: Robot, q, qd) -> float:
    return float(0.5 * qd @ mass_matrix(robot, q) @ qd) + potential(robot, q)


def test_power_of_the_motors_is_the_change_of_the_energy(robot):
    q, qd, qdd = state(1)
    step = 1e-5
    ahead = energy(robot, q + step * qd + 0.5 * step**2 * qdd, qd + step * qdd)
    behind = energy(robot, q - step * qd + 0.5 * step**2 * qdd, qd - step * qdd)
    assert torque(robot, q, qd, qdd) @ qd == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-6)


def test_mass_matrix_is_symmetric_and_positive(robot):
    matrix = mass_matrix(robot, state(2)[0])
    assert matrix == pytest.approx(matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0.0


def test_mass_matrix_does_not_turn_with_the_first_joint(robot):
    q = state(3)[0]
    turned = q + np.array([0.8, 0, 0, 0, 0, 0])
    assert mass_matrix(robot, turned) == pytest.approx(mass_matrix(robot, q))


def test_torque_at_rest_is_the_slope_of_the_potential_energy(robot):
    q, still, step = state(4)[0], np.zeros(6), 1e-6
    slope = [(potential(robot, q + step * unit) - potential(robot, q - step * unit)) / (2 * step) for unit in np.eye(6)]
    assert torque(robot, q, still, still) == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_velocities_enter_squared_and_backwards_is_as_forwards(robot):
    q, qd, _ = state(5)
    still, nothing = np.zeros(6), np.zeros(3)
    once = torque(robot, q, qd, still, nothing)
    assert torque(robot, q, 2.0 * qd, still, nothing) == pytest.approx(4.0 * once)
    assert torque(robot, q, -qd, still, nothing) == pytest.approx(once)


def test_turning_base_and_gravity_together_changes_no_torque(robot):
    q, qd, qdd = state(6)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    placement = robot.placement.copy()
    placement[0, :3, :3] = turn @ placement[0, :3, :3]
    placement[0, :3, 3] = turn @ placement[0, :3, 3] + [3.0, -1.0, 2.0]
    moved = replace(robot, placement=placement)
    assert torque(moved, q, qd, qdd, turn @ GRAVITY) == pytest.approx(torque(robot, q, qd, qdd))


def test_another_frame_of_a_link_changes_no_torque(robot):
    """The frame of link 4 is turned about its joint's axis and slid along it; its body stays where it is."""
    q, qd, qdd = state(7)
    axis, slid = robot.axis[3], 0.13 * robot.axis[3]
    turn = Rotation.from_rotvec(0.9 * axis).as_matrix()
    change, back = np.eye(4), np.eye(4)
    change[:3, :3], change[:3, 3] = turn, slid
    back[:3, :3], back[:3, 3] = turn.T, -turn.T @ slid
    placement = robot.placement.copy()
    placement[3], placement[4] = placement[3] @ change, back @ placement[4]
    com, inertia = robot.com_m.copy(), robot.inertia_kg_m2.copy()
    com[3] = turn.T @ (com[3] - slid)
    inertia[3] = turn.T @ inertia[3] @ turn
    other = replace(robot, placement=placement, com_m=com, inertia_kg_m2=inertia)
    assert torque(other, q, qd, qdd) == pytest.approx(torque(robot, q, qd, qdd))
    assert kinematic_difference(robot, other) == ""


def test_columns_have_the_dimensions_of_their_parameters(robot):
    """With all lengths and gravity doubled: four times the torque per kg, twice per kg m, as much per kg m2."""
    q, qd, qdd = state(8)
    placement = robot.placement.copy()
    placement[:, :3, 3] *= 2.0
    larger = replace(robot, placement=placement)
    plain = regressor(robot, q[None], qd[None], qdd[None], tuple(GRAVITY))[0].reshape(6, 6, 10)
    scaled = regressor(larger, q[None], qd[None], qdd[None], tuple(2.0 * GRAVITY))[0].reshape(6, 6, 10)
    assert scaled[:, :, 0] == pytest.approx(4.0 * plain[:, :, 0])
    assert scaled[:, :, 1:4] == pytest.approx(2.0 * plain[:, :, 1:4])
    assert scaled[:, :, 4:] == pytest.approx(plain[:, :, 4:])


def test_frames_are_rotations_and_axes_are_unit(robot):
    q = state(9)[0]
    turns = link_frames(robot, q[None])[0, :, :3, :3]
    assert turns @ np.swapaxes(turns, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), (6, 3, 3)), abs=1e-12)
    assert np.linalg.det(turns) == pytest.approx(np.ones(6))
    assert np.linalg.norm(joint_axes_origins(robot, q[None])[0][0], axis=1) == pytest.approx(np.ones(6))


def test_jacobian_is_axis_times_lever(robot):
    """A point of link 6 moves by the cross product of each joint's axis and its lever."""
    q, step, point = state(10)[0], 1e-6, np.array([0.1, 0.2, 0.3])

    def place(angles: np.ndarray) -> np.ndarray:
        frame = link_frames(robot, angles[None])[0, 5]
        return frame[:3, :3] @ point + frame[:3, 3]

    axes, origins = joint_axes_origins(robot, q[None])
    expected = np.cross(axes[0], place(q) - origins[0])
    found = [(place(q + step * unit) - place(q - step * unit)) / (2 * step) for unit in np.eye(6)]
    assert np.array(found) == pytest.approx(expected, abs=1e-8)


def test_another_arm_is_recognized_by_its_axes(robot):
    placement = robot.placement.copy()
    placement[2, :3, 3] += 0.02
    apart = re.search(r"differ by (\d+) mm", kinematic_difference(robot, replace(robot, placement=placement)))
    assert apart is not None
    assert 4 <= int(apart[1]) <= 35, "of the 35 mm, offset of the arm as a whole"
    axis = robot.axis.copy()
    axis[4] = -axis[4]
    assert "differ by 180.0 degrees" in kinematic_difference(robot, replace(robot, axis=axis))
