"""Residuals of a model on rows that were not used in its fit: the evidence of both diagnosis methods."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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
