"""Parts of the diagnosis at rest against closed forms, draws, and fits done in full."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.rest.holdout import left_out, left_out_with, spare_rows
from gateway.diagnose.rest.screen import Screen, log_bayes_factor, pair_log_bayes
from gateway.identify.rest.linear import Noise
from tests.data.resting_arm import basis_of

RNG = np.random.default_rng(7)


def screened(blocks, target) -> Screen:
    """Candidates as the screen hands them on: columns in units of their prior, nothing projected out."""
    alone = np.array([log_bayes_factor(block.T @ block, block.T @ target) for block in blocks])
    nothing = basis_of(np.zeros((len(target), 0)))
    one = tuple(np.ones(block.shape[1]) for block in blocks)
    return Screen(tuple(range(len(blocks))), alone, lambda index: blocks[index], one, nothing, target)  # type: ignore[arg-type]


def log_marginal(columns, target) -> float:
    """Log density of rows whose coefficients and noise have unit variance."""
    covariance = np.eye(len(target)) + columns @ columns.T
    return float(stats.multivariate_normal.logpdf(target, np.zeros(len(target)), covariance))


@pytest.mark.parametrize("width", [1, 2, 4])
def test_a_bayes_factor_is_the_ratio_of_the_marginal_densities(width):
    columns, target = RNG.normal(size=(12, width)), 2.0 * RNG.normal(size=12)
    expected = log_marginal(columns, target) - log_marginal(np.zeros((12, 1)), target)
    assert log_bayes_factor(columns.T @ columns, columns.T @ target) == pytest.approx(expected)


def test_a_candidate_is_estimated_with_its_prior():
    columns, target = RNG.normal(size=(12, 2)), RNG.normal(size=12)
    stacked, more = np.vstack([columns, np.eye(2)]), np.append(target, np.zeros(2))
    assert screened([columns], target).estimate(0) == pytest.approx(np.linalg.lstsq(stacked, more, rcond=None)[0])


def test_a_pair_is_weighed_as_both_together():
    blocks, target = [RNG.normal(size=(15, width)) for width in (1, 3, 2, 1)], 2.0 * RNG.normal(size=15)
    view = screened(blocks, target)
    pairs = np.array(list(itertools.combinations(range(4), 2)))
    found = pair_log_bayes(view, pairs[:, 0], pairs[:, 1])
    nothing = log_marginal(np.zeros((15, 1)), target)
    for (a, b), value in zip(pairs, found, strict=True):
        assert value == pytest.approx(log_marginal(np.hstack([blocks[a], blocks[b]]), target) - nothing)


@pytest.fixture
def fitted():
    """Rows of six poses and a least squares fit to them; the noise differs from row to row."""
    rows, poses = 30, np.repeat(np.arange(6), 5)
    design, target = RNG.normal(size=(rows, 4)), RNG.normal(size=rows)
    std = np.array([0.5, 2.0, 1.0])
    group = np.arange(rows) % 3
    weighted, right = design / std[group][:, None], target / std[group]
    basis, _ = np.linalg.qr(weighted)
    residual = std[group] * (right - basis @ (basis.T @ right))
    problem = SimpleNamespace(place=poses, visit=np.arange(rows), group=group)
    fit = SimpleNamespace(noise=Noise(std, std, std), residual=residual, basis=basis_of(basis))
    return problem, fit, weighted, right


def refitted(weighted, right, poses, prior=0) -> np.ndarray:
    """Residual of each row in the fit without its pose; the last `prior` columns have a unit prior."""
    out = np.empty(len(right))
    for pose in np.unique(poses):
        keep = poses != pose
        rows = np.vstack([weighted[keep], np.eye(weighted.shape[1])[weighted.shape[1] - prior :]])
        value = np.linalg.lstsq(rows, np.concatenate([right[keep], np.zeros(prior)]))[0]
        out[~keep] = (right - weighted @ value)[~keep]
    return out


def test_a_held_out_pose_is_predicted_by_the_others(fitted):
    problem, fit, weighted, right = fitted
    expected = fit.noise.std[problem.group] * refitted(weighted, right, problem.place)
    assert left_out(problem, fit) == pytest.approx(expected)


def test_and_so_it_is_with_one_more_candidate(fitted):
    problem, fit, weighted, right = fitted
    more = RNG.normal(size=(len(right), 2))
    away = fit.basis.left(more)
    view = screened([away], fit.basis.left(right))
    expected = refitted(np.hstack([weighted, away]), right, problem.place, prior=2)
    found = left_out_with(problem, fit, view, 0) / fit.noise.std[problem.group]
    # the prior is a row that is never left out
    assert found == pytest.approx(expected)


def test_rows_that_the_fit_has_not_taken_up():
    basis, _ = np.linalg.qr(RNG.normal(size=(12, 3)))
    count, taken = (np.bincount(np.arange(12) % 4, each, 15) for each in (None, (basis**2).sum(axis=1)))
    spare = spare_rows(SimpleNamespace(by_group=lambda: count), SimpleNamespace(taken=taken))
    assert spare.sum() == pytest.approx(12 - 3)
    assert spare[4] == 0.0
    assert spare[1] == pytest.approx(3.0 - (basis[1::4] ** 2).sum())


def test_what_is_held_out_is_pooled_in_units_of_the_noise():
    residual, axis = np.array([3.0, -4.0, 2.0, 6.0]), np.array([0, 0, 1, 3])
    held, other = Held.of_rows(residual, axis, 4), Held.of_rows(2.0 * residual, axis, 4)
    assert held.rms_nm == pytest.approx([np.sqrt(12.5), 2.0, np.nan, 6.0], nan_ok=True)
    assert held.over(other, range(4), np.ones(4)) == pytest.approx(0.5)
    mixed = Held.of_rows(np.array([3.0, -4.0, 4.0, 6.0]), axis, 4)
    noise = np.array([5.0, 1.0, 1.0, 1.0])
    assert held.over(mixed, (0, 1), noise) == pytest.approx(np.sqrt((1.0 + 4.0) / (1.0 + 16.0)))
    assert held.over(Held.of_rows(0.0 * residual, axis, 4), (0,), np.ones(4)) == 1.0
