"""Effect: a constant torque in the reading of one axis, or friction that differs between the two directions.

Both leave the same constant in the half-sums if friction is constant. Friction that grows with the transmitted torque
and decreases while the arm warms up distinguishes them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, Over, RestSetup, measured_axes, on_each_axis
from gateway.model.rest import AlteredModel
from gateway.model.term import AngleTorque, OnAxis, Term, plus
from gateway.model.visits import Visits, column_medians

Floats = NDArray[np.float64]

#: Largest half difference of upward and downward friction over their mean at rest, where part of both has relaxed.
LARGEST_SHARE: Final = 1.5


@dataclass(frozen=True, slots=True)
class TorqueOffset(AngleTorque):
    """Constant torque offset, independent of the motion."""

    name: ClassVar[str] = "torque_offset"
    takes_over: ClassVar[str] = "bias"
    in_reading: ClassVar[bool] = True
    parameters: ClassVar[tuple[str, ...]] = ("offset_nm",)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return np.ones((len(q_rad), 1))


@dataclass(frozen=True, slots=True)
class FrictionByDirection(OnAxis):
    """Offset proportional to the friction of each visit; `band_nm` is the friction band to which its size refers."""

    band_nm: float
    name: ClassVar[str] = "torque_offset"
    takes_over: ClassVar[str] = "bias"
    parameters: ClassVar[tuple[str, ...]] = ("offset_nm",)
    modelled: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, bias_share=plus(setting.bias_share, self.axis, theta[0] / self.band_nm))

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        """Return True if friction opposes the motion in both directions."""
        return bool(abs(theta[0]) < LARGEST_SHARE * self.band_nm)


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    bands = np.abs(column_medians(rows.difference_nm))
    for axis in measured_axes(rows):
        yield TorqueOffset(axis)
        if bands[axis] > 0.0:
            yield FrictionByDirection(axis, float(bands[axis]))


EFFECT: Final = Effect(
    name="torque_offset",
    words="a constant torque offset",
    meaning="a constant torque on one axis; at rest also friction that differs by direction",
    parameters=("offset_nm",),
    over=Over.ANGLE,
    at_rest=_at_rest,
    in_motion=on_each_axis(TorqueOffset),
    drawn=True,
)
