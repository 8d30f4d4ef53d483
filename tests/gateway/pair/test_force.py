"""Force from joint torque and its split, against statics written here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.model.robot import Robot
from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.force import (
    dead_band,
    share_of_part,
    split,
    wrench_from_torque,
)
from gateway.pair.function import constant_function
from gateway.pair.inverse import chain_of
from gateway.pair.path import PairPath
from gateway.pair.relation import slave_command

Q = np.array([0.1, 1.4, -3.0, 0.2, -1.3, 0.3])


def test_a_push_of_10_n_comes_back_with_its_sign(arm: Robot) -> None:
    """Virtual work: a push F on the tip needs the motor torque -J^T F on top of the model's to stand still."""
    chain = chain_of(arm)
    push = np.array([10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    step = 1e-6
    power = np.empty(6)
    for i in range(6):
        ahead, back = Q.copy(), Q.copy()
        ahead[i] += step
        back[i] -= step
        moved = chain.poses(ahead[None])[0][0, :3, 3] - chain.poses(back[None])[0][0, :3, 3]
        power[i] = push[:3] @ moved / (2.0 * step)
    model, friction = np.linspace(-30.0, 40.0, 6), np.full(6, 2.0)
    measured = model + friction - power
    external = measured - model - friction
    estimate = wrench_from_torque(chain.poses(Q[None])[1], external[None])
    assert estimate.observable[0]
    assert np.allclose(estimate.wrench[0], push, atol=1e-6)


def test_next_to_a_singular_posture_the_sample_is_flagged_and_bounded(arm: Robot) -> None:
    q = np.array([0.0, 1.4, -3.0, 0.2, -0.001, 0.1])
    jacobian = chain_of(arm).poses(q[None])[1]
    estimate = wrench_from_torque(jacobian, np.ones((1, 6)))
    assert not estimate.observable[0]
    assert np.abs(estimate.wrench).max() < 1.0 / 0.02
    damped = -np.linalg.inv(jacobian[0] @ jacobian[0].T + 0.02**2 * np.eye(6)) @ jacobian[0] @ np.ones(6)
    assert np.allclose(estimate.wrench[0], damped)


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
    felt = [in_base(base, weight, np.zeros(3)) for base in (cell.w_t_b1, cell.w_t_b2)]
    for first, second in ((felt[0], felt[1]), (felt[0], None), (None, felt[1])):
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
    for given in ((first, second), (first, None), (None, second)):
        internal = maps.internal(m, *given)
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
