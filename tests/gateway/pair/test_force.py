"""Force from joint torque and its split, against statics written here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.force import (
    dead_band,
    share_of_part,
    split,
)
from gateway.pair.path import PairPath
from gateway.pair.transform import slave_command
from gateway.pair.transform_function import constant_function

Q = np.array([0.1, 1.4, -3.0, 0.2, -1.3, 0.3])


def test_bands() -> None:
    assert np.array_equal(dead_band([0.5, -3.0, 3.0], [1.0, 1.0, 1.0]), [0.0, -2.0, 2.0])


def test_split_of_squeeze_and_weight() -> None:
    external, internal = split([5.0, 0, 0, 0, 0, 0], [-5.0, 0, 0, 0, 0, 0])
    assert np.allclose(external, 0.0)
    assert internal[0] == -5.0
    external, internal = split([0, 0, -24.5, 0, 0, 0], [0, 0, -24.5, 0, 0, 0])
    assert external[2] == pytest.approx(-49.0)
    assert np.allclose(internal, 0.0)
    assert share_of_part(5.0, np.zeros(3))[2] == pytest.approx(-5.0 * 9.80665 / 2.0)
    assert share_of_part(5.0, [0.0, 0.0, 9.80665])[2] == pytest.approx(-5.0 * 9.80665)


def wrenches(path: PairPath, cell: PairCalibration) -> tuple[PathWrenches, np.ndarray]:
    between = np.eye(4)
    between[0, 3] = 0.4
    slave = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, constant_function(between).many(path.s_m))
    return PathWrenches(cell, path, slave), slave


def in_base(base: np.ndarray, force: np.ndarray, moment: np.ndarray) -> np.ndarray:
    return np.concatenate([base[:3, :3].T @ force, base[:3, :3].T @ moment])


def test_part_at_rest_is_no_internal_force(path: PairPath, cell: PairCalibration) -> None:
    maps, _ = wrenches(replace(path, dt_s=10.0), cell)
    weight = np.array([0.0, 0.0, -5.0 * 9.80665 / 2.0])
    deviation = [in_base(base, weight, np.zeros(3)) for base in (cell.w_t_b1, cell.w_t_b2)]
    for first, second in ((deviation[0], deviation[1]), (deviation[0], None), (None, deviation[1])):
        internal = maps.internal(0, first, second)
        assert internal is not None
        assert np.allclose(internal, 0.0, atol=1e-4)
    assert maps.internal(0, None, None) is None


def test_squeeze_along_the_part_pushes_the_slave_outwards(path: PairPath, cell: PairCalibration) -> None:
    """Grippers 0.4 m apart that press with 30 N: the part pushes both outwards, seen from either arm alone or both."""
    maps, slave = wrenches(path, replace(cell, part_mass_kg=0.0))
    m = 60
    ends = [(base @ pose)[:3, 3] for base, pose in ((cell.w_t_b1, path.commands[m]), (cell.w_t_b2, slave[m]))]
    outwards = 30.0 * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    first = in_base(cell.w_t_b1, -outwards, np.zeros(3))
    second = in_base(cell.w_t_b2, outwards, np.zeros(3))
    for forces in ((first, second), (first, None), (None, second)):
        internal = maps.internal(m, *forces)
        assert internal is not None
        assert np.allclose(internal[:3], outwards, atol=1e-12)
        assert np.allclose(internal[3:], 0.0, atol=1e-12)
        assert np.allclose(maps.at_tip(1, m, internal), second, atol=1e-12)
        assert np.allclose(maps.at_tip(0, m, -internal), first, atol=1e-12)


def test_moment_is_taken_about_the_centre(path: PairPath, cell: PairCalibration) -> None:
    maps, slave = wrenches(path, replace(cell, part_mass_kg=0.0))
    rng = np.random.default_rng(5)
    force, moment = rng.normal(size=3), rng.normal(size=3)
    centre = (cell.w_t_b1 @ path.commands[30] @ cell.e1_t_part)[:3, 3]
    lever = (cell.w_t_b2 @ slave[30])[:3, 3] - centre
    internal = maps.internal(30, None, in_base(cell.w_t_b2, force, moment))
    assert internal is not None
    assert np.allclose(internal, np.concatenate([force, moment + np.cross(lever, force)]))
