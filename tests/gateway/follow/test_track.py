"""Figures of a pass against signals whose figures are known."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.follow.track import Recorder, Track, following

PERIOD_S = 0.01


def track(target, measured):
    nothing = np.zeros((len(target), 6))
    return Track("off", PERIOD_S, target, measured, nothing, nothing, nothing, np.zeros(len(target)))


def six(values):
    return np.repeat(np.asarray(values, dtype=float)[:, None], 6, axis=1)


def test_an_axis_with_20_ms_lag_is_reported():
    time_s = PERIOD_S * np.arange(1000)
    found = following(track(six(np.sin(time_s)), six(np.sin(time_s - 0.02))))
    np.testing.assert_allclose(found.lag_s, 0.02, rtol=1e-3)
    np.testing.assert_allclose(found.peak_rad, 0.02, rtol=1e-2)
    np.testing.assert_allclose(found.rms_rad, 0.02 / np.sqrt(2), rtol=0.03)


def test_overshoot_is_the_motion_beyond_a_resting_place_in_the_direction_of_the_motion():
    target = np.concatenate([np.linspace(0, 1, 50), np.ones(20), np.linspace(1, 0, 50), np.zeros(20)])
    measured = target.copy()
    measured[55] += 0.03  # beyond
    measured[60] -= 0.05  # short
    measured[30] += 0.2  # in motion
    measured[125] -= 0.04  # beyond, the other direction
    np.testing.assert_allclose(following(track(six(target), six(measured))).overshoot_rad, 0.04)


def test_an_axis_that_stays_behind_does_not_overshoot():
    target = np.concatenate([np.linspace(0, 1, 50), np.ones(20)])
    assert following(track(six(target), six(target - 0.01))).overshoot_rad == (0.0,) * 6


def test_an_axis_that_is_not_moved_has_no_lag_and_a_lost_answer_counts_for_nothing():
    target, measured = six(np.linspace(0, 1, 100)), six(np.linspace(0, 1, 100))
    target[:, 2] = measured[:, 2] = 0.5
    measured[40] = np.nan
    found = following(track(target, measured))
    assert np.isnan(found.lag_s[2])
    assert max(found.peak_rad) == 0.0
    with pytest.raises(ValueError, match="answered"):
        following(track(target, np.full_like(measured, np.nan)))


def test_rows_after_a_lost_answer_and_repeated_readings_are_left_out():
    ramp = 0.002 * np.arange(30)[:, None] * np.ones(6)
    measured = ramp.copy()
    measured[10, 3] = np.nan
    measured[20] = measured[19]
    recorder = Recorder("off", PERIOD_S)
    for target, q_rad in zip(ramp, measured, strict=True):
        recorder.fed([0.0] * 6, [0.0] * 6, 0.0)
        recorder.add(target, SimpleNamespace(q_rad=q_rad, readings=(SimpleNamespace(torque_nm=0.0),) * 6))
    track = recorder.track()
    assert np.flatnonzero(np.isnan(track.measured_rad).any(axis=1)).tolist() == [10, 11, 12, 20]
    assert max(following(track).peak_rad) == 0.0
    still = np.zeros((30, 6))
    assert following(dataclasses.replace(track, target_rad=still, measured_rad=still)).peak_rad == (0.0,) * 6


def test_rates_are_those_of_the_target():
    time_s = PERIOD_S * np.arange(400)
    pass_ = track(six(np.sin(time_s)), six(np.sin(time_s)))
    np.testing.assert_allclose(pass_.velocity_rad_s[1:-1, 0], np.cos(time_s)[1:-1], atol=1e-4)
    np.testing.assert_allclose(pass_.acceleration_rad_s2[1:-1, 0], -np.sin(time_s)[1:-1], atol=1e-4)
