"""Effect: torque ripple, harmonics of motor or wave generator several times per turn of the joint.

With a known gear ratio its first two harmonics are tested. Without it the order is taken from the residual (order
analysis), and the evidence is corrected for the number of tested orders.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, RestSetup, measured_axes
from gateway.model.motion import MovingRows
from gateway.model.term import NAN, AngleTorque, Named, Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Number of ripples to test on each axis of a moving run, the strongest first.
SWINGS: Final = 2
#: Smallest travel of an axis for which ripple is considered [rad].
LEAST_REACH_RAD: Final = 0.2
#: Largest number of ripple periods per turn of the joint.
MOST_PER_REVOLUTION: Final = 600.0
#: Smallest number at rest, where slow ripple resembles any smooth torque: gears of arms reduce by 30 and more.
LEAST_PER_REVOLUTION: Final = 25.0
#: Phase difference [rad] of two neighbouring orders over half the travel of an axis.
ORDER_STEP_RAD: Final = 0.5


@dataclass(frozen=True, slots=True)
class TorqueRipple(AngleTorque):
    """Ripple `a sin(w q) + b cos(w q)` with `w` periods per turn; `orders` is the number of tested orders."""

    per_revolution: float = 100.0
    orders: int = field(default=1, compare=False)
    name: ClassVar[str] = "torque_ripple"
    takes_over: ClassVar[str] = "cogging"
    in_reading: ClassVar[bool] = True
    parameters: ClassVar[tuple[str, ...]] = ("sine_nm", "cosine_nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    @property
    def tries(self) -> int:
        return self.orders

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        angle = self.per_revolution * q_rad[:, self.axis]
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)

    @property
    def form(self) -> Named:
        return {"per_revolution": self.per_revolution}

    def named(self, theta: Floats) -> Named:
        sine, cosine = theta.tolist()
        return {"amplitude_nm": float(np.hypot(sine, cosine)), "phase_rad": float(np.arctan2(cosine, sine))}


def orders_at_rest(q_rad: Floats) -> Floats:
    """Return the orders per turn (k,) to search at joint angles (n,) of one axis; none where it barely moved."""
    reach = float(np.ptp(q_rad))
    if reach < LEAST_REACH_RAD:
        return np.zeros(0)
    return np.arange(LEAST_PER_REVOLUTION, MOST_PER_REVOLUTION, 2.0 * ORDER_STEP_RAD / reach)


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    for axis in measured_axes(rows):
        ratio = abs(setup.gear_ratio[axis])
        if np.isfinite(ratio) and ratio > 0:
            yield TorqueRipple(axis, ratio)
            yield TorqueRipple(axis, 2.0 * ratio)


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    """Return the strongest ripples of each axis' residual over its own angle, as far as the sampling resolves them."""
    for axis in measured_axes(motion):
        rows = motion.judged[:, axis] & ~motion.held_out
        q, rest = motion.q_rad[rows, axis], setup.residual_nm[rows, axis]
        steps = np.abs(np.diff(motion.q_rad[:, axis]))[rows[:-1] & (np.diff(motion.run) == 0)]
        reach = float(np.ptp(q))
        if reach < LEAST_REACH_RAD or not len(steps):
            continue
        fastest = 0.5 * np.pi / max(float(np.quantile(steps, 0.9)), 1e-9)
        waves = np.arange(6.0 * np.pi / reach, min(fastest, MOST_PER_REVOLUTION), 0.5 * np.pi / reach)
        power = np.abs(np.exp(1j * np.outer(waves, q)) @ rest)
        best = np.argsort(power)[::-1][:SWINGS]
        yield from (TorqueRipple(axis, float(waves[peak]), len(waves)) for peak in best)


EFFECT: Final = Effect(
    name="torque_ripple",
    words="torque ripple of motor or gear",
    meaning="motor or wave-generator harmonics",
    parameters=(
        "amplitude_nm",
        "per_revolution",
        "phase_rad",
    ),
    at_rest=_at_rest,
    in_motion=_in_motion,
    by_residual=True,
)
