"""Effect: a joint deflects under load, so that the link angle differs from the motor angle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, largest_torque_nm, measured_axes
from gateway.model.motion import Modelled, MovingRows, changed_torque
from gateway.model.rest import AlteredModel
from gateway.model.term import OnAxis, Seen, Term, plus
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Largest gear deflection under the largest torque [rad].
LARGEST_WIND_UP_RAD: Final = 0.05


@dataclass(frozen=True, slots=True)
class JointElasticity(OnAxis):
    """Joint compliance: the link angle is `q - compliance tau`; to first order in motion."""

    largest_nm: float = 1.0
    name: ClassVar[str] = "joint_elasticity"
    parameters: ClassVar[tuple[str, ...]] = ("compliance_rad_nm",)
    modelled: ClassVar[bool] = True

    @property
    def spread(self) -> tuple[float, ...]:
        return (2.0 * LARGEST_WIND_UP_RAD / self.largest_nm,)

    def enters(self, axes: int) -> tuple[int, ...]:
        return tuple(range(axes))

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, compliance_rad_nm=plus(setting.compliance_rad_nm, self.axis, theta[0]))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        wound = modelled.rigid_nm[:, [self.axis]]
        return -(changed_torque(motion.by_angle(self.axis), modelled) * wound)[:, :, None]

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        return bool(theta[0] > 0)

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        largest = float(np.abs(seen.modelled.rigid_nm[:, self.axis]).max())
        return bool(0.0 < value[0] * largest < LARGEST_WIND_UP_RAD)


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    largest = largest_torque_nm(setup)
    for axis in measured_axes(rows):
        if not np.isfinite(rows.wind_up_rad[:, axis]).all():
            yield JointElasticity(axis, float(largest[axis]))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    # a secondary encoder shows the elasticity of its joint by itself
    for axis in measured_axes(motion):
        if not np.isfinite(motion.wind_up_rad[0, axis]):
            yield JointElasticity(axis)


EFFECT: Final = Effect(
    name="joint_elasticity",
    words="an elastic joint",
    meaning="a joint deflects under load",
    parameters=("compliance_rad_nm",),
    over=Over.TORQUE,
    at_rest=_at_rest,
    in_motion=_in_motion,
    drawn=True,
)
