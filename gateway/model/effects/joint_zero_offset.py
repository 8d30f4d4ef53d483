"""Effect: an encoder zero is wrong, so that the true joint angle differs from the reported one by a constant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, on_each_axis
from gateway.model.motion import Modelled, MovingRows, changed_torque
from gateway.model.rest import AlteredModel
from gateway.model.term import OnAxis, plus
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JointZeroOffset(OnAxis):
    """Difference between true and reported angle; to first order in motion."""

    name: ClassVar[str] = "joint_zero_offset"
    parameters: ClassVar[tuple[str, ...]] = ("offset_rad",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1,)
    #: Largest zero error: more than 11 degrees is visible.
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {"offset_rad": (-0.2, 0.2)}
    modelled: ClassVar[bool] = True

    def enters(self, axes: int) -> tuple[int, ...]:
        return tuple(range(axes))

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, zero_offset_rad=plus(setting.zero_offset_rad, self.axis, theta[0]))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return changed_torque(motion.by_angle(self.axis), modelled)[:, :, None]


EFFECT: Final = Effect(
    name="joint_zero_offset",
    words="a shifted joint zero",
    meaning="an encoder zero is wrong",
    parameters=("offset_rad",),
    at_rest=on_each_axis(JointZeroOffset),
    in_motion=lambda motion, setup: map(JointZeroOffset, range(motion.axes)),
    drawn=True,
)
