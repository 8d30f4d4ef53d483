"""Time along a path: slowed down inside the acceleration limits, on the path, from anywhere on it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from gateway.motion.setpoints import MotionSetpoints, PathClock
from gateway.motion.trajectory import Motion, MotionLimits, straight

PERIOD_S = 0.01
LIMITS = MotionLimits(np.full(6, 0.5), np.linspace(0.6, 1.2, 6), np.linspace(3.0, 6.0, 6))

angles = st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array)


def driven(motion: Motion, start: np.ndarray, stop_at: int | None, most: float = 1.0) -> np.ndarray:
    """Setpoints as they go out, from the start on; `stop_at` = SYNC at which a stop is asked for."""
    driven_path = MotionSetpoints([start], [motion])
    clock = PathClock(driven_path.count, PERIOD_S, LIMITS.acceleration_rad_s2, LIMITS.jerk_rad_s3, most)
    sent = [start]
    while not clock.done:
        if stop_at is not None and len(sent) > stop_at:
            clock.stop()
        at = clock.advance(*driven_path.rates(clock.at))
        if clock.done and not clock.arrived:
            break
        sent.append(driven_path.targets(at, clock.rate)[0])
        assert len(sent) < 100_000
    return np.array(sent)


def accelerations(q_rad: np.ndarray) -> np.ndarray:
    still = np.vstack([q_rad[:1], q_rad, q_rad[-1:], q_rad[-1:]])
    return np.diff(still, n=2, axis=0) / PERIOD_S**2


@given(start=angles, target=angles, at=st.floats(0, 1))
def test_a_stop_anywhere_on_a_straight_motion_keeps_line_and_limits(start, target, at):
    motion = straight(start, target, LIMITS, PERIOD_S)
    if not len(motion):
        return
    path = driven(motion, start, int(at * len(motion)))
    assert (np.abs(accelerations(path)) <= LIMITS.acceleration_rad_s2 * 1.05 + 1e-6).all()
    line = target - start
    share = (path - start) @ line / (line @ line)
    assert path - start == pytest.approx(share[:, None] * line, abs=1e-6)
    assert (np.diff(share) > -1e-12).all()
    assert len(path) <= int(at * len(motion)) + 1 + 1.2 / PERIOD_S


def curved(duration_s: float) -> Motion:
    """A path on which every joint reverses, from rest to rest."""
    knots = np.linspace(0.0, duration_s, 7)
    points = np.array(
        [[0.0] * 6, [0.1, 0.2, -0.1, 0.1, 0.0, 0.2], [0.3, 0.1, 0.1, -0.1, 0.2, 0.1], [0.2, -0.1, 0.2, 0.0, 0.3, 0.0]]
    )
    points = np.vstack([points, points[-2::-1]])
    rest = [(1, np.zeros(6)), (2, np.zeros(6))]
    spline = make_interp_spline(knots, points, k=5, bc_type=(rest, rest))
    time_s = PERIOD_S * np.arange(1, round(duration_s / PERIOD_S) + 1)
    return Motion(spline(time_s), spline(time_s, 1), spline(time_s, 2), PERIOD_S)


@pytest.mark.parametrize("stop_at", [1, 30, 90, 150, 240, 333, 420, 560])
def test_a_stop_on_a_curve_stays_on_the_curve(stop_at):
    motion = curved(8.0)
    assert (np.abs(motion.qdd_rad_s2).max(axis=0) <= LIMITS.acceleration_rad_s2).all()
    path = driven(motion, np.zeros(6), stop_at)
    assert len(path) < len(motion)
    assert (np.abs(accelerations(path)) <= LIMITS.acceleration_rad_s2 * 1.1).all()
    fine = MotionSetpoints([np.zeros(6)], [motion])
    places = np.array([fine.targets(at, 1.0)[0] for at in np.linspace(-1.0, fine.count - 1, 20 * fine.count)])
    off = np.array([np.abs(places - point).max(axis=1).min() for point in path])
    assert off.max() < 2e-4


def test_a_path_that_leaves_no_torque_to_brake_comes_to_rest_all_the_same():
    time_s = PERIOD_S * np.arange(1, 2001)[:, None]
    turning = 2.0 * np.pi * np.arange(6) / 6.0 + 5.0 * time_s
    motion = Motion(np.sin(turning), 5.0 * np.cos(turning), -25.0 * np.sin(turning), PERIOD_S)
    path = driven(motion, motion.q_rad[0], 500)
    assert len(path) < 501 + 4.0 / PERIOD_S


@pytest.mark.parametrize("share", [0.1, 0.35, 1.0])
def test_an_override_drives_the_same_path_slower(share):
    start, target = np.zeros(6), np.array([0.5, -0.3, 0.2, 0.1, 0.4, -0.5])
    motion = straight(start, target, LIMITS, PERIOD_S)
    path = driven(motion, start, None, share)
    assert path[-1] == pytest.approx(target, abs=1e-12)
    assert len(path) == pytest.approx(len(motion) / share, abs=3)
    speed = np.abs(np.diff(path, axis=0)).max(axis=0) / PERIOD_S
    assert (speed <= share * np.abs(motion.qd_rad_s).max(axis=0) * 1.001).all()


def test_at_full_rate_the_rows_are_sent_as_they_stand():
    start, target = np.zeros(6), np.array([0.5, -0.3, 0.2, 0.1, 0.4, -0.5])
    motion = straight(start, target, LIMITS, PERIOD_S)
    assert np.array_equal(driven(motion, start, None)[1:], motion.q_rad)
