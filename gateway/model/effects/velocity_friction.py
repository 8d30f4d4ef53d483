"""Effect: friction that changes with speed beyond Coulomb and viscous friction; visible only in a moving run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, measured_axes
from gateway.model.motion import Modelled, MovingRows
from gateway.model.term import Named, OnAxis, Seen, Term, on_axis

Floats = NDArray[np.float64]

#: Decay speed of the Stribeck curve divided by the top speed of the axis: from a peak at standstill to half the range.
FRACTIONS: Final = (0.03, 0.06, 0.12, 0.25, 0.5)
#: Smallest share of the samples in which friction dissipates power; fitted friction may be slightly negative if small.
TAKES_POWER: Final = 0.9


@dataclass(frozen=True, slots=True)
class _OverSpeed(OnAxis):
    name: ClassVar[str] = "velocity_friction"
    is_common: ClassVar[bool] = True
    with_friction: ClassVar[bool] = True

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if friction dissipates power at most speeds, including its Coulomb and viscous part."""
        columns = self.columns(seen.motion, seen.modelled)[:, 0]
        power = seen.friction_nm(self.axis, columns, value) * seen.motion.qd_rad_s[:, self.axis]
        return bool((power[seen.motion.judged[:, self.axis]] > 0).mean() > TAKES_POWER)


@dataclass(frozen=True, slots=True)
class Stribeck(_OverSpeed):
    """Stribeck friction `c exp(-|qd|/v) sign(qd)`: a peak near standstill (c > 0) or a law that flattens (c < 0)."""

    decay_rad_s: float
    parameters: ClassVar[tuple[str, ...]] = ("stribeck_nm",)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        speed = np.abs(motion.qd_rad_s[:, self.axis])
        return on_axis(motion.sign[:, self.axis] * np.exp(-speed / self.decay_rad_s))

    @property
    def form(self) -> Named:
        return {"stribeck_velocity_rad_s": self.decay_rad_s}


@dataclass(frozen=True, slots=True)
class RootFriction(_OverSpeed):
    """Square-root friction `c |qd|^(1/2) sign(qd)`."""

    parameters: ClassVar[tuple[str, ...]] = ("root_nm_s05_rad05",)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(motion.sign[:, self.axis] * np.sqrt(np.abs(motion.qd_rad_s[:, self.axis])))


@dataclass(frozen=True, slots=True)
class SquareFriction(_OverSpeed):
    """Quadratic friction `c qd^2 sign(qd)`."""

    parameters: ClassVar[tuple[str, ...]] = ("square_nm_s2_rad2",)

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(motion.sign[:, self.axis] * motion.qd_rad_s[:, self.axis] ** 2)


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    for axis in measured_axes(motion):
        yield from (Stribeck(axis, fraction * float(motion.speed_rad_s[axis])) for fraction in FRACTIONS)
        yield RootFriction(axis)
        yield SquareFriction(axis)


EFFECT: Final = Effect(
    name="velocity_friction",
    words="friction that changes with speed",
    meaning="friction that changes with speed beyond Coulomb and viscous",
    parameters=(
        "coulomb_nm",
        "viscous_nm_s_rad",
        "stribeck_nm",
        "stribeck_velocity_rad_s",
        "root_nm_s05_rad05",
        "square_nm_s2_rad2",
    ),
    over=Over.SPEED,
    in_motion=_in_motion,
    friction=True,
)
