"""Ratio of held-out residuals of two models, with its confidence interval."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from gateway.diagnose.held_out_residuals import Held
from gateway.identify.correlation import counting_share

Floats = NDArray[np.float64]

#: Draws of the bootstrap, and stretches of time that it draws from.
DRAWS, FEWEST, MOST = 400, 6, 60
LARGEST_LOG = 6.0
#: Of the interval's ends, and between them of what the ratio is below in 95 %.
QUANTILES = np.array([0.025, 0.95, 0.975])


@dataclass(frozen=True, slots=True)
class HeldRatio:
    """Held-out RMS ratio after over before, its 95 % interval, and its one-sided 95 % limit `most`.

    NaN if nothing was held out.
    """

    value: float
    low: float
    high: float
    most: float

    @property
    def below_one(self) -> bool:
        """Return True if the ratio is below 1 with 95 % confidence."""
        return self.most < 1.0


#: Nothing was held out.
NOT_HELD = HeldRatio(np.nan, np.nan, np.nan, np.nan)


def held_ratio(before: Held, after: Held, axes: Collection[int], sigma_nm: Floats) -> HeldRatio:
    """Ratio pooled over axes in units of their noise (N,), with an interval by a bootstrap over time blocks.

    The number of blocks is the number of independent values; the interval is widened as Student's t against the normal.

    Parameters
    ----------
    before, after : Held
        The same rows, in the order of time.
    axes : collection of int
    sigma_nm : array of shape (N,)
    """
    own = [axis for axis in axes if before.counted[:, axis].any()]
    rows = before.counted[:, own].any(axis=1)
    if not own or not rows.any():
        return NOT_HELD
    was, now = (((held.residual_nm / sigma_nm)[rows][:, own] ** 2).sum(axis=1) for held in (before, after))
    if not was.sum() > 0 or np.array_equal(was, now):
        return HeldRatio(1.0, 1.0, 1.0, 1.0)
    count = int(np.clip(len(was) * counting_share(was - now), FEWEST, MOST))
    sums = np.array([[part.sum() for part in np.array_split(series, count)] for series in (was, now)])
    drawn = sums[:, np.random.default_rng(0).integers(0, count, size=(DRAWS, count))].sum(axis=2)
    value = float(np.sqrt(now.sum() / was.sum()))
    there = (drawn > 0).all(axis=0)
    if there.sum() < DRAWS // 2:
        return HeldRatio(value, 0.0, np.inf, np.inf)
    logs = 0.5 * np.log(drawn[1, there] / drawn[0, there])
    reach = (np.quantile(logs, QUANTILES) - np.log(value)) * np.sqrt(count / (count - 1.0))
    reach *= stdtrit(count - 1, QUANTILES) / ndtri(QUANTILES)
    low, most, high = (value * np.exp(np.clip(reach, -LARGEST_LOG, LARGEST_LOG))).tolist()
    return HeldRatio(value, low, high, most)
