"""The 95 % interval: every plus-minus in outputs is its half width.

Files hold standard deviations. Where the noise was estimated from few readings they are already widened by the ratio of
Student's quantile to the normal one, so that `TWO_SIDED_95` standard deviations cover the true value in 95 %.
"""

from __future__ import annotations

import math
from typing import Final

#: Two-sided 95 % quantile of the normal distribution.
TWO_SIDED_95: Final = 1.96
#: Text beside a number with a plus-minus.
SAID: Final = "95 %"
PLUS_MINUS: Final = "\N{PLUS-MINUS SIGN}"


def half_width(std: float) -> float:
    """Half width of the 95 % interval of a quantity with this standard deviation; NaN where that is unknown."""
    return TWO_SIDED_95 * std


def holds_zero(value: float, std: float) -> bool:
    """Whether the interval of a quantity holds 0; one that is not known, or known exactly, does not."""
    return math.isfinite(value) and math.isfinite(std) and std > 0 and abs(value) <= half_width(std)
