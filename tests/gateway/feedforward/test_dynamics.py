"""Recursive Newton-Euler in plain floats against pinocchio, PyBullet and the rows of the estimators."""

from __future__ import annotations

import time

import numpy as np
import pytest

from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.load import FeedLoad
from gateway.model.regressor import regressor
from gateway.model.robot import robot_from_urdf
from tests.cells import CELLS
from tests.data.arms import carrying, link_parameters, peer_of, states, torque_of

GRAVITY = (1.5, -2.0, -9.0)


def torques(dynamics, q, qd, qdd):
    return np.array([dynamics.torque(*row) for row in zip(q.tolist(), qd.tolist(), qdd.tolist(), strict=True)])


@pytest.mark.parametrize("seed", range(4))
def test_torque_agrees_with_pinocchio(random_urdf, seed):
    text = random_urdf(seed)
    robot = robot_from_urdf(text, "random.urdf")
    q, qd, qdd = states(seed, 30)
    expected = torque_of(peer_of(text, GRAVITY)[0], q, qd, qdd)
    found = torques(ArmDynamics(robot, link_parameters(robot), GRAVITY), q, qd, qdd)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.name)
def test_torque_of_an_arm_that_has_not_six_axes_agrees_with_pinocchio(cell):
    q, qd, qdd = states(1, 30, cell.axes)
    expected = torque_of(peer_of(cell.urdf, GRAVITY)[0], q, qd, qdd)
    dynamics = ArmDynamics(cell.robot, link_parameters(cell.robot), GRAVITY)
    assert dynamics.axes == cell.axes
    np.testing.assert_allclose(torques(dynamics, q, qd, qdd), expected, rtol=1e-10, atol=1e-9)


def test_torque_agrees_with_the_rows_for_any_parameters(random_urdf):
    robot = robot_from_urdf(random_urdf(9), "random.urdf")
    parameters = np.random.default_rng(1).normal(size=60)
    q, qd, qdd = states(2, 50)
    found = torques(ArmDynamics(robot, parameters, GRAVITY), q, qd, qdd)
    np.testing.assert_allclose(found, regressor(robot, q, qd, qdd, GRAVITY) @ parameters, rtol=1e-10, atol=1e-10)


def test_a_load_is_a_body_fixed_to_link_6(random_urdf):
    load = FeedLoad("a", 7.0, np.array([0.1, -0.05, 0.3]), np.diag([0.2, 0.3, 0.4]), "test", "test")
    model = carrying(peer_of(random_urdf(5), GRAVITY)[0], load.mass_kg, load.com_m, load.inertia_kg_m2)
    robot = robot_from_urdf(random_urdf(5), "random.urdf")
    parameters = link_parameters(robot)
    parameters[50:] += load.parameters
    q, qd, qdd = states(5, 20)
    expected = torque_of(model, q, qd, qdd)
    found = torques(ArmDynamics(robot, parameters, GRAVITY), q, qd, qdd)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)


def test_torque_agrees_with_bullet(random_urdf, tmp_path):
    bullet = pytest.importorskip("pybullet")
    (tmp_path / "arm.urdf").write_text(random_urdf(6))
    robot = robot_from_urdf(random_urdf(6), "random.urdf")
    q, qd, qdd = states(6, 20)
    client = bullet.connect(bullet.DIRECT)
    try:
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(tmp_path / "arm.urdf"), useFixedBase=True, flags=flags, physicsClientId=client)
        bullet.setGravity(*GRAVITY, physicsClientId=client)
        expected = [
            bullet.calculateInverseDynamics(body, *(list(part) for part in row), physicsClientId=client)
            for row in zip(q, qd, qdd, strict=True)
        ]
    finally:
        bullet.disconnect(client)
    found = torques(ArmDynamics(robot, link_parameters(robot), GRAVITY), q, qd, qdd)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_unknown_parameters_are_refused(qh165):
    with pytest.raises(ValueError, match="finite"):
        ArmDynamics(qh165, np.full(60, np.nan))


def test_one_instant_takes_far_less_than_a_sync(qh165):
    """Ten times the goal: a busy machine must not fail this; the figure itself is printed by `make follow`."""
    dynamics = ArmDynamics(qh165, link_parameters(qh165))
    q, qd, qdd = (part[0].tolist() for part in states(0, 1))
    best = min(_timed(lambda: dynamics.torque(q, qd, qdd)) for _ in range(20))
    assert best < 1e-3


def _timed(action):
    begun = time.process_time()
    for _ in range(20):
        action()
    return (time.process_time() - begun) / 20
