"""Noise estimated from the residual: closed forms, and intervals that hold what they promise."""

import numpy as np
import pytest
from scipy import stats

from gateway.estimate.noise import Groups, fit_noise, noise_levels
from gateway.identify.solve import Prior


def groups(index, stated=0.0, scale=None, **seen):
    index = np.asarray(index)
    count = index.max() + 1
    return Groups(
        index=index,
        stated=np.broadcast_to(np.asarray(stated, dtype=float), index.shape).copy(),
        scale_nm=np.ones(count) if scale is None else np.asarray(scale, dtype=float),
        seen=np.asarray(seen.get("seen", np.full(count, np.nan)), dtype=float),
        seen_stated=np.zeros(count),
        seen_weight=np.asarray(seen.get("weight", np.zeros(count)), dtype=float),
    )


def design_of(n, p, seed=0):
    return np.random.default_rng(seed).normal(size=(n, p))


def test_one_group_is_the_residual_over_its_freedom():
    design = design_of(30, 4)
    target = design @ [1, 2, 3, 4] + 0.7 * np.random.default_rng(1).normal(size=30)
    # a group of its own takes part in no pooling when its level was seen with no weight
    fit = fit_noise(design, target, Prior.free(4), groups(np.zeros(30, dtype=int), seen=[1.0], weight=[0.0]))
    left = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    assert fit.extra[0] == pytest.approx(left @ left / 26, rel=1e-3)
    np.testing.assert_allclose(fit.widening(np.eye(4)), stats.t.ppf(0.975, 26) / stats.norm.ppf(0.975), rtol=1e-3)
    np.testing.assert_allclose(fit.std(np.eye(4)) / fit.widening(np.eye(4)), np.sqrt(np.diag(fit.covariance)))


def test_noise_that_the_stated_one_explains_is_left_alone():
    rng = np.random.default_rng(2)
    design, std = design_of(60, 5), 0.3
    target = design @ np.ones(5) + std * rng.normal(size=60)
    fit = fit_noise(design, target, Prior.free(5), groups(np.arange(60) % 6, stated=std**2))
    assert (fit.extra == 0).all()
    np.testing.assert_allclose(fit.widening(np.eye(5)), 1.0)
    np.testing.assert_allclose(fit.covariance, std**2 * np.linalg.inv(design.T @ design), rtol=1e-9)


def test_one_axis_beyond_its_stated_noise_is_enough_for_extra_noise_on_it():
    """In all the residual is as stated: one group is three times as noisy, the others are quiet."""
    rng = np.random.default_rng(7)
    index = np.repeat(np.arange(10), 30)
    design, std = design_of(300, 3), 0.3
    size = np.where(index == 4, 3.0 * std, 0.2 * std)
    target = design @ np.ones(3) + size * rng.normal(size=300)
    levels = noise_levels(design, target, Prior.free(3), groups(index, stated=std**2))
    assert np.sqrt(levels.extra[4]) == pytest.approx(np.sqrt(8.0) * std, rel=0.3)
    assert (np.sqrt(np.delete(levels.extra, 4)) < 0.2 * std).all()


def test_noise_beyond_the_stated_one_is_found():
    rng = np.random.default_rng(3)
    index = np.arange(600) % 3
    true = np.array([0.5, 2.0, 1.0])
    target = design_of(600, 4) @ np.ones(4) + np.hypot(true, 0.3)[index] * rng.normal(size=600)
    levels = noise_levels(design_of(600, 4), target, Prior.free(4), groups(index, stated=0.09))
    np.testing.assert_allclose(np.sqrt(levels.extra), true, rtol=0.15)


def test_further_observations_of_the_noise_count():
    design = design_of(8, 4)
    target = design @ np.ones(4) + 0.01 * np.random.default_rng(4).normal(size=8)
    few = fit_noise(design, target, Prior.free(4), groups(np.zeros(8, dtype=int), seen=[4.0], weight=[1000.0]))
    assert np.sqrt(few.extra[0]) == pytest.approx(2.0, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "count"), [(24, 3), (48, 6)])
def test_intervals_hold_the_truth_when_noise_is_estimated_from_few_rows(rows, count):
    """Groups of unequal noise whose relative size is known within a factor of about 1.5: intervals of 95 %."""
    rng = np.random.default_rng(5)
    index = np.arange(rows) % count
    level = np.geomspace(0.3, 3.0, count)
    sigma = level[index]
    design, truth = design_of(rows, 4, 6), np.array([3.0, -1.0, 2.0, 0.5])
    guess = np.where(np.arange(count) % 2, 1.5, 0.7)
    inside = []
    for _ in range(300):
        target = design @ truth + sigma * rng.normal(size=rows)
        fit = fit_noise(design, target, Prior.free(4), groups(index, scale=level * guess))
        inside.append(np.abs(fit.solution.value - truth) < 1.96 * fit.std(np.eye(4)))
    print(np.mean(inside))
    assert 0.915 < np.mean(inside) < 0.98


def test_a_row_without_noise_does_not_break_it():
    design = design_of(20, 3)
    fit = fit_noise(design, design @ np.ones(3), Prior.free(3), groups(np.arange(20) % 2))
    np.testing.assert_allclose(fit.solution.value, 1.0, rtol=1e-9)
    assert np.isfinite(fit.std(np.eye(3))).all()
