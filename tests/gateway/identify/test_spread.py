"""Spread from parts of the data against what it is by definition."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.identify.spread import by_blocks, jackknife, wider


def test_wider_takes_the_larger_spread_of_each_and_keeps_the_correlation():
    first = np.array([[4.0, 1.0], [1.0, 1.0]])
    assert wider(first, np.zeros((2, 2))) == pytest.approx(first)
    both = wider(first, np.diag([1.0, 9.0]))
    assert np.diag(both) == pytest.approx([4.0, 9.0])
    assert both[0, 1] / np.sqrt(both[0, 0] * both[1, 1]) == pytest.approx(0.5)


def test_blocks_detect_autocorrelated_noise():
    """The mean of a first order process: its variance is that of white noise times (1 + k) / (1 - k)."""
    generator, keep, count = np.random.default_rng(1), 0.9, 200_000
    series = np.zeros(count)
    for place, white in enumerate(generator.normal(size=count - 1), start=1):
        series[place] = keep * series[place - 1] + white
    found = by_blocks(series[:, None] / count, np.arange(count), np.full(count, "1"), 500.0)
    truth = series.var() / count * (1 + keep) / (1 - keep)
    assert found[0, 0] == pytest.approx(truth, rel=0.2)
    assert by_blocks(series[:, None] / count, np.arange(count), np.full(count, "1"), 1.0)[0, 0] < 0.2 * truth


def test_a_short_run_has_blocks_too_and_no_block_holds_two_runs():
    run = np.repeat(["a", "b"], [40, 10])
    pull = np.ones((50, 1))
    sums = by_blocks(pull, np.arange(50), run, 20.0)
    assert sums[0, 0] == pytest.approx((8 * 5.0**2 + 6 * 1.0**2 + 2 * 2.0**2) * 16 / 15, rel=0.01)


def test_a_jackknife_over_means_is_their_variance():
    parts = np.random.default_rng(2).normal(size=(8, 2))
    without = (parts.sum(axis=0) - parts) / 7.0
    assert np.diag(jackknife(without)) == pytest.approx(parts.var(axis=0, ddof=1) / 8.0)
    assert not jackknife(without[:2]).any()
