"""Autocorrelation of residuals: how many rows are worth one independent row."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Rows below which no correlation is estimated.
_FEWEST: Final = 8
#: Correlation [-] below which the sum ends: smaller values are those of few independent rows.
_FADED: Final = 0.05
#: Longest lag [rows], and as a share of the rows; longer lags have too few pairs.
_LONGEST, _LONGEST_SHARE = 2000, 0.25


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
