"""Effect: an encoder zero is wrong, so that the true joint angle differs from the reported one by a constant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, RestSetup, measured_axes
from gateway.model.motion import Modelled, MovingRows, changed_torque
from gateway.model.rest import AlteredModel
from gateway.model.term import OnAxis, Term, plus
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


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    yield from (JointZeroOffset(axis) for axis in measured_axes(rows))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    yield from (JointZeroOffset(axis) for axis in range(motion.axes))


EFFECT: Final = Effect(
    name="joint_zero_offset",
    words="a shifted joint zero",
    meaning="an encoder zero is wrong",
    parameters=("offset_rad",),
    at_rest=_at_rest,
    in_motion=_in_motion,
    drawn=True,
)
