"""Series that begin and end at rest: against differences of their own positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.excite.excitation import Series, fingerprint


@pytest.fixture
def series() -> Series:
    """Three joints, four harmonics, at rest at the ends."""
    draw = np.random.default_rng(3)
    order = np.arange(1, 5)
    cosine, sine = draw.normal(size=(2, 3, 4)) * 0.1
    cosine[:, -1] = -(cosine[:, :-1] @ order[:-1] ** 2) / order[-1] ** 2
    sine[:, -1] = -(sine[:, :-1] @ order[:-1]) / order[-1]
    return Series("load", np.array([0.1, -0.4, 0.9]), cosine, sine, 6.0, 5)


def test_derivatives_are_those_of_the_positions(series: Series) -> None:
    step_s = 1e-5
    at = np.linspace(0.3, 5.7, 11)
    after, before = series.at(at + step_s), series.at(at - step_s)
    for order in range(3):
        slope = (after[order] - before[order]) / (2 * step_s)
        assert series.at(at)[order + 1] == pytest.approx(slope, abs=1e-6)


def test_a_period_runs_from_rest_to_rest_and_ends_where_it_began(series: Series) -> None:
    motion = series.motion(0.01)
    assert len(motion) == 600
    assert motion.q_rad[-1] == pytest.approx(series.start_rad)
    assert np.abs(series.at(np.array([0.0, 6.0]))[1:3]).max() < 1e-12
    speeds = np.diff(np.vstack([series.start_rad, motion.q_rad]), axis=0) / 0.01
    assert np.abs(speeds[0]).max() < 0.01


def test_a_period_that_is_no_whole_number_of_syncs_is_stretched(series: Series) -> None:
    motion = replace(series, period_s=5.995).motion(0.01)
    assert len(motion) == 600
    speeds = (motion.q_rad[2:] - motion.q_rad[:-2]) / 0.02
    assert motion.qd_rad_s[1:-1] == pytest.approx(speeds, abs=1e-3)


def test_the_same_motion_has_the_same_fingerprint(series: Series) -> None:
    assert fingerprint(series) == fingerprint(replace(series, name="other", periods=9))
    assert fingerprint(series) != fingerprint(replace(series, period_s=7.0))
