"""Effect: a stored torque constant is wrong, so that all torque of an axis is scaled."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, Over, RestSetup, measured_axes, on_each_axis
from gateway.model.motion import Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.term import Named, Term, on_axis
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TorqueConstantScale(Term):
    """Ratio of true to stored torque constant (`scale`), of one axis or (`axis` None) of all."""

    axis: int | None = None
    name: ClassVar[str] = "torque_constant_scale"
    takes_over: ClassVar[str] = "gain"
    parameters: ClassVar[tuple[str, ...]] = ("scale",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)
    #: Largest scale; beyond it the drive model or the gear ratio must be wrong.
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {"scale": (0.4, 2.5)}
    modelled: ClassVar[bool] = True
    scales_reading: ClassVar[bool] = True

    @property
    def joints(self) -> tuple[int, ...]:
        return () if self.axis is None else (self.axis + 1,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        gain = setting.gain.copy()
        gain[:, slice(None) if self.axis is None else self.axis] *= 1.0 + theta[0]
        return replace(setting, gain=gain)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(modelled.rigid_nm[:, self.axis])

    def named(self, theta: Floats) -> Named:
        return {"scale": 1.0 / (1.0 + float(theta[0]))}


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    yield from map(TorqueConstantScale, measured_axes(rows))
    if setup.common_scale:
        yield TorqueConstantScale(None)


EFFECT: Final = Effect(
    name="torque_constant_scale",
    words="a wrong torque constant",
    meaning="a stored torque constant is wrong (common to all axes: identifiable only with a known mass)",
    parameters=("scale",),
    over=Over.TORQUE,
    at_rest=_at_rest,
    in_motion=on_each_axis(TorqueConstantScale),
    drawn=True,
)
