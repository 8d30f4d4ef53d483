"""Motions keep their limits and are straight lines."""

import numpy as np
import pytest
from hypothesis import given
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


def test_no_distance_is_no_motion():
    assert len(straight(np.ones(6), np.ones(6), LIMITS, PERIOD_S)) == 0


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_missing_limit_is_refused(value):
    limits = MotionLimits(np.full(6, 0.5), np.full(6, value), np.full(6, 3.0))
    with pytest.raises(PlanRefused, match="no motion fits"):
        straight(np.zeros(6), np.ones(6), limits, PERIOD_S)


@pytest.mark.parametrize("end", [np.nan, np.inf])
def test_an_end_that_is_no_number_is_refused(end):
    with pytest.raises(PlanRefused, match="finite joint angles"):
        straight(np.zeros(6), np.array([0.0, 0, 0, end, 0, 0]), LIMITS, PERIOD_S)


def test_a_joint_at_rest_does_not_limit_the_motion():
    limits = MotionLimits(np.array([0.5, 1e-3, 0.5, 0.5, 0.5, 0.5]), np.full(6, 0.8), np.full(6, 4.0))
    fast = straight(np.zeros(6), np.array([2.0, 0, 0, 0, 0, 0]), limits, PERIOD_S)
    assert fast.duration_s == pytest.approx(2.0 / 0.5 + 0.5 / 0.8 + 0.8 / 4.0, abs=PERIOD_S)
    slow = straight(np.zeros(6), np.array([2.0, 0.02, 0, 0, 0, 0]), limits, PERIOD_S)
    # 0.02 rad at 0.001 rad/s: the first joint goes at 0.1 rad/s, which it takes 2 sqrt(v / j) to reach
    assert slow.duration_s == pytest.approx(20.0 + 2 * np.sqrt(0.1 / 4.0), abs=PERIOD_S)


def test_rows_are_the_motion_at_the_syncs_and_the_last_one_is_at_rest():
    motion = straight(np.zeros(6), np.full(6, 0.3), LIMITS, PERIOD_S)
    path = np.vstack([np.zeros(6), motion.q_rad])
    mean = (path[1:] - path[:-1]) / PERIOD_S
    between = (np.vstack([np.zeros(6), motion.qd_rad_s])[1:] + np.vstack([np.zeros(6), motion.qd_rad_s])[:-1]) / 2
    assert mean[:-1] == pytest.approx(between[:-1], abs=2e-4)
    assert (motion.qd_rad_s[-1] == 0).all()
    assert (motion.qdd_rad_s2[-1] == 0).all()
    slope = np.gradient(motion.qd_rad_s, PERIOD_S, axis=0)
    assert slope[2:-2] == pytest.approx(motion.qdd_rad_s2[2:-2], abs=0.03)


@pytest.mark.parametrize("length", [0.06, 0.06000000000000005, 0.05999999999999994])
def test_a_motion_that_just_reaches_its_largest_acceleration(length):
    """Four ramps of a/j = 0.1 s: 2 a^3 / j^2 = 0.06 rad."""
    limits = MotionLimits(np.full(6, 1.14), np.full(6, 3.0), np.full(6, 30.0))
    motion = straight(np.zeros(6), np.full(6, length), limits, PERIOD_S)
    assert motion.q_rad[-1] == pytest.approx(np.full(6, length))
    assert len(motion) * PERIOD_S == pytest.approx(0.4, abs=2 * PERIOD_S)
