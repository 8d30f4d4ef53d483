"""Information of poses against the normal equations of an explicit least squares problem."""

import numpy as np
import pytest

from gateway.estimate.recommendation import payload_information
from gateway.model.regressor import load_regressor
from gateway.model.robot import robot_from_urdf


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), (0.0, 9.80665, 0.0)])
def test_sum_over_poses_is_the_information_of_the_difference(random_urdf, gravity):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    sigma = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.3])
    rows = (load_regressor(robot, q, gravity) / (np.sqrt(2) * sigma)[:, None]).reshape(-1, 4)
    total = payload_information(robot, q, sigma, gravity).sum(axis=0)
    np.testing.assert_allclose(total, rows.T @ rows, rtol=1e-12)


def test_one_pose_does_not_determine_a_load(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(3).uniform(-3, 3, (1, 6))
    assert np.linalg.matrix_rank(payload_information(robot, q, np.ones(6))[0]) == 3


def test_an_axis_that_is_not_measured_adds_nothing(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(3).uniform(-3, 3, (2, 6))
    none = payload_information(robot, q, np.full(6, np.nan))
    assert (none == 0).all()
