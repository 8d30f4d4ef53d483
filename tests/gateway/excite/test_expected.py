"""Expected standard deviations: against drawn noise and an independent library, and against the limits of knowledge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
import pytest

from gateway.excite.expected import (
    DriveTrainAsked,
    LoadAsked,
    TorqueNoise,
    arm_rows,
    expected_stds,
    stds_of_all,
)
from gateway.excite.limits import States, point_acceleration_m_s2
from gateway.excite.random_series import Family
from gateway.feedforward.load import assumed_load
from gateway.identify.links import body_parameters
from gateway.model.arm_model import robot_text
from gateway.model.kinematics import link_frames
from tests.data.arms import link_parameters, peer_of, torque_of

PERIOD_S, PERIODS, INSTANTS = 8.0, 3, 80
LOAD = replace(assumed_load("tool", 5.0, np.array([0.03, -0.02, 0.1]), ""), inertia_kg_m2=np.diag([0.06, 0.05, 0.03]))


@pytest.fixture(scope="module")
def noise() -> TorqueNoise:
    exact = np.full(6, 1e-9)
    return TorqueNoise(np.array([1.0, 1.2, 0.6, 0.2, 0.15, 0.1]), 0.05, "test", exact)


@pytest.fixture(scope="module")
def states() -> States:
    family = Family.of(PERIOD_S, 5, INSTANTS)
    free = 0.25 * np.random.default_rng(4).standard_normal((1, family.free, 6))
    return family.states(np.array([[0.1, 0.2, -0.3, 0.4, 0.8, 0.5]]), free)


def test_a_series_of_a_family_starts_at_rest() -> None:
    family = Family.of(PERIOD_S, 5, INSTANTS)
    free = np.random.default_rng(0).standard_normal((family.free, 6))
    q, qd, qdd, _ = family.series("x", np.arange(6.0), free, 2).at(np.zeros(1))
    assert q[0] == pytest.approx(np.arange(6.0))
    assert np.abs([qd, qdd]).max() < 1e-12


def test_expected_load_stds_are_those_of_least_squares_on_drawn_noise(
    small_cell, workspace, noise, states: States
) -> None:
    """Torques by pinocchio, fitted with columns by pinocchio; noise of as many independent rows as it is for."""
    model, data = peer_of(robot_text(small_cell, small_cell.cell.arm[0]))
    rows = list(zip(states.q_rad, states.qd_rad_s, states.qdd_rad_s2, strict=True))
    columns = np.array([pinocchio.computeJointTorqueRegressor(model, data, *row).copy()[:, -10:] for row in rows])
    order = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]  # Ixx Ixy Iyy Ixz Iyz Izz of pinocchio as Ixx Ixy Ixz Iyy Iyz Izz
    columns = columns[:, :, order]
    truth = body_parameters(LOAD.mass_kg, LOAD.com_m, LOAD.inertia_kg_m2)
    moves = np.tanh(np.abs(states.qd_rad_s) / 0.02)
    independent = PERIODS * PERIOD_S / 0.1 / INSTANTS
    std = noise.std_nm / np.maximum(moves, 1e-9) * np.sqrt(2.0 / independent)
    lost = columns @ truth
    bare = torque_of(model, states.q_rad, states.qd_rad_s, states.qdd_rad_s2)
    lost = (np.abs(bare + lost) - np.abs(bare)) * np.tanh(states.qd_rad_s / 0.02)
    gain = (columns @ truth)[:, :, None] * np.eye(6)
    design = np.concatenate([columns, gain, lost[:, :, None] * np.eye(6)], axis=2) / std[:, :, None]
    # torque constants known exactly, and a gear whose losses of 5 % differ by a tenth between driving and driven back
    known = np.repeat([np.hypot(0.05**2 / 4, 0.1 * 0.05), 0.05], 6)
    design = np.vstack([design.reshape(-1, 22), np.eye(22)[10:] / known[:, None]])
    random = np.random.default_rng(7)
    found = []
    for _ in range(400):
        seen = design @ np.append(truth, known * random.standard_normal(12)) + random.standard_normal(len(design))
        seen[-12:] = 0.0
        mass, *rest = np.linalg.lstsq(design, seen, rcond=None)[0][:10]
        com = np.array(rest[:3]) / mass
        tensor = np.zeros((3, 3))
        tensor[np.triu_indices(3)] = rest[3:]
        tensor = tensor + np.triu(tensor, 1).T - mass * (com @ com * np.eye(3) - np.outer(com, com))
        found.append([mass, *com, *np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    asked = LoadAsked(workspace, noise, LOAD, link_parameters(workspace.robot))
    weighted = asked.rows(states, arm_rows(workspace, states), 1, PERIODS * PERIOD_S)
    expected = stds_of_all(asked, weighted)
    assert expected == pytest.approx(np.std(found, axis=0), rel=0.15)
    assert expected_stds(asked, weighted, 1)[0] == pytest.approx(expected, rel=1e-3)


def test_the_derivative_of_mass_centre_and_inertia_is_that_of_differences(workspace) -> None:
    def numbers(p: np.ndarray) -> np.ndarray:
        com = p[1:4] / p[0]
        about = np.zeros((3, 3))
        about[np.triu_indices(3)] = p[4:]
        about = about + np.triu(about, 1).T - p[0] * (com @ com * np.eye(3) - np.outer(com, com))
        return np.array([p[0], *com, *np.diag(about), about[0, 1], about[0, 2], about[1, 2]])

    at = LOAD.parameters
    step = 1e-6
    slopes = np.column_stack([(numbers(at + step * e) - numbers(at - step * e)) / (2 * step) for e in np.eye(10)])
    exact = TorqueNoise(np.ones(6), 0.05, "test", np.full(6, 1e-9))
    assert LoadAsked(workspace, exact, LOAD, None).turn[:, :10] == pytest.approx(slopes, abs=1e-6)


def test_gains_that_are_not_known_bound_the_mass_and_leave_its_place(workspace, noise, states: States) -> None:
    rigid = arm_rows(workspace, states)

    def expected(gain: float) -> np.ndarray:
        asked = LoadAsked(workspace, replace(noise, gain_std=np.full(6, gain)), LOAD, link_parameters(workspace.robot))
        return stds_of_all(asked, asked.rows(states, rigid, 1, 24.0))

    assert expected(0.05)[0] > 3 * expected(1e-9)[0]
    assert 0.01 * LOAD.mass_kg < expected(0.05)[0] < 0.05 * LOAD.mass_kg


def test_a_load_is_not_identifiable_where_only_the_last_joint_moves(workspace, noise, states: States) -> None:
    """The last joint alone: neither mass nor centre of gravity shows."""
    still = np.zeros_like(states.q_rad)
    last = np.eye(6)[5]
    posture = still + [0.0, 0.2, -0.3, 0.4, 0.8, 0.5]
    alone = States(posture, last * states.qd_rad_s, last * states.qdd_rad_s2, still)
    asked = LoadAsked(workspace, noise, LOAD, link_parameters(workspace.robot))
    expected = stds_of_all(asked, asked.rows(alone, arm_rows(workspace, alone), 1, 24.0))
    assert np.isnan(expected[:4]).all()


def test_coulomb_friction_at_one_speed_is_not_separable_from_viscous(workspace, noise) -> None:
    steady = np.zeros((200, 6))
    speed = np.zeros((200, 6))
    speed[:100, 3], speed[100:, 3] = 0.4, -0.4
    steady[:, 3] = np.concatenate([np.linspace(-1, 1, 100), np.linspace(1, -1, 100)])
    asked = DriveTrainAsked.of(workspace, noise, "friction", link_parameters(workspace.robot), 0.05)

    def expected(*speeds: float) -> np.ndarray:
        each = [States(steady, factor * speed, 0 * speed, 0 * speed) for factor in speeds]
        rows = [asked.rows(at, arm_rows(workspace, at), 1, 20.0) for at in each]
        return stds_of_all(asked, np.concatenate(rows))

    assert np.isnan(expected(1.0)[[3, 9]]).all()
    assert np.isfinite(expected(1.0, 0.25)[[3, 9]]).all()
    assert np.isnan(expected(1.0, 0.25)[[0, 6]]).all()


def test_the_acceleration_of_a_point_is_that_of_its_places(workspace) -> None:
    random = np.random.default_rng(5)
    point = np.array([0.05, -0.1, 0.2])
    q, qd, qdd = random.uniform(-1, 1, (3, 4, 6))

    def place(time_s: float) -> np.ndarray:
        frames = link_frames(workspace.robot, q + qd * time_s + 0.5 * qdd * time_s**2)[:, -1]
        return frames[:, :3, :3] @ point + frames[:, :3, 3]

    step = 1e-4
    seen = (place(step) - 2 * place(0.0) + place(-step)) / step**2
    assert point_acceleration_m_s2(workspace.robot, States(q, qd, qdd, qdd), point) == pytest.approx(seen, abs=1e-5)
