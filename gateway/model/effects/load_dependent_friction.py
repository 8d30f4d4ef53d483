"""Effect: gear losses in proportion to the transmitted torque (Hamon, Gautier, Garrec 2010)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, Over, on_each_axis
from gateway.model.motion import Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.term import OnAxis, on_axis, plus
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadDependentFriction(OnAxis):
    """Gear loss `nu |tau| sign(dir)`."""

    name: ClassVar[str] = "load_dependent_friction"
    takes_over: ClassVar[str] = "load_friction"
    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {"coefficient": (0.0, 0.6)}
    modelled: ClassVar[bool] = True
    is_common: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, load_friction=plus(setting.load_friction, self.axis, theta[0]))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(np.abs(modelled.rigid_nm[:, self.axis]) * motion.sign[:, self.axis])


EFFECT: Final = Effect(
    name="load_dependent_friction",
    words="friction that grows with the transmitted torque",
    meaning="gear losses in proportion to the transmitted torque (at rest: the part that remains after settling)",
    parameters=("coefficient",),
    over=Over.TORQUE_BY_DIRECTION,
    at_rest=on_each_axis(LoadDependentFriction),
    in_motion=on_each_axis(LoadDependentFriction),
    friction=True,
)
