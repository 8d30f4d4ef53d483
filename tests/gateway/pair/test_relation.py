"""Eqs. (3) and (4) against each other and against plain matrix algebra."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gateway.pair.transform import relation, slave_command
from gateway.pair.transform_function import function_of_knots


def random_poses(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


def test_slave_command_inverts_relation() -> None:
    w_t_b1, w_t_b2 = random_poses(2, 1)
    first, second = random_poses(9, 2), random_poses(9, 3)
    between = relation(w_t_b1, first, w_t_b2, second)
    assert np.allclose(between, np.linalg.inv(w_t_b1 @ first) @ (w_t_b2 @ second), atol=1e-12)
    assert np.allclose(slave_command(w_t_b1, first, w_t_b2, between), second, atol=1e-12)


def test_taught_points_are_reproduced() -> None:
    w_t_b1, w_t_b2 = random_poses(2, 5)
    first = random_poses(5, 6)
    near = Rotation.from_rotvec(np.random.default_rng(7).normal(scale=0.01, size=(5, 3))).as_matrix()
    second = np.linalg.inv(w_t_b2) @ w_t_b1 @ first
    second[:, :3, :3] = second[:, :3, :3] @ near
    function = function_of_knots(np.arange(5.0), relation(w_t_b1, first, w_t_b2, second))
    for k in range(5):
        command = slave_command(w_t_b1, first[k], w_t_b2, function.at(float(k)))
        assert np.allclose(command, second[k], atol=1e-13)
