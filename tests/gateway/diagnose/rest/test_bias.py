"""Friction by direction: which axes one-sided visits prove it for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_mistakes import friction_by_direction

N, VISITS = 6, 8
NOISE_NM = 2.0


def seen(band, std, sides=(4, 4)):
    """Problem and fit of visits, so many from above and from below, with a band and its standard deviation by axis."""
    side = np.repeat(np.array([1.0, -1.0]), sides)[:, None] * np.ones(N)
    two_sided, use = np.zeros(len(side), dtype=bool), np.ones(side.shape, dtype=bool)
    rows = SimpleNamespace(side=side, two_sided=two_sided)
    problem = SimpleNamespace(rows=rows, use_sum=use, axes=N, band_part=slice(28, 28 + N), nuisance_part=slice(34, 70))
    covariance = np.diag(np.concatenate([np.full(28, 1e6), np.asarray(std) ** 2, np.ones(36)]))
    noise = SimpleNamespace(std=np.concatenate([np.full(2 * N, np.nan), NOISE_NM * np.arange(1, N + 1)]))
    return problem, SimpleNamespace(band=np.asarray(band, dtype=float), covariance=covariance, noise=noise)


def test_an_axis_is_named_where_its_own_band_is_certain_and_larger_than_a_trifle():
    band = np.array([5.1, 4.9, 30.0, 30.0, -30.0, 30.0])
    std = np.array([1.0, 1.0, 6.1, 1.0, 1.0, 5.9])
    found = friction_by_direction(*seen(band, std))
    assert [entry.joints for entry in found] == [(1,), (4,), (6,)]
    assert found[0].parameters == {"bias_nm": 5.1}
    assert found[1].std == {"bias_nm": 1.0}
    assert found[2].evidence.p_value == pytest.approx(6 * stats.norm.sf(30.0 / 5.9))
    # what is left without it: the noise, and the friction that comes from either side
    assert found[1].evidence.holdout_rms_ratio == pytest.approx(8.0 / np.hypot(8.0, 30.0))


def test_a_band_below_half_the_noise_does_not_matter():
    least = REST.bias_strength * NOISE_NM * np.arange(1, N + 1)
    assert len(friction_by_direction(*seen(1.01 * least, np.full(N, 0.01)))) == N
    assert not friction_by_direction(*seen(0.99 * least, np.full(N, 0.01)))


@pytest.mark.parametrize(("sides", "identifiable"), [((2, 2), N), ((1, 7), 0), ((7, 1), 0), ((0, 8), 0)])
def test_both_sides_have_to_be_there_twice(sides, identifiable):
    assert len(friction_by_direction(*seen(np.full(N, 50.0), np.ones(N), sides))) == identifiable
