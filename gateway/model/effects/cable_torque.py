"""Effect: a dress pack that a wrist axis twists."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, Over, measured_axes
from gateway.model.motion import MovingRows
from gateway.model.term import NAN, AngleTorque, Named, Seen, Term, wrist
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Cable(AngleTorque):
    name: ClassVar[str] = "cable_torque"


@dataclass(frozen=True, slots=True)
class LinearCable(_Cable):
    """Linear cable torque `-k (q - neutral)`, as slope and constant."""

    parameters: ClassVar[tuple[str, ...]] = ("slope_nm_rad", "constant_nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return np.stack([q_rad[:, self.axis], np.ones(len(q_rad))], axis=1)

    def named(self, theta: Floats) -> Named:
        slope, constant = theta.tolist()
        return {"stiffness_nm_rad": -slope, "neutral_rad": -constant / slope if slope else NAN}


@dataclass(frozen=True, slots=True)
class CableSlope(_Cable):
    """Linear cable torque whose constant is part of axis and friction: the neutral angle is not identifiable."""

    parameters: ClassVar[tuple[str, ...]] = ("slope_nm_rad",)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return q_rad[:, [self.axis]]

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if the cable torque acts towards the neutral position."""
        return bool(value[0] < 0)

    def named(self, theta: Floats) -> Named:
        return {"stiffness_nm_rad": -float(theta[0])}


@dataclass(frozen=True, slots=True)
class HarmonicCable(_Cable):
    """Sinusoidal cable torque `-k sin(q - neutral)`, as sine and cosine."""

    parameters: ClassVar[tuple[str, ...]] = ("sine_nm", "cosine_nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        q = q_rad[:, self.axis]
        return np.stack([np.sin(q), np.cos(q)], axis=1)

    @property
    def form(self) -> Named:
        return {"harmonic": 1.0}

    def named(self, theta: Floats) -> Named:
        sine, cosine = theta.tolist()
        return {"stiffness_nm_rad": float(np.hypot(sine, cosine)), "neutral_rad": float(np.arctan2(cosine, -sine))}


def _on_wrist(rows: Visits | MovingRows, linear: Callable[[int], Term]) -> Iterator[Term]:
    for axis in set(wrist(rows.axes)) & set(measured_axes(rows)):
        yield linear(axis)
        yield HarmonicCable(axis)


EFFECT: Final = Effect(
    name="cable_torque",
    words="torque from a cable or dress pack",
    meaning="the dress pack pulls on a wrist axis",
    parameters=(
        "stiffness_nm_rad",
        "neutral_rad",
        "harmonic",
    ),
    over=Over.ANGLE,
    at_rest=lambda rows, setup: _on_wrist(rows, LinearCable),
    in_motion=lambda motion, setup: _on_wrist(motion, CableSlope),
)
