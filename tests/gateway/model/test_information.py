"""Information of poses against the covariance of an explicit least squares problem."""

import numpy as np
import pytest

from gateway.model.information import expected_std, payload_information
from gateway.model.regressor import load_regressor
from gateway.model.robot import robot_from_urdf


def test_sum_over_poses_is_the_inverse_covariance_of_the_difference(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    sigma = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.3])
    rows = (load_regressor(robot, q) / (np.sqrt(2) * sigma)[:, None]).reshape(-1, 4)
    total = payload_information(robot, q, sigma).sum(axis=0)
    np.testing.assert_allclose(total, rows.T @ rows, rtol=1e-12)
    covariance = np.linalg.inv(rows.T @ rows)
    mass, com = 4.0, np.array([0.1, -0.2, 0.3])
    mass_std, com_std = expected_std(total, mass, com)
    assert mass_std == pytest.approx(np.sqrt(covariance[0, 0]))
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(np.concatenate([[mass], mass * com]), covariance * 1e-6, 20000)
    np.testing.assert_allclose(com_std * 1e-3, (draws[:, 1:] / draws[:, :1]).std(axis=0), rtol=0.03)


def test_one_pose_leaves_the_centre_of_mass_open_but_gives_the_mass(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(3).uniform(-3, 3, (1, 6))
    mass_std, com_std = expected_std(payload_information(robot, q, np.ones(6))[0], 4.0, np.zeros(3))
    assert np.isfinite(mass_std)
    assert np.isinf(com_std).all()


def test_an_axis_that_is_not_measured_adds_nothing(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(3).uniform(-3, 3, (2, 6))
    none = payload_information(robot, q, np.full(6, np.nan))
    assert (none == 0).all()
    assert np.isinf(expected_std(none[0], 1.0, np.zeros(3))[0])
