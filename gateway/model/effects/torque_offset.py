"""Effect: a constant torque in the reading of one axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, measured_axes, moving_axes
from gateway.model.motion import MovingRows
from gateway.model.term import ReadingTorque, Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TorqueOffset(ReadingTorque):
    """Constant torque offset, independent of the motion."""

    name: ClassVar[str] = "torque_offset"
    takes_over: ClassVar[str] = "bias"
    parameters: ClassVar[tuple[str, ...]] = ("offset_nm",)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return np.ones((len(q_rad), 1))


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    yield from (TorqueOffset(axis) for axis in measured_axes(rows))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    yield from (TorqueOffset(axis) for axis in moving_axes(motion))


EFFECT: Final = Effect(
    name="torque_offset",
    words="a constant torque offset",
    meaning="a constant torque on one axis",
    parameters=("offset_nm",),
    over=Over.ANGLE,
    at_rest=_at_rest,
    in_motion=_in_motion,
    drawn=True,
)
