"""Detect a drift by the likelihood ratio of the checks with and without a drift.

The drift hypothesis is a mixture: the tolerated drift or, less likely, a sixteenth of it to eight times as much, in
both directions. Level, temperature, load and the noise of a check are unknown under both hypotheses (flat priors, 1 /
noise). The correlated noise has one of several shapes with the frequencies seen in the fleet. Without drift the
likelihood ratio is a martingale from check to check, so that the probability that it ever reaches 1 / a is at most a,
for any number of looks (Ville, Étude critique de la notion de collectif, 1939; for priors like these Hendriksen, de
Heide and Grünwald, Optional Stopping with Bayes Factors, 2021).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gateway.fleet.correlated_noise import FittedLines

Floats = NDArray[np.float64]

#: False alarms of a robot in a year, all axes and quantities together.
FALSE_PER_YEAR: Final = 0.01
#: Power of the detection: a drift is missed in 5 % of the cases.
POWER: Final = 0.95
POWER_SIGMAS: Final = float(ndtri(POWER))
#: Minimum for a line: days from the first to the last check, and number of checks.
FEWEST_DAYS: Final = 28.0
FEWEST_CHECKS: Final = 14
#: Column of the drift.
DRIFT: Final = 1
#: Drifts over what is tolerated, and how likely each is: mostly as much as is tolerated.
_SIZES: Final = 2.0 ** np.arange(-4, 4)
_AS_TOLERATED: Final = 0.8
_ANOTHER: Final = (1.0 - _AS_TOLERATED) / (len(_SIZES) - 1)
#: Up and down.
_DRIFTS: Final = np.concatenate([-_SIZES, _SIZES])
_SHARES: Final = np.where(np.abs(_DRIFTS) == 1.0, _AS_TOLERATED, _ANOTHER) / 2.0


def needed_sigmas(series: int) -> float:
    """Return the detection threshold in sigmas for this number of series of a robot."""
    return float(np.sqrt(2.0 * np.log(max(series, 1) / FALSE_PER_YEAR)))


def sigmas(of: FittedLines, log_prior: Floats, tolerance: Floats) -> Floats:
    """Return the signed significance (M,) of a drift: root of twice the logarithm of the ratio; NaN where there are too
    few checks.

    Where all else is known this is at most the drift over its standard deviation.

    Parameters
    ----------
    of : FittedLines
    log_prior : array of shape (G, M)
        Log frequency of every shape.
    tolerance : array of shape (M,)
        Drift a year that is tolerated, in the units of the series; above 0.
    """
    none, some = (np.logaddexp.reduce(each + log_prior, axis=0) for each in _none_and_some(of, tolerance))
    log_ratio = some - none
    weight = weights(of, log_prior)
    sign = np.sign((weight * of.value[:, :, DRIFT]).sum(axis=0))
    return np.where(of.freedom >= FEWEST_CHECKS - 4, sign * np.sqrt(2.0 * np.maximum(log_ratio, 0.0)), np.nan)


def detectable(std: Floats, tolerance: Floats, needed: float) -> Floats:
    """Return the yearly drift (M,) detected with a probability of 95 % for a standard deviation; NaN for NaN."""
    drifts = _DRIFTS[:, None] * tolerance
    known = np.where(std > 0.0, np.maximum(std, 1e-6 * tolerance), 1.0)
    low, high = np.zeros_like(known), 1e3 * known + 1e3 * tolerance
    for _ in range(60):
        middle = 0.5 * (low + high)
        over = drifts * (middle - 0.5 * drifts) / known**2
        reached = np.logaddexp.reduce(over + np.log(_SHARES)[:, None], axis=0) >= 0.5 * needed**2
        low, high = np.where(reached, low, middle), np.where(reached, middle, high)
    return np.where(std > 0.0, high + POWER_SIGMAS * std, np.nan)


def log_seen(of: FittedLines, tolerance: Floats) -> Floats:
    """Return the log likelihood (G, M) of every shape, drift and no drift being equally probable."""
    return np.logaddexp(*_none_and_some(of, tolerance)) + np.log(0.5)


def _none_and_some(of: FittedLines, tolerance: Floats) -> tuple[Floats, Floats]:
    """Return the log likelihoods (G, M) of every shape without drift, and with the mixture of drifts."""
    drifts = _DRIFTS[:, None] * tolerance
    some = _log_likelihood(of, drifts) + np.log(_SHARES)[:, None, None]
    return _log_likelihood(of, np.zeros((1, len(tolerance))))[0], np.logaddexp.reduce(some, axis=0)


def _log_likelihood(of: FittedLines, drifts: Floats) -> Floats:
    """Return the log likelihood (K, G, M) of drifts (K, M) for every shape; level, temperature, load and noise
    integrated out.
    """
    known = np.maximum(of.freedom, 1.0)
    variance = np.maximum(of.covariance[:, :, DRIFT, DRIFT], 1e-300)
    away = (of.value[:, :, DRIFT] - drifts[:, None, :]) ** 2 / variance
    # Of the line with its drift: one freedom less, and the determinant holds the drift too.
    with_it = of.log_likelihood - 0.5 * np.log(variance)
    return with_it - 0.5 * (known + 1.0) * np.log1p(away / known)


def weights(of: FittedLines, log_prior: Floats) -> Floats:
    """Return the posterior weight (G, M) of every shape, given the checks and its log frequency (G, M)."""
    log = of.log_likelihood + log_prior
    raw = np.exp(log - log.max(axis=0))
    return raw / raw.sum(axis=0)


def mixed(of: FittedLines, weight: Floats) -> tuple[Floats, Floats]:
    """Return mean (M, p) and covariance (M, p, p) over the shapes."""
    mean = (weight[..., None] * of.value).sum(axis=0)
    away = of.value - mean
    widened = of.covariance * (np.maximum(of.freedom, 3.0) / (np.maximum(of.freedom, 3.0) - 2.0))[:, None, None]
    covariance = (weight[..., None, None] * (widened + away[..., :, None] * away[..., None, :])).sum(axis=0)
    return mean, covariance
