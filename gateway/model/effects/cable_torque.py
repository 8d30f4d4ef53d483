"""Effect: a dress pack that a wrist axis twists."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, measured_axes, moving_axes
from gateway.model.motion import MovingRows
from gateway.model.term import NAN, Named, PassiveTorque, Seen, Term, propagated, wrist
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Cable(PassiveTorque):
    name: ClassVar[str] = "cable_torque"


@dataclass(frozen=True, slots=True)
class LinearCable(_Cable):
    """Linear cable torque `-k (q - neutral)`, as slope and constant."""

    parameters: ClassVar[tuple[str, ...]] = ("slope_nm_rad", "constant_nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return np.stack([q_rad[:, self.axis], np.ones(len(q_rad))], axis=1)

    def report(self, theta: Floats, covariance: Floats) -> tuple[Named, Named]:
        def named(value: Floats) -> Named:
            slope, constant = float(value[0]), float(value[1])
            return {"stiffness_nm_rad": -slope, "neutral_rad": -constant / slope if slope else NAN}

        return propagated(named, theta, covariance)


@dataclass(frozen=True, slots=True)
class CableSlope(_Cable):
    """Linear cable torque whose constant is part of axis and friction: the neutral angle is not identifiable."""

    parameters: ClassVar[tuple[str, ...]] = ("slope_nm_rad",)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return q_rad[:, [self.axis]]

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if the cable torque acts towards the neutral position."""
        return bool(value[0] < 0)

    def report(self, theta: Floats, covariance: Floats) -> tuple[Named, Named]:
        return {"stiffness_nm_rad": -float(theta[0])}, {"stiffness_nm_rad": float(np.sqrt(covariance[0, 0]))}


@dataclass(frozen=True, slots=True)
class HarmonicCable(_Cable):
    """Sinusoidal cable torque `-k sin(q - neutral)`, as sine and cosine."""

    parameters: ClassVar[tuple[str, ...]] = ("sine_nm", "cosine_nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        q = q_rad[:, self.axis]
        return np.stack([np.sin(q), np.cos(q)], axis=1)

    def report(self, theta: Floats, covariance: Floats) -> tuple[Named, Named]:
        def named(value: Floats) -> Named:
            sine, cosine = float(value[0]), float(value[1])
            return {"stiffness_nm_rad": float(np.hypot(sine, cosine)), "neutral_rad": float(np.arctan2(cosine, -sine))}

        values, std = propagated(named, theta, covariance)
        return values | {"harmonic": 1.0}, std


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    for axis in set(wrist(rows.axes)) & set(measured_axes(rows)):
        yield LinearCable(axis)
        yield HarmonicCable(axis)


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    for axis in set(wrist(motion.axes)) & set(moving_axes(motion)):
        yield CableSlope(axis)
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
    at_rest=_at_rest,
    in_motion=_in_motion,
)
