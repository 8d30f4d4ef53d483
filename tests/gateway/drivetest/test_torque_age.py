"""Age of the torque word from a motion with a known delay, friction and gravity."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.drivetest.torque_age import modulated, torque_age
from gateway.errors import PlanRefused
from gateway.model.arm_model import arm_robot
from gateway.motion.workspace import workspace_of

STEP_S = 1e-4


def dense():
    """Time, position, speed and acceleration every 0.1 ms: forth and back at two frequencies, from rest to rest."""
    at = STEP_S * np.arange(30000)
    ends = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(at, at[-1] - at) / 0.4, 0.0, 1.0))
    forth = ends * (0.0225 + 0.0075 * np.sin(4.8 * at) + 0.0125 * np.sin(24.0 * at))
    speed = np.concatenate([forth, -forth])
    return np.arange(len(speed)) * STEP_S, np.cumsum(speed) * STEP_S, speed, np.gradient(speed, STEP_S)


@pytest.mark.parametrize("age_s", [0.0, 0.003, 0.015, 0.04])
def test_a_known_age_is_within_the_interval(age_s):
    """Torque of an inertia of 12 kg m2, friction and gravity, sampled with noise; the truth is a number."""
    period_s, hits = 0.01, 0
    at, position, speed, acceleration = dense()
    torque = 12.0 * acceleration + 20.0 * speed + 6.0 * np.sign(speed) + 80.0 * position
    rows = np.arange(0, len(at), round(period_s / STEP_S))
    then = np.maximum(rows - round(age_s / STEP_S), 0)
    for seed in range(3):
        noise = 0.1 * np.random.default_rng(seed).standard_normal(len(rows))
        samples = np.column_stack([at[rows], np.round(2e6 * position[rows]), torque[then] + noise])
        figure = torque_age(samples, period_s)
        assert figure.interval is not None
        hits += figure.interval[0] <= age_s <= figure.interval[1]
        assert figure.value == pytest.approx(age_s, abs=0.0015)
    assert hits == 3


def test_a_torque_that_leads_the_motion_has_no_age():
    at, position, speed, acceleration = dense()
    torque = np.roll(12.0 * acceleration + 20.0 * speed, -200)  # 20 ms early
    rows = np.arange(0, len(at), 100)
    figure = torque_age(np.column_stack([at[rows], np.round(2e6 * position[rows]), torque[rows]]), 0.01)
    assert figure.interval is None
    assert "leads" in figure.method


@pytest.fixture
def here(small_cell):
    """Workspace of the small arm."""
    config = small_cell.cell.arm[0]
    return workspace_of(config, arm_robot(small_cell, config))


def test_the_motion_keeps_the_limits_and_returns(here):
    start = np.zeros(here.robot.axes)
    forth, back = modulated(here, start, 1, 0.01)
    for motion in (forth, back):
        assert np.abs(motion.qd_rad_s[:, 1]).max() <= 0.045
        assert np.abs(motion.qdd_rad_s2[:, 1]).max() <= here.acceleration_rad_s2[1]
        assert np.abs(np.delete(motion.qd_rad_s, 1, axis=1)).max() == 0.0
    assert back.q_rad[-1] == pytest.approx(start, abs=1e-9)
    assert np.diff(forth.q_rad[:, 1]) / 0.01 == pytest.approx(forth.qd_rad_s[1:, 1], abs=0.005)


def test_a_torque_without_inertia_gives_no_figure():
    at = 0.01 * np.arange(600)
    count = 2e6 * (0.02 * at - 0.0005 * np.cos(24 * at))
    torque = np.random.default_rng(2).standard_normal(600)
    assert torque_age(np.column_stack([at, count, torque]), 0.01).value is None


def test_too_few_answers_or_gaps_everywhere_give_no_figure():
    assert torque_age(np.zeros((0, 3)), 0.01).value is None
    at = 0.01 * np.delete(np.arange(600), np.s_[::10])
    count = 2e6 * (0.02 * at - 0.0005 * np.cos(24 * at))
    assert "gaps" in torque_age(np.column_stack([at, count, np.cos(24 * at)]), 0.01).method
    assert torque_age(np.column_stack([at, np.full(540, 7.0), np.zeros(540)]), 0.01).value is None


def test_an_axis_without_space_is_not_moved(monkeypatch, here):
    monkeypatch.setattr(type(here), "path_clear", lambda *_: np.array([False]))
    with pytest.raises(PlanRefused, match="joint 1 has no free space"):
        modulated(here, np.zeros(here.robot.axes), 0, 0.01)
