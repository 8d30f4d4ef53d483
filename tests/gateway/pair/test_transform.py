"""Rotations and the correction rule against scipy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.pair.transform import (
    apply_correction,
    corrected_pose,
    correction_between,
    exp_rotation,
    inverse,
    log_rotation,
    pose,
)


def random_poses(count: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return pose(Rotation.random(count, rng=rng).as_matrix(), rng.normal(size=(count, 3)))


def test_rodrigues_is_a_rotation_and_agrees_with_scipy() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        axis, angle = rng.normal(size=3), rng.uniform(-4.0, 4.0)
        matrix = exp_rotation(angle * axis / np.linalg.norm(axis))
        assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)
        expected = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        assert np.allclose(matrix, expected, atol=1e-14)


def test_the_matrix_as_printed_is_no_rotation() -> None:
    """Eq. (9) with every sine term replaced by +cos and kx^2 in each diagonal place."""
    k = np.array([2.0, 3.0, 6.0]) / 7.0
    c = np.cos(0.01)
    v = 1.0 - c
    printed = np.outer(k, k) * v + c * (np.ones((3, 3)) - np.eye(3)) + np.diag([k[0] ** 2 * v + c] * 3)
    assert abs(np.linalg.det(printed)) < 0.01
    assert np.linalg.det(exp_rotation(0.01 * k)) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.9e-6, 1.1e-6, 1e-3, 1.0, 3.0, np.pi - 2e-3, np.pi - 1e-9])
def test_logarithm_inverts_the_exponential(angle: float) -> None:
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    vector = log_rotation(exp_rotation(angle * axis))
    assert np.allclose(vector, angle * axis, atol=1e-7 if angle > 3.1 else 1e-13)
    assert np.allclose(log_rotation(Rotation.from_rotvec(angle * axis).as_matrix()[None])[0], vector, atol=1e-7)


def test_half_turn_has_length_pi() -> None:
    for axis in np.eye(3):
        vector = log_rotation(exp_rotation(np.pi * axis))
        assert np.linalg.norm(vector) == pytest.approx(np.pi)
        assert np.allclose(np.abs(vector), np.pi * axis, atol=1e-9)


def test_inverse_of_stacks() -> None:
    poses = random_poses(7)
    assert np.allclose(inverse(poses), np.linalg.inv(poses), atol=1e-13)


def test_correction_adds_and_does_not_turn_the_position() -> None:
    target = pose(exp_rotation([0, 0, np.pi / 2]), [1.0, 0.0, 0.0])
    corrected = apply_correction(target, [0.0, 0.0, 0.001, 0.0, 0.0, 0.002])
    assert np.allclose(corrected[:3, 3], [1.0, 0.0, 0.001], atol=1e-15)
    assert np.allclose(corrected[:3, :3], exp_rotation([0, 0, np.pi / 2 + 0.002]), atol=1e-14)
    product = pose(exp_rotation([0, 0, 0.002]), [0.0, 0.0, 0.001]) @ target
    assert np.allclose(product[:3, 3], [1.0, 0.002, 0.001], atol=1e-5)


def test_correction_between_inverts_the_addition() -> None:
    poses = random_poses(20)
    corrections = np.random.default_rng(4).normal(scale=0.3, size=(20, 6))
    assert np.allclose(correction_between(apply_correction(poses, corrections), poses), corrections, atol=1e-12)


@pytest.mark.parametrize("size_rad", [0.0, 1e-9, 1e-5, 9e-7, 1.1e-6, 0.02, 0.7, 3.0])
def test_one_correction_at_a_time_is_that_of_an_independent_library(size_rad: float) -> None:
    """Both branches: the series for small turns and the closed form."""
    rng = np.random.default_rng(7)
    for transform in random_poses(5):
        axis = rng.normal(size=3)
        turn = size_rad * axis / np.linalg.norm(axis)
        change = np.concatenate([rng.normal(size=3), turn])
        found = corrected_pose(transform, change)
        assert found[:3, :3] == pytest.approx(Rotation.from_rotvec(turn).as_matrix() @ transform[:3, :3], abs=1e-14)
        assert found[:3, 3] == pytest.approx(transform[:3, 3] + change[:3])
        assert found[3].tolist() == [0.0, 0.0, 0.0, 1.0]
