"""Autocorrelation of residuals against the closed form of a first-order process."""

import numpy as np
import pytest

from gateway.identify.spread import correlation_time, counting_share

KEEP = 0.8


def first_order(count: int, seed: int) -> np.ndarray:
    """Series (n,) in which each row keeps `KEEP` of the row before."""
    series = np.zeros(count)
    for row, white in enumerate(np.random.default_rng(seed).normal(size=count - 1), start=1):
        series[row] = KEEP * series[row - 1] + white
    return series


def test_a_first_order_process_has_the_share_of_its_closed_form():
    assert counting_share(first_order(200_000, 1)) == pytest.approx((1 - KEEP) / (1 + KEEP), rel=0.15)
    assert counting_share(np.random.default_rng(1).normal(size=20_000)) == pytest.approx(1.0, abs=0.05)


def test_rows_of_two_runs_are_not_correlated():
    """Of runs of two rows each no more than their own two are: 1 + 2 x 0.8 / 2."""
    series = first_order(200_000, 2)
    pairs = np.arange(len(series)) // 2
    by_pair = series[:4000], pairs[:4000]
    assert correlation_time(*by_pair) == pytest.approx(1.0 + KEEP, rel=0.1)
    assert correlation_time(series[:4000]) > 3.0 * correlation_time(*by_pair)


def test_a_constant_and_a_short_series_are_not_correlated():
    assert correlation_time(np.ones(50)) == 1.0
    assert correlation_time(np.array([1.0, 1.1, 0.9])) == 1.0
