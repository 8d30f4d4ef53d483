"""Spread of fitted parameters: from the autocorrelation of residuals, and from estimates on parts of the data."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Rows below which no correlation is estimated.
_FEWEST: Final = 8
#: Correlation [-] below which the sum ends: smaller values are those of few independent rows.
_FADED: Final = 0.05
#: Longest lag [rows], and as a share of the rows; longer lags have too few pairs.
_LONGEST, _LONGEST_SHARE = 2000, 0.25
#: Least number of differences of a spread.
FEWEST_PARTS = 3
#: Least number of blocks of a run.
FEWEST_BLOCKS = 8


def correlation_time(residual: Floats, run: NDArray[Any] | None = None) -> float:
    """Return how many rows of a series (n,) make one independent row: 1 + 2 sum of its autocorrelation.

    The sum ends where it has faded. Rows of two runs (n,) are not correlated; without runs all rows are one.
    """
    left = residual - residual.mean()
    power = float(left @ left)
    if power <= 0.0 or len(left) < _FEWEST:
        return 1.0
    last = max(min(int(_LONGEST_SHARE * len(left)), _LONGEST), 2)
    total = np.zeros(last)
    for part in [left] if run is None else [left[run == name] for name in np.unique(run)]:
        spectrum = np.abs(np.fft.rfft(part, 1 << (len(part) + last).bit_length())) ** 2
        total += np.fft.irfft(spectrum)[:last]
    faded = np.flatnonzero(total < _FADED * power)
    stop = int(faded[0]) if len(faded) else last
    return 1.0 + 2.0 * float(total[1:stop].sum()) / power


def counting_share(series: Floats) -> float:
    """Return the share of the rows of a series (n,) that count as independent."""
    return 1.0 / correlation_time(series)


def jackknife(estimates: Floats) -> Floats:
    """Covariance of estimates (splits, k) that leave out one block of time each; zero for fewer than three."""
    if len(estimates) < FEWEST_PARTS:
        return np.zeros((estimates.shape[1],) * 2)
    centred = estimates - estimates.mean(axis=0)
    return (len(estimates) - 1) / len(estimates) * centred.T @ centred


def wider(first: Floats, second: Floats) -> Floats:
    """Return the first covariance (k, k), each parameter widened to the second one's variance where that is larger.

    Both measure the same spread. The second is of few parts: it determines sizes, but no correlations.
    """
    own = np.maximum(np.diag(first), 1e-300)
    scale = np.sqrt(np.maximum(np.diag(second) / own, 1.0))
    return first * scale * scale[:, None]


def by_blocks(pull: Floats, row: Ints, run: NDArray[np.str_], length: float) -> Floats:
    """Squared contributions (p, p) of rows (k, p) to the estimate, summed by block of time.

    Parameters
    ----------
    pull : array of shape (k, p)
    row : int array of shape (k,)
        Instant of each, which runs through `run`.
    run : array of shape (n,)
    length : float
        Rows of a block; a run has at least `FEWEST_BLOCKS` blocks.
    """
    block = np.zeros(len(run), dtype=int)
    start = 0
    for name in np.unique(run):
        mine = np.flatnonzero(run == name)
        count = max(int(len(mine) / max(length, 1.0)), min(FEWEST_BLOCKS, len(mine)))
        block[mine] = start + np.arange(len(mine)) * count // len(mine)
        start += count
    sums = np.zeros((start, pull.shape[1]))
    np.add.at(sums, block[row], pull)
    return sums.T @ sums * (start / max(start - 1, 1))
