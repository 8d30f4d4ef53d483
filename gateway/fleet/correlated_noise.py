"""Straight lines through checks with white and correlated noise: generalised least squares by a Kalman filter.

A check reads `level + drift t + per_k T + per_kg m + correlated noise + white noise`. The correlated noise is a
stationary process with the autocorrelation `exp(-t / tau)`. `Shape` holds its variance over that of the white noise,
and its time constant; the variance of the white noise is estimated from each series. The filter makes the checks
independent one by one (Durbin and Koopman, Time Series Analysis by State Space Methods, 2012, 6.2.3 for the columns of
a regression), so that one pass gives the line as of every day.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
