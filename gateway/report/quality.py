"""How well the model explains one axis."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AxisQuality:
    """Residual of one axis against its noise floor, Nm; None = not measured or not known."""

    name: str
    floor: float | None
    before: float | None
    after: float | None
    band: float | None
    fit: float | None

    @property
    def ratio_before(self) -> float | None:
        """Residual before over the floor."""
        return _ratio(self.before, self.floor)

    @property
    def ratio_after(self) -> float | None:
        """Residual after over the floor."""
        return _ratio(self.after, self.floor)


def _ratio(value: float | None, floor: float | None) -> float | None:
    return value / floor if value is not None and floor is not None and floor > 0 else None
