"""Effect: torque constant or friction drifts with temperature, or with time if no temperature was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, measured_axes
from gateway.model.motion import Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.term import Named, OnAxis, Term, on_axis
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Smallest temperature range [K] of visits, and of a moving run, where friction changes before it settles.
WARMED_AT_REST_K: Final = 0.5
WARMED_IN_MOTION_K: Final = 2.0
#: Shortest run [s] for which a drift is considered.
LONG_S: Final = 60.0
#: Prior standard deviation of the change per kelvin (copper and magnets: about 0.4 % each) and per second.
SPREAD_PER_K: Final = 0.02
SPREAD_PER_S: Final = 3e-4


@dataclass(frozen=True, slots=True)
class ThermalDrift(OnAxis):
    """Drift of the reading (`on` torque) or of the friction of one axis since the first visit, `by` one cause."""

    by: str = "time"
    on: str = "torque"
    name: ClassVar[str] = "thermal_drift"
    parameters: ClassVar[tuple[str, ...]] = ("rate",)
    modelled: ClassVar[bool] = True

    @property
    def spread(self) -> tuple[float, ...]:
        return (SPREAD_PER_K,) if self.by == "temperature" else (SPREAD_PER_S,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        since = self._since(rows)
        field = "gain" if self.on == "torque" else "band_gain"
        values = getattr(setting, field).copy()
        values[:, self.axis] *= 1.0 + theta[0] * since
        return replace(setting, **{field: values})

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        friction = modelled.total_nm[:, self.axis] - modelled.rigid_nm[:, self.axis]
        return on_axis(friction * self._since(motion))

    def _since(self, rows: Visits | MovingRows) -> Floats:
        """Return the temperature rise [K] or time [s] (n,) since the first sample."""
        values = rows.temperature_c[:, self.axis] if self.by == "temperature" else rows.time_s
        return values - values[int(np.argmin(rows.time_s))]

    def named(self, theta: Floats) -> Named:
        return {"per_k" if self.by == "temperature" else "per_s": float(theta[0])}


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    for axis in measured_axes(rows):
        causes = ["temperature"] if _warmed(rows.temperature_c[:, axis], WARMED_AT_REST_K) else []
        causes += ["time"] if np.ptp(rows.time_s) > 0 else []
        yield from (ThermalDrift(axis, cause, on) for cause in causes for on in ("torque", "friction"))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    for axis in measured_axes(motion):
        if _warmed(motion.temperature_c[:, axis], WARMED_IN_MOTION_K):
            yield ThermalDrift(axis, "temperature", "friction")
        elif motion.duration_s >= LONG_S:
            yield ThermalDrift(axis, "time", "friction")


def _warmed(temperature_c: Floats, least_k: float) -> bool:
    return bool(np.isfinite(temperature_c).all() and np.ptp(temperature_c) > least_k)


EFFECT: Final = Effect(
    name="thermal_drift",
    words="drift with temperature or time",
    meaning="torque constant or friction drifts with temperature or time",
    parameters=(
        "per_k",
        "per_s",
    ),
    over=Over.TIME,
    at_rest=_at_rest,
    in_motion=_in_motion,
)
