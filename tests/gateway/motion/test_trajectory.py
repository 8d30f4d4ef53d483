"""Motions keep their limits and lie on a straight line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.errors import PlanRefused
from gateway.motion.trajectory import MotionLimits, straight

PERIOD_S = 0.01
LIMITS = MotionLimits(np.full(6, 0.5), np.linspace(0.6, 1.2, 6), np.linspace(3.0, 6.0, 6))

angles = st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array)


def rates(q_rad: np.ndarray) -> list[np.ndarray]:
    speed = np.diff(q_rad, axis=0) / PERIOD_S
    acceleration = np.diff(speed, axis=0) / PERIOD_S
    return [speed, acceleration, np.diff(acceleration, axis=0) / PERIOD_S]


@settings(max_examples=60, deadline=None)
@given(start=angles, target=angles)
def test_straight_motion_keeps_limits_and_line(start, target):
    motion = straight(start, target, LIMITS, PERIOD_S)
    if not len(motion):
        assert start == pytest.approx(target, abs=1e-9)
        return
    assert np.array_equal(motion.q_rad[-1], target)
    path = np.vstack([start, start, start, motion.q_rad])
    for values, limit in zip(
        rates(path), (LIMITS.speed_rad_s, LIMITS.acceleration_rad_s2, LIMITS.jerk_rad_s3), strict=True
    ):
        assert (np.abs(values).max(axis=0) <= limit * 1.02 + 1e-6).all()
    share = (motion.q_rad - start) @ (target - start) / max((target - start) @ (target - start), 1e-300)
    assert motion.q_rad - start == pytest.approx(share[:, None] * (target - start), abs=1e-9)


def test_duration_of_a_long_motion():
    """One axis at cruise: s/v + v/a + a/j."""
    limits = MotionLimits(np.full(6, 0.5), np.full(6, 0.8), np.full(6, 4.0))
    target = np.array([2.0, 0.5, 0.0, 0.0, -0.3, 0.1])
    motion = straight(np.zeros(6), target, limits, PERIOD_S)
    assert motion.duration_s == pytest.approx(2.0 / 0.5 + 0.5 / 0.8 + 0.8 / 4.0, abs=PERIOD_S)


def test_no_way_is_no_motion():
    assert len(straight(np.ones(6), np.ones(6), LIMITS, PERIOD_S)) == 0


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_missing_limit_is_refused(value):
    limits = MotionLimits(np.full(6, 0.5), np.full(6, value), np.full(6, 3.0))
    with pytest.raises(PlanRefused, match="no motion fits"):
        straight(np.zeros(6), np.ones(6), limits, PERIOD_S)
