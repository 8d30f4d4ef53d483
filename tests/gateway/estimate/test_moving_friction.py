"""The curve of friction near standstill, and what is known of gains that belong together."""

import numpy as np
import pytest

from gateway.identify.motion.prior import fall_columns, fall_speeds, gains_prior, shown_fall, with_common_part
from gateway.identify.nuisance import UNEVEN_LOSS
from gateway.identify.solve import Prior


def test_one_fall_comes_back_as_itself():
    falls_rad_s = np.array([0.01, 0.03, 0.09])
    found = shown_fall(np.array([0.0, 5.0, 0.0]), 0.01 * np.eye(3), falls_rad_s)
    assert found is not None
    assert found.speed_rad_s == pytest.approx(0.03, rel=0.05)
    assert found.size_nm == pytest.approx(5.0, rel=0.03)
    assert found.shares @ np.array([0.0, 5.0, 0.0]) == pytest.approx(found.size_nm)


def test_a_fall_that_may_be_none_does_not_show():
    falls_rad_s = np.array([0.01, 0.03, 0.09])
    assert shown_fall(np.array([0.0, 5.0, 0.0]), 9.0 * np.eye(3), falls_rad_s) is None
    assert shown_fall(np.array([0.0, -5.0, 0.0]), 0.01 * np.eye(3), falls_rad_s) is None


def test_columns_of_a_fall_are_of_the_axis_and_of_its_fastest():
    qd = np.array([[0.0, 1.0], [2.0, -0.5], [-0.02, 0.03]])
    speeds = fall_speeds(qd)
    assert speeds.shape[0] == 2
    np.testing.assert_allclose(speeds[0] / speeds[1], 2.0)
    columns = fall_columns(qd, speeds, 0.02)
    assert columns.shape == (3, 2, 2 * speeds.shape[1])
    assert not columns[:, 0, speeds.shape[1] :].any()
    first = np.tanh(-0.02 / 0.02) * np.exp(-((0.02 / speeds[0, 0]) ** 2))
    assert columns[2, 0, 0] == pytest.approx(first)


def test_gains_with_errors_in_common_keep_each_their_uncertainty():
    std = np.array([5.0, 0.03, 0.02, 0.03, 0.04])
    mean = np.array([1.0, 0.01, 0.0, 0.02, 0.0])
    prior = with_common_part(Prior(mean, std, np.zeros((0, 5)), np.zeros(0)), np.arange(1, 5))
    covariance = np.linalg.inv(prior.precision)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), std)
    correlation = covariance / np.outer(std, std)
    np.testing.assert_allclose(correlation[1:, 1:][~np.eye(4, dtype=bool)], 0.5)
    np.testing.assert_allclose(correlation[0, 1:], 0.0)
    np.testing.assert_allclose(prior.stds(np.arange(1, 5)), std[1:])
    # the means are where the prior is at rest
    pull = prior.std**-2.0 * (mean - prior.mean) + prior.rows.T @ (prior.right - prior.rows @ mean)
    np.testing.assert_allclose(pull, 0.0, atol=1e-9)


def test_a_loss_that_is_seen_says_how_uneven_it_may_be():
    prior = Prior(np.zeros(4), np.array([0.01, 0.01, 1.0, 1.0]), np.zeros((0, 4)), np.zeros(0))
    columns, std = {"gain": np.array([0, 1]), "load_friction": np.array([2, 3])}, np.zeros(4)
    found = gains_prior(prior, columns, np.array([1e-9, 0.03]), np.array([0.0, 0.0, 0.1, 0.02]), std)
    # constants, half of what one efficiency leaves in the middle, how uneven the loss is, and the least of that
    assert found.std[0] == pytest.approx(np.linalg.norm([1e-9, 0.1**2 / 4.0, UNEVEN_LOSS * 0.1, 0.0015]), rel=1e-6)
    assert found.std[1] == pytest.approx(0.03, rel=0.01)
    np.testing.assert_allclose(found.mean[:2], np.array([0.1, 0.02]) ** 2 / 4.0)
    np.testing.assert_allclose(found.std[2:], 1.0)
    # a gear that loses nothing that shows may yet lose otherwise driven back
    least = gains_prior(prior, columns, np.array([1e-9, 1e-9]), np.zeros(4), std)
    np.testing.assert_allclose(least.std[:2], 0.0015)
