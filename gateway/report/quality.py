"""Quality of the model of one axis."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AxisQuality:
    """Residual of one axis and its noise floor [Nm]; NaN = not measured or unknown."""

    name: str
    floor: float
    before: float
    after: float
    band: float
    fit: float

    @property
    def ratio_before(self) -> float:
        """Return the ratio of the residual before to the noise floor."""
        return self.before / self.floor if self.floor > 0 else math.nan

    @property
    def ratio_after(self) -> float:
        """Return the ratio of the residual after to the noise floor."""
        return self.after / self.floor if self.floor > 0 else math.nan
