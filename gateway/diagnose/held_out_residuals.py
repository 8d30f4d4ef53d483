"""What a model leaves of rows that no fit has seen: the evidence of both strategies."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Residual of one model on unseen rows.

    Attributes
    ----------
    residual_nm : array of shape (rows, N)
        0 where it does not count.
    counted : bool array of shape (rows, N)
        Whether the row is unseen, and measured on that axis.
    """

    residual_nm: Floats
    counted: NDArray[np.bool_]

    @classmethod
    def of_rows(cls, residual_nm: Floats, axis: NDArray[np.int_], axes: int) -> Self:
        """Rows (k,) that belong to one `axis` (k,) each, of an arm of so many."""
        counted = axis[:, None] == np.arange(axes)
        return cls(residual_nm[:, None] * counted, counted)

    @property
    def square(self) -> Floats:
        """Sum of squares (N,) [Nm2]."""
        return (self.residual_nm**2).sum(axis=0)

    @property
    def rms_nm(self) -> Floats:
        """RMS (N,) [Nm], NaN for an axis that was not judged."""
        count = self.counted.sum(axis=0)
        return np.sqrt(np.where(count > 0, self.square, np.nan) / np.maximum(count, 1))

    def over(self, before: Held, axes: Iterable[int], std_nm: Floats) -> float:
        """RMS over that of another model on the same rows, pooled over axes in units of their noise (N,) or (rows, N).

        1 where the other leaves nothing.
        """
        own = list(axes)
        new, old = (((held.residual_nm / std_nm)[:, own] ** 2).sum() for held in (self, before))
        return float(np.sqrt(new / old)) if old > 0 else 1.0


def listed(values: Floats) -> tuple[float, ...]:
    """One number an axis, as a tuple."""
    return tuple(float(value) for value in values)
