"""Effect: the load moves or leaks during the run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, Over, RestSetup
from gateway.model.motion import PER_BODY, Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.term import Named, Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Smallest number of visits under a load before and after a jump.
FEWEST_BEFORE: Final = 2
#: Prior standard deviation of a shift [m]: a sack that slides in its gripper.
SPREAD_M: Final = 0.2


@dataclass(frozen=True, slots=True)
class PayloadShift(Term):
    """Shift of the load's centre of gravity: a jump at `time_s`, or a drift until `until_s`; of one `load`, or all."""

    time_s: float
    until_s: float | None = None
    load: str = ""
    name: ClassVar[str] = "payload_shift"
    parameters: ClassVar[tuple[str, ...]] = ("shift_x_m", "shift_y_m", "shift_z_m")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (SPREAD_M,) * 3
    modelled: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, moment_factor=setting.moment_factor + self._moved(rows.time_s)[:, None] * theta)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        here = modelled.load_kg * (motion.load == self.load) * self._moved(motion.time_s)
        return motion.rigid[:, :, -PER_BODY + 1 : -PER_BODY + 4] * here[:, None, None]

    def switched(self) -> tuple[Term, float] | None:
        return (replace(self, time_s=-np.inf), self.time_s) if self.until_s is None else None

    def _moved(self, time_s: Floats) -> Floats:
        """Return the completed share (n,) of the shift."""
        after = np.where(time_s >= self.time_s - 1e-9, 1.0, 0.0)
        if self.until_s is None:
            return after
        return after * (time_s - self.time_s) / max(self.until_s - self.time_s, 1e-9)

    @property
    def form(self) -> Named:
        return {"time_s": self.time_s}

    def named(self, theta: Floats) -> Named:
        return {"shift_m": float(np.linalg.norm(theta))} | Term.named(self, theta)


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    """Return jumps between the visits of the loads, and a drift over all visits."""
    loaded = rows.load != "none"
    times = np.unique(rows.time_s[loaded])
    if len(times) < 2 * FEWEST_BEFORE or len(times) != loaded.sum():
        return
    yield from (PayloadShift(float(when)) for when in times[FEWEST_BEFORE:-1])
    yield PayloadShift(float(times[0]), float(times[-1]))


EFFECT: Final = Effect(
    name="payload_shift",
    words="a load that shifted during the run",
    meaning="the load moves or leaks during the run",
    parameters=(
        "shift_m",
        "shift_x_m",
        "shift_y_m",
        "shift_z_m",
        "time_s",
    ),
    over=Over.TIME,
    at_rest=_at_rest,
    # a drift over the run
    in_motion=lambda motion, setup: (PayloadShift(0.0, motion.duration_s, load) for load in setup.loads),
    drawn=True,
)
