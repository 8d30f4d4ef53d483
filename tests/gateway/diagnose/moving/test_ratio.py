"""The interval of a held-out ratio."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.diagnose.held_out_residuals import Held, held_ratio
from tests.data.moving_arm import coloured


def held(residual):
    return Held(residual, np.ones(residual.shape, dtype=bool))


def test_the_interval_holds_the_ratio_of_the_processes_although_rows_are_autocorrelated():
    """Two residuals of RMS 1 and 0.8 that are autocorrelated over 0.1 s at 25 Hz, and in part with each other."""
    inside = 0
    for seed in range(200):
        generator = np.random.default_rng(seed)
        common, first, second = (coloured(generator, (400, 1), 25.0) for _ in range(3))
        before, after = 0.8 * common + 0.6 * first, 0.8 * (0.8 * common + 0.6 * second)
        ratio = held_ratio(held(before), held(after), [0], np.ones(1))
        inside += ratio.low < 0.8 < ratio.high
    assert 0.90 * 200 <= inside <= 199


def test_one_bad_stretch_widens_the_interval_upwards():
    generator = np.random.default_rng(1)
    before, after = 10.0 * generator.normal(size=(600, 1)), generator.normal(size=(600, 1))
    calm = held_ratio(held(before), held(after), [0], np.ones(1))
    after[200:260] *= 10.0
    bad = held_ratio(held(before), held(after), [0], np.ones(1))
    assert calm.below_one
    assert bad.below_one
    assert bad.high / bad.value > 1.2 * calm.high / calm.value


def test_no_change_is_no_gain_and_axes_count_by_their_noise():
    before = held(np.random.default_rng(2).normal(size=(300, 2)))
    assert held_ratio(before, before, [0, 1], np.ones(2)).value == 1.0
    assert not held_ratio(before, before, [0, 1], np.ones(2)).below_one
    after = held(before.residual_nm * np.array([0.5, 1.0]))
    quiet = held_ratio(before, after, [0, 1], np.array([1e-3, 1.0]))
    assert quiet.value == pytest.approx(0.5, abs=0.01)
    assert np.isnan(held_ratio(Held(before.residual_nm, np.zeros((300, 2), dtype=bool)), before, [0], np.ones(2)).value)
