"""Arc length of the path, speed settings and the hash."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.errors import InputError
from gateway.pair.path import PathProgram, arc_length, master_commands


def circle(count: int = 501, radius: float = 0.3) -> np.ndarray:
    angle = np.linspace(0.0, np.pi, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("z", angle[:, None]).as_matrix()
    poses[:, 0, 3], poses[:, 1, 3] = radius * np.cos(angle), radius * np.sin(angle)
    return poses


def test_length_of_a_half_circle_counts_moving_and_turning() -> None:
    assert arc_length(circle(), 0.25)[-1] == pytest.approx(np.pi * np.hypot(0.3, 0.25), rel=1e-5)


def test_a_pure_turn_has_a_length() -> None:
    assert arc_length(circle(radius=0.0), 0.2)[-1] == pytest.approx(0.2 * np.pi)


def test_reference_speed_gives_the_stated_poses() -> None:
    path = PathProgram(circle(), 0.004).at_speed(1.0, 0.004)
    assert np.array_equal(path.commands, circle())
    assert path.s_m[0] == 0.0
    assert path.duration_s == pytest.approx(2.0)


@pytest.mark.parametrize("speed", [0.05, 0.75, 1.1, 1.5, 3.0])
def test_speed_setting_keeps_the_path_and_its_hash(speed: float) -> None:
    program = PathProgram(circle(), 0.004)
    path = program.at_speed(speed, 0.004)
    assert path.hash == program.hash
    assert path.duration_s == pytest.approx(2.0 / speed, abs=0.0081)
    assert np.allclose(np.linalg.norm(path.commands[:, :2, 3], axis=1), 0.3, atol=1e-7)
    assert np.allclose(path.commands[-1], circle()[-1], atol=1e-12)
    assert path.length_m == pytest.approx(program.at_speed(1.0, 0.004).length_m)
    assert np.all(np.diff(path.s_m) >= 0.0)


@pytest.mark.parametrize("speed", [1e-300, 1e-7])
def test_a_speed_setting_that_takes_for_ever_is_refused(speed: float) -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = np.arange(5) * 0.1
    with pytest.raises(InputError, match="too many to keep"):
        PathProgram(poses, 0.1).at_speed(speed, 0.004)


def test_another_path_has_another_hash() -> None:
    poses = circle()
    poses[100, 0, 3] += 1e-5
    assert PathProgram(poses, 0.004).hash != PathProgram(circle(), 0.004).hash


def test_uniform_learning_points() -> None:
    path = PathProgram(circle(), 0.004).at_speed(1.0, 0.004)
    points = path.uniform(9)
    assert points[0] == 0
    assert points[-1] == len(path) - 1
    assert np.allclose(np.diff(path.s_m[points]), path.length_m / 8, atol=2e-3)
    with pytest.raises(InputError, match="at least 2"):
        path.uniform(1)


def test_nearest_command_of_equal_distances_is_the_first() -> None:
    poses = np.concatenate([circle(), np.tile(circle()[-1:], (10, 1, 1))])
    path = PathProgram(poses, 0.004).at_speed(1.0, 0.004)
    assert path.nearest([path.length_m])[0] == 500


def test_master_commands_carry_the_part() -> None:
    base, grip = np.eye(4), np.eye(4)
    base[:3, 3], grip[:3, 3] = (1.0, 0.0, 0.2), (-0.2, 0.0, 0.0)
    commands = master_commands(circle(), base, grip)
    assert np.allclose(base @ commands @ np.linalg.inv(grip), circle(), atol=1e-14)


@pytest.mark.parametrize(("poses", "dt_s"), [(np.eye(4)[None], 0.004), (circle(), 0.0), (circle() * np.nan, 0.004)])
def test_useless_paths_are_refused(poses: np.ndarray, dt_s: float) -> None:
    with pytest.raises(InputError):
        PathProgram(poses, dt_s)
