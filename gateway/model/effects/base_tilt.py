"""Effect: the base is tilted, so that gravity is rotated by two angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect
from gateway.model.motion import Modelled, MovingRows, changed_torque
from gateway.model.rest import AlteredModel
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BaseTilt(Term):
    """Rotation vector (x, y) of the base; to first order in motion."""

    name: ClassVar[str] = "base_tilt"
    parameters: ClassVar[tuple[str, ...]] = ("tilt_x_rad", "tilt_y_rad")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1, 0.1)
    #: Largest tilt of an arm that is stated as level: 11 degrees.
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {"tilt_x_rad": (-0.2, 0.2), "tilt_y_rad": (-0.2, 0.2)}
    modelled: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, tilt_rad=setting.tilt_rad + theta)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        parts = [changed_torque(motion.by_tilt(direction), modelled) for direction in (0, 1)]
        return np.stack(parts, axis=2)


EFFECT: Final = Effect(
    name="base_tilt",
    words="a tilted base",
    meaning="the base is not level",
    parameters=(
        "tilt_x_rad",
        "tilt_y_rad",
    ),
    at_rest=lambda rows, setup: [BaseTilt()],
    in_motion=lambda motion, setup: [BaseTilt()],
    drawn=True,
)
