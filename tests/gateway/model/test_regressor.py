"""Rows against pinocchio, PyBullet's inverse dynamics, finite differences of the energy and a worked-out vector."""

import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from gateway.model import regressor as rows_of
from gateway.model.kinematics import link_frames
from gateway.model.robot import robot_from_urdf
from tests.data.arms import link_parameters, peer_of, states, torque_of

# pinocchio keeps [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]
FROM_PINOCCHIO = np.concatenate([10 * link + np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9]) for link in range(6)])
GRAVITY_COLUMNS = np.concatenate([10 * link + np.arange(4) for link in range(6)])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (3.0, -2.0, -9.0)])
def test_full_rows_agree_with_pinocchio(random_urdf, seed, gravity):
    text = random_urdf(seed)
    robot = robot_from_urdf(text, "random.urdf")
    model, data = peer_of(text, gravity)
    q, qd, qdd = states(seed, 40)
    rows = rows_of.regressor(robot, q, qd, qdd, gravity)
    for n in range(len(q)):
        oracle = pinocchio.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])[:, FROM_PINOCCHIO]
        np.testing.assert_allclose(rows[n], oracle, rtol=0, atol=1e-12 * np.abs(oracle).max())
    torque = torque_of(model, q, qd, qdd)
    np.testing.assert_allclose(rows @ link_parameters(robot), torque, rtol=1e-9, atol=1e-9)


def test_full_rows_agree_with_bullet_inverse_dynamics(random_urdf):
    bullet = pytest.importorskip("pybullet")
    text = random_urdf(7)
    robot = robot_from_urdf(text, "random.urdf")
    client = bullet.connect(bullet.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text)
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    bullet.setGravity(0, 0, -9.80665, physicsClientId=client)
    q, qd, qdd = states(1, 10)
    rows = rows_of.regressor(robot, q, qd, qdd)
    for n in range(len(q)):
        torque = bullet.calculateInverseDynamics(body, list(q[n]), list(qd[n]), list(qdd[n]), physicsClientId=client)
        np.testing.assert_allclose(rows[n] @ link_parameters(robot), torque, rtol=1e-6, atol=1e-5)
    bullet.disconnect(client)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (1.0, 2.0, 3.0), (9.8, 0.0, 0.0)])
def test_rest_rows_are_the_full_rows_at_rest(random_urdf, gravity):
    robot = robot_from_urdf(random_urdf(2), "r")
    q = states(3, 30)[0]
    still = np.zeros_like(q)
    full = rows_of.regressor(robot, q, still, still, gravity)
    rest = rows_of.gravity_regressor(robot, q, gravity)
    np.testing.assert_allclose(rest, full[:, :, GRAVITY_COLUMNS], atol=1e-12)
    np.testing.assert_allclose(rows_of.load_regressor(robot, q, gravity), rest[:, :, rows_of.LOAD_COLUMNS], atol=1e-13)


def test_rest_rows_are_the_slope_of_the_potential_energy(random_urdf):
    robot = robot_from_urdf(random_urdf(4), "r")
    q = states(4, 3)[0]

    def energy(angles):
        frames = link_frames(robot, angles)
        com = np.einsum("nijk,ik->nij", frames[:, :, :3, :3], robot.com_m) + frames[:, :, :3, 3]
        return 9.80665 * com[:, :, 2] @ robot.mass_kg

    phi = np.concatenate([[m, *(m * c)] for m, c in zip(robot.mass_kg, robot.com_m, strict=True)])
    step = 1e-6
    for axis in range(6):
        turn = step * np.eye(6)[axis]
        slope = (energy(q + turn) - energy(q - turn)) / (2 * step)
        np.testing.assert_allclose(rows_of.gravity_regressor(robot, q)[:, axis] @ phi, slope, rtol=1e-6, atol=1e-5)


def test_vector_of_the_six_axis_arm_without_parallel_link(six_axes):
    q = np.deg2rad([[0.0, 40.0, -100.0, 30.0, 50.0, -20.0]])
    torque = rows_of.load_regressor(six_axes, q)[0] @ [10.0, 0.2, -0.3, 1.5]
    np.testing.assert_allclose(torque, [0, 111.493545, 66.419567, -10.475956, 3.178560, 0.022018], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 351, 352, 353, 521, 1100])
def test_blocks_change_nothing(random_urdf, count):
    robot = robot_from_urdf(random_urdf(5), "r")
    q, qd, qdd = states(6, 1100)
    rest = rows_of.gravity_regressor(robot, q[:count])
    np.testing.assert_allclose(rest, rows_of.gravity_regressor(robot, q)[:count], atol=1e-13)
    full = rows_of.regressor(robot, q[:count], qd[:count], qdd[:count])
    assert full.shape == (count, 6, 60)
    np.testing.assert_allclose(full, rows_of.regressor(robot, q, qd, qdd)[:count], atol=1e-12)


def test_rows_are_written_where_they_are_wanted(random_urdf):
    robot = robot_from_urdf(random_urdf(5), "r")
    q, qd, qdd = states(6, 400)
    store = np.full((400, 6, 60), np.nan)
    assert rows_of.regressor(robot, q, qd, qdd, out=store) is store
    np.testing.assert_array_equal(store, rows_of.regressor(robot, q, qd, qdd))
    wide = np.full((400, 6, 30), np.nan)
    rows_of.gravity_regressor(robot, q, out=wide[:, :, 3:27])
    np.testing.assert_array_equal(wide[:, :, 3:27], rows_of.gravity_regressor(robot, q))
    with pytest.raises(ValueError, match="shape"):
        rows_of.regressor(robot, q, qd, qdd, out=store[:10])
    with pytest.raises(ValueError, match="shape"):
        rows_of.gravity_regressor(robot, q[:, :5])


def test_memory_beyond_the_result_does_not_grow_with_the_rows(random_urdf):
    robot = robot_from_urdf(random_urdf(5), "r")

    def beyond(count):
        q, qd, qdd = states(6, count)
        store = np.empty((count, 6, 60))
        tracemalloc.start()
        rows_of.regressor(robot, q, qd, qdd, out=store)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak, store.nbytes

    small, _ = beyond(1000)
    large, size = beyond(40_000)
    assert large < 1.5 * small
    assert large < 0.1 * size


@pytest.mark.parametrize(
    ("q", "out", "says"),
    [
        (np.zeros(6), None, "need the shape"),
        (np.zeros((3, 5)), None, "need the shape"),
        (np.zeros((3, 6)), np.zeros((3, 6, 23)), "out needs the shape"),
        (np.zeros((3, 6)), np.zeros((2, 6, 24)), "out needs the shape"),
    ],
)
def test_arrays_of_another_shape_are_refused(random_urdf, q, out, says):
    robot = robot_from_urdf(random_urdf(0), "a.urdf")
    with pytest.raises(ValueError, match=says):
        rows_of.gravity_regressor(robot, q, out=out)
    with pytest.raises(ValueError, match=says):
        rows_of.load_regressor(robot, q, out=None if out is None else np.zeros((9, 6, 4)))
