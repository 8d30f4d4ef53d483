"""How well the model explains one axis."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AxisQuality:
    """Residual of one axis against its noise floor, Nm; NaN = not measured or not known."""

    name: str
    floor: float
    before: float
    after: float
    band: float
    fit: float

    @property
    def ratio_before(self) -> float:
        """Residual before over the floor."""
        return self.before / self.floor if self.floor > 0 else math.nan

    @property
    def ratio_after(self) -> float:
        """Residual after over the floor."""
        return self.after / self.floor if self.floor > 0 else math.nan
