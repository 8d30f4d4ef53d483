"""Residuals on rows that were not used in a fit, and the ratio of two models' with its confidence interval."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from gateway.identify.spread import counting_share

Floats = NDArray[np.float64]

#: Draws of the bootstrap, and stretches of time that it draws from.
DRAWS, FEWEST, MOST = 400, 6, 60
LARGEST_LOG = 6.0
#: Of the interval's ends, and between them of what the ratio is below in 95 %.
QUANTILES = np.array([0.025, 0.95, 0.975])


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Residuals of one model on held-out rows.

    Attributes
    ----------
    residual_nm : array of shape (rows, N)
        0 where not counted.
    counted : bool array of shape (rows, N)
        True if the row was held out and the axis was measured.
    """

    residual_nm: Floats
    counted: NDArray[np.bool_]

    @classmethod
    def of_rows(cls, residual_nm: Floats, axis: NDArray[np.int_], axes: int) -> Self:
        """Build from rows (k,) that belong to one `axis` (k,) each, for an arm with this number of axes."""
        counted = axis[:, None] == np.arange(axes)
        return cls(residual_nm[:, None] * counted, counted)

    @property
    def square(self) -> Floats:
        """Sum of squares (N,) [Nm2]."""
        return (self.residual_nm**2).sum(axis=0)

    @property
    def rms_nm(self) -> Floats:
        """RMS (N,) [Nm]; NaN for an axis without held-out rows."""
        count = self.counted.sum(axis=0)
        return np.sqrt(np.where(count > 0, self.square, np.nan) / np.maximum(count, 1))

    def over(self, before: Held, axes: Iterable[int], std_nm: Floats) -> float:
        """Ratio of this model's RMS to another model's on the same rows, over axes in units of their noise.

        The noise is (N,) or (rows, N). The ratio is 1 if the other model has no residual.
        """
        own = list(axes)
        new, old = (((held.residual_nm / std_nm)[:, own] ** 2).sum() for held in (self, before))
        return float(np.sqrt(new / old)) if old > 0 else 1.0


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
