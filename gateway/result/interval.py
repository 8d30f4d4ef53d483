"""Half widths of 95 % intervals, used for every plus-minus in outputs.

Files contain standard deviations. If the noise was estimated from few readings, these are already widened by the
ratio of Student's quantile to the normal one. Therefore `TWO_SIDED_95` standard deviations cover the true value in 95
%.
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
    """Return the half width of the 95 % interval for a standard deviation; NaN if it is unknown."""
    return TWO_SIDED_95 * std


def holds_zero(value: float, std: float) -> bool:
    """Return whether the interval of a quantity contains 0; False if its uncertainty is unknown or zero."""
    return math.isfinite(value) and math.isfinite(std) and std > 0 and abs(value) <= half_width(std)
