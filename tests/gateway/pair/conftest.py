"""An arm and a path for the tests of the pair."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.model.robot import Robot, robot_from_dh, with_flange
from gateway.pair.calibration import PairCalibration
from gateway.pair.path import PairPath, PathProgram
from gateway.pair.transform_function import TransformFunction, function_of_knots

#: Relation of the hands of the first functions, 0.4 m along x.
FIXED = np.eye(4)
FIXED[0, 3] = 0.4
#: Origins (6, 3) [m] and directions (6, 3) of the beams of six distance sensors, in the hand that carries them.
ORIGIN_M = np.array(
    [[0.06, 0, 0], [-0.04, 0.05, 0], [-0.04, -0.05, 0], [0, 0.06, 0.02], [0, -0.06, 0.02], [0.05, 0, 0.03]]
)
BEAM = np.array([[0.0, 0, 1]] * 3 + [[1.0, 0, 0]] * 2 + [[0.0, 1, 0]])


def first_function(path: PairPath, count: int = 9) -> TransformFunction:
    """The same relation at so many points of a path."""
    points = path.uniform(count)
    return function_of_knots(path.s_m[points], np.tile(FIXED, (len(points), 1, 1)))


class Table(NamedTuple):
    """A six-axis arm with a spherical wrist."""

    convention: str = "standard"
    alpha_rad: tuple[float, ...] = tuple(np.deg2rad([90.0, 0.0, -90.0, 90.0, -90.0, 0.0]))
    a_m: tuple[float, ...] = (0.15, 0.60, 0.10, 0.0, 0.0, 0.0)
    d_m: tuple[float, ...] = (0.45, 0.0, 0.0, 0.64, 0.0, 0.10)
    theta_offset_rad: tuple[float, ...] = (0.0,) * 6


@pytest.fixture(scope="session")
def arm() -> Robot:
    return with_flange(robot_from_dh(Table()), (0.0, 0.0, 0.15))


@pytest.fixture(scope="session")
def path() -> PairPath:
    """Half a second along a curve with turning, 126 commands."""
    u = np.linspace(0.0, 1.0, 126)
    share = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    poses = np.tile(np.eye(4), (126, 1, 1))
    turn = Rotation.from_euler("zyx", np.stack([0.3 * share, 0.1 * np.sin(3.0 * share), np.pi + 0.0 * share], axis=1))
    poses[:, :3, :3] = turn.as_matrix()
    poses[:, 0, 3] = 0.75 + 0.05 * np.sin(6.0 * share)
    poses[:, 1, 3] = -0.2 + 0.4 * share
    poses[:, 2, 3] = 0.55
    return PathProgram(poses, 0.004).at_speed(1.0, 0.004)


@pytest.fixture(scope="session")
def cell() -> PairCalibration:
    """Two bases 1.9 m apart that face each other; the part's centre 0.2 m before gripper 1, along its x axis."""
    second = np.eye(4)
    second[:3, :3] = np.diag([-1.0, -1.0, 1.0])
    second[0, 3] = 1.9
    part = np.eye(4)
    part[0, 3] = 0.2
    return PairCalibration(np.eye(4), second, part, part_mass_kg=5.0)
