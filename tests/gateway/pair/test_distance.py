"""Distance sensors against rays that are cut with planes one by one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.errors import ConfigError
from gateway.pair.distance import DistanceEstimator, DistanceSensors
from gateway.pair.transform import apply_correction
from tests.gateway.pair.conftest import BEAM, ORIGIN_M

WANTED = np.eye(4)
WANTED[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()
WANTED[:3, 3] = 0.1, 0.4, -0.05


def sensors(count: int = 6) -> DistanceSensors:
    normal = np.array([[0.1, 0.0, -1.0]] * 3 + [[-1.0, 0.2, 0.0]] * 2 + [[0.0, -1.0, 0.1]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    hit = (ORIGIN_M + 0.005 * BEAM) @ WANTED[:3, :3].T + WANTED[:3, 3]
    return DistanceSensors(ORIGIN_M[:count], BEAM[:count], hit[:count], (normal @ WANTED[:3, :3].T)[:count])


def test_readings_are_rays_cut_with_planes() -> None:
    sensor = sensors()
    moved = apply_correction(WANTED, [1e-3, -2e-3, 5e-4, 3e-3, 1e-3, -2e-3])
    for i, reading in enumerate(sensor.readings(moved)):
        start = moved[:3, :3] @ sensor.origin_m[i] + moved[:3, 3]
        end = start + reading * (moved[:3, :3] @ sensor.beam[i])
        assert sensor.normal[i] @ (end - sensor.point_m[i]) == pytest.approx(0.0, abs=1e-15)
    assert np.allclose(sensor.readings(WANTED), 0.005)


def test_three_sensors_correct_three_components_and_leave_the_rest() -> None:
    sensor = sensors(3)
    turn = WANTED[:3, :3]
    aligned = DistanceSensors(sensor.origin_m, sensor.beam, sensor.point_m @ turn, sensor.normal @ turn)
    at = WANTED.copy()
    at[:3, :3], at[:3, 3] = np.eye(3), turn.T @ WANTED[:3, 3]
    estimator = DistanceEstimator(aligned, at, ("z", "rx", "ry"))
    error = estimator.error(aligned.readings(apply_correction(at, [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0])))
    assert error[2] == pytest.approx(-1e-3, rel=1e-6)
    assert np.array_equal(error[[0, 1, 5]], np.zeros(3))
    with pytest.raises(ConfigError, match="do not determine"):
        DistanceEstimator(aligned, at, ("x", "y", "z"))
    with pytest.raises(ConfigError, match="do not determine"):
        DistanceEstimator(aligned, at)
    with pytest.raises(ConfigError, match="among"):
        DistanceEstimator(aligned, at, ("z", "yaw"))


def test_error_in_the_base_turns_with_the_slave() -> None:
    estimator = DistanceEstimator(sensors(), WANTED)
    slave = np.eye(4)
    slave[:3, :3] = Rotation.from_euler("z", 0.7).as_matrix()
    readings = sensors().readings(apply_correction(WANTED, [1e-3, 0, 0, 0, 0, 0]))
    error, turned = estimator.error(readings), estimator.error_in_base(readings, slave)
    in_hand = WANTED[:3, :3].T @ error[:3]
    assert np.allclose(slave[:3, :3].T @ turned[:3], in_hand)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ConfigError, match="shape"):
        DistanceSensors(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ConfigError, match="unit"):
        DistanceSensors(np.zeros((1, 3)), np.ones((1, 3)), np.zeros((1, 3)), np.eye(3)[:1])


def mixed() -> DistanceSensors:
    """The six of `sensors`, the first three carried by gripper 1 and looking at planes of gripper 2."""
    sensor, back = sensors(), np.linalg.inv(WANTED)
    on_master = np.arange(6) < 3
    origin, beam = sensor.origin_m.copy(), sensor.beam.copy()
    point, normal = sensor.point_m.copy(), sensor.normal.copy()
    for i in range(3):
        origin[i], beam[i] = WANTED[:3, :3] @ origin[i] + WANTED[:3, 3], WANTED[:3, :3] @ beam[i]
        point[i], normal[i] = back[:3, :3] @ point[i] + back[:3, 3], back[:3, :3] @ normal[i]
    return DistanceSensors(origin, beam, point, normal, on_master)


@pytest.mark.parametrize("made", [sensors, mixed])
def test_sensitivity_by_differences(made: Callable[[], DistanceSensors]) -> None:
    sensor = made()
    for column in range(6):
        step = np.zeros(6)
        step[column] = 1e-6
        there, back = apply_correction(WANTED, step), apply_correction(WANTED, -step)
        change = (sensor.readings(there) - sensor.readings(back)) / 2e-6
        assert np.allclose(sensor.sensitivity(WANTED)[:, column], change, atol=1e-8)


@pytest.mark.parametrize("made", [sensors, mixed])
def test_error_brings_the_hand_home(made: Callable[[], DistanceSensors]) -> None:
    estimator = DistanceEstimator(made(), WANTED)
    away = np.array([1e-3, -2e-3, 5e-4, 3e-3, 1e-3, -2e-3])
    error = estimator.error(made().readings(apply_correction(WANTED, away)))
    assert np.allclose(error, -away, atol=2e-5)
    assert np.allclose(estimator.demanded_m, 0.005)


def test_sensors_on_either_gripper() -> None:
    sensor = mixed()
    assert np.allclose(sensor.readings(WANTED), 0.005)
    moved = apply_correction(WANTED, [1e-3, -2e-3, 5e-4, 3e-3, 1e-3, -2e-3])
    for i, reading in enumerate(sensor.readings(moved)[:3]):
        normal = moved[:3, :3] @ sensor.normal[i]
        point = moved[:3, :3] @ sensor.point_m[i] + moved[:3, 3]
        assert normal @ (sensor.origin_m[i] + reading * sensor.beam[i] - point) == pytest.approx(0.0, abs=1e-15)
