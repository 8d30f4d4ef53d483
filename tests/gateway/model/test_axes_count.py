"""Arms of one to eight axes: frames and rows against pinocchio, base parameters against singular values."""

from types import SimpleNamespace

import numpy as np
import pinocchio
import pytest

from gateway.errors import ConfigError
from gateway.model.base import moving_base, rest_base
from gateway.model.kinematics import kinematic_difference, link_frames
from gateway.model.regressor import full_names, gravity_names, gravity_regressor, load_regressor, regressor
from gateway.model.robot import robot_from_dh, robot_from_urdf
from tests.cells import CELLS
from tests.data.arms import link_parameters, peer_of, states, torque_of, urdf_of

WITHIN_LINK = np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9])
TEXTS = {f"random {axes}": urdf_of(np.random.default_rng(axes), axes=axes) for axes in (1, 2, 3, 4, 5, 7, 8)}
TEXTS |= {cell.name: cell.urdf for cell in CELLS}


def from_pinocchio(axes):
    """Columns of ours in pinocchio's order [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]."""
    return np.concatenate([10 * link + WITHIN_LINK for link in range(axes)])


@pytest.fixture(params=TEXTS)
def text(request):
    return TEXTS[request.param]


def test_frames_are_those_of_pinocchio(text):
    robot = robot_from_urdf(text, "arm.urdf")
    model, data = peer_of(text)
    q = states(1, 20, robot.axes)[0]
    frames = link_frames(robot, q)
    assert frames.shape == (20, robot.axes, 4, 4)
    for row, angles in enumerate(q):
        pinocchio.forwardKinematics(model, data, angles)
        for link in range(robot.axes):
            np.testing.assert_allclose(frames[row, link], data.oMi[link + 1].homogeneous, atol=1e-12)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (3.0, -2.0, -9.0)])
def test_rows_are_those_of_pinocchio(text, gravity):
    robot = robot_from_urdf(text, "arm.urdf")
    model, data = peer_of(text, gravity)
    q, qd, qdd = states(2, 400, robot.axes)
    full, rest = regressor(robot, q, qd, qdd, gravity), gravity_regressor(robot, q, gravity)
    assert full.shape[1:] == (robot.axes, 10 * robot.axes)
    assert rest.shape[1:] == (robot.axes, 4 * robot.axes)
    for n in range(0, len(q), 20):
        oracle = np.atleast_2d(pinocchio.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n]))
        np.testing.assert_allclose(full[n], oracle[:, from_pinocchio(robot.axes)], atol=1e-11 * np.abs(oracle).max())
    torque, still = torque_of(model, q, qd, qdd), torque_of(model, q)
    np.testing.assert_allclose(full @ link_parameters(robot), torque, rtol=1e-9, atol=1e-9)
    phi = np.concatenate([[m, *(m * c)] for m, c in zip(robot.mass_kg, robot.com_m, strict=True)])
    np.testing.assert_allclose(rest @ phi, still, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(load_regressor(robot, q, gravity), rest[:, :, -4:], atol=1e-13)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.name)
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (1.0, -2.0, -9.5)])
def test_base_ranks_are_the_numerical_ranks_of_pinocchios_rows(cell, gravity):
    model, data = peer_of(cell.urdf, gravity)
    q, qd, qdd = states(3, 300, cell.axes)
    states_of = zip(q, qd, qdd, strict=True)
    rows = np.array([pinocchio.computeJointTorqueRegressor(model, data, *row).copy() for row in states_of])
    still = np.zeros(cell.axes)
    rest = np.array([pinocchio.computeJointTorqueRegressor(model, data, row, still, still).copy() for row in q])
    for base, matrix in ((moving_base(cell.robot, gravity), rows), (rest_base(cell.robot, gravity), rest)):
        stacked = matrix.reshape(-1, 10 * cell.axes)
        length = np.linalg.norm(stacked, axis=0)
        seen = length > 1e-12 * length.max()
        size = np.linalg.svd(stacked[:, seen] / length[seen], compute_uv=False)
        assert base.rank == int((size > 1e-9 * size[0]).sum())


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.name)
def test_names_count_to_the_last_link(cell):
    assert full_names(cell.axes)[-1] == f"Izz_{cell.axes}"
    assert gravity_names(cell.axes)[-1] == f"hz_{cell.axes}"
    assert cell.robot.last_link == f"link_{cell.axes}"
    assert any(f"_{cell.axes}" in name for name in rest_base(cell.robot).names)


@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_a_table_of_seven_rows_is_the_arm_of_seven_axes(convention):
    """The lightweight arm's lines by Denavit-Hartenberg rows; its last axis is shifted in the URDF."""
    quarter, along = np.pi / 2, (0.36, 0.0, 0.42, 0.0, 0.40, 0.0)
    turns = (-quarter, quarter, quarter, -quarter, -quarter, quarter)
    alpha = (0.0, *turns) if convention == "modified" else (*turns, 0.0)
    # fmt: off
    robot = robot_from_dh(SimpleNamespace(
        convention=convention, alpha_rad=alpha, a_m=(0.0,) * 7, d_m=(*along, 0.08), theta_offset_rad=(0.0,) * 7,
    ))
    # fmt: on
    assert robot.axes == 7
    q = states(4, 5, 7)[0]
    frame = np.tile(np.eye(4), (5, 1, 1))
    for i, (turn, d) in enumerate(zip((*turns, 0.0), (*along, 0.08), strict=True)):
        c, s, ct, st = np.cos(q[:, i]), np.sin(q[:, i]), np.cos(turn), np.sin(turn)
        zero, one = np.zeros(5), np.ones(5)
        rows = [[c, -s * ct, s * st, zero], [s, c * ct, -c * st, zero], [zero, st * one, ct * one, d * one]]
        frame = frame @ np.moveaxis(np.array([*rows, [zero, zero, zero, one]]), 2, 0)
    np.testing.assert_allclose(link_frames(robot, q)[:, -1, :3, 3], frame[:, :3, 3], atol=1e-12)


def test_arms_of_different_counts_are_different_arms():
    four, seven = (cell.robot for cell in CELLS)
    assert kinematic_difference(four, seven) == "one has 4 axes, the other 7"
    assert kinematic_difference(four, four) == ""


def test_positions_of_another_count_are_refused_by_both_counts():
    with pytest.raises(ValueError, match=r"\(n, 4\), got \(3, 6\)"):
        gravity_regressor(CELLS[0].robot, np.zeros((3, 6)))


def test_too_many_axes_are_refused():
    with pytest.raises(ConfigError, match="has 9 moving joints in its chain, 1 to 8"):
        robot_from_urdf(urdf_of(np.random.default_rng(0), axes=9), "arm.urdf")
