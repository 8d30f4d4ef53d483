"""Straight lines through checks with white and correlated noise: generalised least squares by a Kalman filter.

A check reads `level + drift t + per_k T + per_kg m + correlated noise + white noise`. The correlated noise is a
stationary process with the autocorrelation `exp(-t / tau)`. `Shape` holds its variance over that of the white noise,
and its time constant; the variance of the white noise is estimated from each series. The filter makes the checks
independent one by one (Durbin and Koopman, Time Series Analysis by State Space Methods, 2012, 6.2.3 for the columns of
a regression), so that one pass gives the line as of every day.

A drift is detected by the likelihood ratio of the checks with and without a drift. The drift hypothesis is a mixture:
the tolerated drift or, less likely, a sixteenth of it to eight times as much, in both directions. Level, temperature,
load and the noise of a check are unknown under both hypotheses (flat priors, 1 / noise). The correlated noise has one
of several shapes with the frequencies seen in the fleet. Without drift the likelihood ratio is a martingale from
check to check, so that the probability that it ever reaches 1 / a is at most a, for any number of looks (Ville, Étude
critique de la notion de collectif, 1939; for priors like these Hendriksen, de Heide and Grünwald, Optional Stopping
with Bayes Factors, 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]


@dataclass(frozen=True, slots=True)
class Shape:
    """Correlated noise: variance relative to the white noise of one check, and time constant [a]."""

    ratio: float
    time_a: float


#: Variance ratios by time constant [d]: finer where they affect the significance of a drift.
_SIZES: dict[float, tuple[float, ...]] = {
    10.0: (0.25, 1.0),
    30.0: (0.06, 0.12, 0.25, 0.5, 1.0, 2.0),
    90.0: (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0),
}
#: None, and those.
SHAPES: tuple[Shape, ...] = (
    Shape(0.0, 1.0),
    *(Shape(ratio, days / 365.25) for days, ratios in _SIZES.items() for ratio in ratios),
)


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Whitened sums over the checks up to a day, for G shapes and M series with q - 1 columns and the values last.

    Attributes
    ----------
    products : (G, M, q, q), whitened
    log_spread : (G, M) sum of the logarithms of the variances, in units of the noise
    count : (M,) checks
    """

    products: Floats
    log_spread: Floats
    count: Floats


def sums(time_a: Floats, columns: Floats, relative_std: Floats, looks: Ints) -> list[Sums]:
    """Return the whitened sums at every look.

    Parameters
    ----------
    time_a : array of shape (n,)
        Years, in ascending order.
    columns : array of shape (n, M, q)
        Columns of the regression, and the values last; NaN = no check.
    relative_std : array of shape (n, M)
        Standard deviation of the noise of every check, relative to a typical check.
    looks : array of shape (k,)
        Number of checks, at least 1, after which the sums are returned.
    """
    count, series, width = columns.shape
    ratio = np.array([shape.ratio for shape in SHAPES])[:, None]
    rate = np.array([1.0 / shape.time_a for shape in SHAPES])[:, None]
    mean = np.zeros((len(SHAPES), series, width))
    variance = np.broadcast_to(ratio, (len(SHAPES), series)).copy()
    products = np.zeros((len(SHAPES), series, width, width))
    log_spread = np.zeros((len(SHAPES), series))
    there = np.isfinite(columns).all(axis=2) & np.isfinite(relative_std)
    filled = np.where(there[:, :, None], columns, 0.0)
    noise = np.where(there, relative_std, 1.0) ** 2
    steps = np.diff(time_a, prepend=time_a[:1])
    out: list[Sums] = []
    wanted = set(looks.tolist())
    seen = np.zeros(series)
    for row in range(count):
        kept = np.exp(-rate * steps[row])
        mean *= kept[:, :, None]
        variance = kept**2 * variance + ratio * (1.0 - kept**2)
        spread = variance + noise[row]
        use = there[row]
        innovation = np.where(use[:, None], filled[row] - mean, 0.0)
        share = np.where(use, variance / spread, 0.0)
        mean += share[:, :, None] * innovation
        variance = variance * (1.0 - share)
        products += innovation[:, :, :, None] * (innovation / spread[:, :, None])[:, :, None, :]
        log_spread += np.where(use, np.log(spread), 0.0)
        seen += use
        if row + 1 in wanted:
            out.append(Sums(products.copy(), log_spread.copy(), seen.copy()))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class FittedLines:
    """Fitted lines for G shapes and M series with p columns.

    Attributes
    ----------
    value : (G, M, p)
    covariance : (G, M, p, p), with the noise estimated from the series
    square : (G, M) variance of the noise of one check
    freedom : (M,) checks minus columns; below 1 the line is not determined
    log_likelihood : (G, M) of the shape, restricted
    """

    value: Floats
    covariance: Floats
    square: Floats
    freedom: Floats
    log_likelihood: Floats


def lines(of: Sums, active: NDArray[np.bool_]) -> FittedLines:
    """Return the fitted lines; inactive columns are omitted.

    Parameters
    ----------
    of : Sums
    active : array of shape (M, p)
    """
    width = active.shape[1]
    both = active[:, :, None] & active[:, None, :]
    normal = np.where(both, of.products[:, :, :width, :width], 0.0)
    idle = np.where(active, 0.0, 1.0)
    diagonal = np.einsum("gmii->gmi", normal)
    scale = 1.0 / np.sqrt(np.where(active & (diagonal > 0.0), diagonal, 1.0))
    scaled = normal * scale[..., :, None] * scale[..., None, :]
    scaled = scaled + (idle + np.where(active, 1e-10, 0.0))[..., :, None] * np.eye(width)
    inverse = np.linalg.inv(scaled)
    right = np.where(active, of.products[:, :, :width, width], 0.0) * scale
    solved = np.einsum("gmij,gmj->gmi", inverse, right)
    left = np.maximum(of.products[:, :, width, width] - np.einsum("gmi,gmi->gm", solved, right), 0.0)
    freedom = of.count - active.sum(axis=1)
    known = np.maximum(freedom, 1.0)
    square = np.maximum(left / known, 1e-300)
    log_normal = np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum(axis=2)
    likelihood = -0.5 * (known * np.log(square) + of.log_spread + log_normal)
    covariance = inverse * scale[..., :, None] * scale[..., None, :] * square[..., None, None]
    return FittedLines(solved * scale, covariance, square, freedom, likelihood)


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
_DRIFT_SIZES: Final = 2.0 ** np.arange(-4, 4)
_AS_TOLERATED: Final = 0.8
_ANOTHER: Final = (1.0 - _AS_TOLERATED) / (len(_DRIFT_SIZES) - 1)
#: Up and down.
_DRIFTS: Final = np.concatenate([-_DRIFT_SIZES, _DRIFT_SIZES])
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
