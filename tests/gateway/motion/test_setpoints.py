"""Paths of several arms, sampled between their rows."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.motion.joint_path import PATH_STEP_RAD, path_positions, postures_at
from gateway.motion.setpoints import MotionSetpoints
from gateway.motion.trajectory import Motion

PERIOD_S = 0.01
ROWS = 40


def cubic(scale: float, rows: int = ROWS) -> Motion:
    """q = scale t^3 from the start at t = 0 on, rates exact."""
    time_s = PERIOD_S * np.arange(1, rows + 1)[:, None] * np.ones((1, 6))
    return Motion(scale * time_s**3, 3 * scale * time_s**2, 6 * scale * time_s, PERIOD_S)


def test_arms_that_move_together_need_motions_of_one_length():
    with pytest.raises(ValueError, match="equal length"):
        MotionSetpoints([np.zeros(6)] * 2, [cubic(1.0), cubic(1.0, ROWS + 1)])


@pytest.mark.parametrize("at", [-1.0, -0.4, 0.0, 0.3, 7.5, 22.25, 38.0, 39.0])
def test_between_the_rows_a_cubic_is_met_exactly_and_its_rates_linearly(at):
    """The interpolation is of third order; the time of a place is at + 1 periods."""
    path = MotionSetpoints([np.zeros(6), np.zeros(6)], [cubic(1.0), cubic(-2.0)])
    t = (at + 1) * PERIOD_S
    first, second = path.targets(at, 1.0)
    assert first == pytest.approx(np.full(6, t**3), abs=1e-12)
    assert second == pytest.approx(np.full(6, -2 * t**3), abs=1e-12)
    speed, acceleration = path.rates(at)
    assert speed.shape == acceleration.shape == (12,)
    assert acceleration == pytest.approx(np.repeat([6 * t, -12 * t], 6), abs=1e-9)
    share = at - np.floor(at)
    low, high = (np.floor(at) + 1) * PERIOD_S, (np.floor(at) + 2) * PERIOD_S
    assert speed[0] == pytest.approx(3 * ((1 - share) * low**2 + share * high**2))


@pytest.mark.parametrize(
    ("at", "rate", "ahead"), [(3.0, 1.0, 4.0), (3.0, 0.5, 3.5), (38.5, 1.0, 39.0), (39.0, 1.0, 39.0)]
)
def test_the_set_point_after_is_a_rate_further_and_never_beyond_the_end(at, rate, ahead):
    path = MotionSetpoints([np.zeros(6)], [cubic(1.0)])
    assert path.ahead(at, rate)[0] == pytest.approx(path.targets(ahead, rate)[0], abs=1e-15)


@pytest.mark.parametrize(("at", "same"), [(-3.0, -1.0), (100.0, 39.0)])
def test_a_place_beyond_either_end_is_the_end(at, same):
    path = MotionSetpoints([np.zeros(6)], [cubic(1.0)])
    assert path.targets(at, 1.0)[0] == pytest.approx(path.targets(same, 1.0)[0])
    assert path.rates(at)[0] == pytest.approx(path.rates(same)[0])


def test_prepared_motions_bring_neither_torques_nor_a_model():
    path = MotionSetpoints([np.zeros(6)], [cubic(1.0)])
    assert (path.count, path.offsets(), path.modelled(1.0)) == (ROWS, None, None)


@pytest.mark.parametrize("seed", range(5))
def test_places_on_a_path_are_close_and_hold_every_row(seed):
    rng = np.random.default_rng(seed)
    path = rng.uniform(-1, 1, (6, 6)) * rng.uniform(0, 1, (6, 1))
    path[3] = path[2]
    places = path_positions(path)
    assert set(range(6)) <= set(places.tolist())
    assert (np.diff(places) > 0).all()
    q_rad = postures_at(path, places)
    step = np.abs(np.diff(q_rad, axis=0)).max(axis=1)
    assert step.max() <= PATH_STEP_RAD + 1e-12
    # no more of them than that takes
    need = np.maximum(np.ceil(np.abs(np.diff(path, axis=0)).max(axis=1) / PATH_STEP_RAD), 1)
    assert len(places) == need.sum() + 1
    for row in range(6):
        assert q_rad[places == row][0] == pytest.approx(path[row])
    middle = postures_at(path, np.array([1.5, 4.25]))
    assert middle == pytest.approx(np.array([(path[1] + path[2]) / 2, 0.75 * path[4] + 0.25 * path[5]]))


def test_a_path_of_one_posture_is_that_posture():
    path = np.arange(6.0)[None]
    assert path_positions(path).tolist() == [0.0]
    assert postures_at(path, np.array([0.0])) == pytest.approx(path)
