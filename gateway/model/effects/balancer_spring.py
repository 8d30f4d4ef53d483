"""Effect: a coil or gas balancer between base and link 2 that the model does not contain.

It is attached to link 2 at distance `lever` from axis 2 and to the base at distance `anchor`, and is shortest at q2 =
phase. In units of its reach `R = sqrt(lever^2 + anchor^2)` the length is `l = sqrt(1 - ratio cos(q2 - phase))` with
`ratio = 2 lever anchor / R^2`. The torque on link 2 is `-F(l) lever anchor sin(q2 - phase) / (R l)`.

The torque determines stiffness times lever times anchor only. The stiffness is stated for a balancer with reach
`REACH_M`. For another reach it is multiplied by (REACH_M / reach)^2.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, largest_torque_nm
from gateway.model.motion import MovingRows
from gateway.model.term import NAN, AngleTorque, Named, Seen, Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Reach of a lever of 0.2 m with an anchor 0.7 m from the axis [m], as on arms for about 150 kg.
REACH_M: Final = 0.728
#: Free length of a coil divided by its reach in the search: an unloaded coil is not longer than between its ends.
USUAL_FREE: Final = 0.5
#: Smallest share of the gravity torque on axis 2 that a balancer compensates (RMS divided by RMS).
SMALLEST: Final = 0.15
#: Largest correlation of a balancer with the gravity torque if it does not oppose it.
LARGEST_CORRELATION: Final = 0.5
#: Exponent of the gas law: between isothermal (1) and adiabatic (1.4 of nitrogen).
POLYTROPIC: Final = 1.3
#: Forms to test: ratio, phase [rad], stroke of the rod divided by the length of the gas column.
RATIOS: Final = (0.35, 0.7, 0.9)
PHASES_RAD: Final = tuple(float(value) for value in np.arange(-6, 6) * np.pi / 6)
STROKES: Final = (0.35, 0.7)
#: Ratio of a balancer of 0.2 m and 0.7 m, from which a moving run starts.
USUAL_RATIO: Final = 0.53
#: Prior standard deviations of the form: phase [rad], ratio and stroke as logit, free length divided by reach.
PHASE_SPREAD_RAD: Final = 0.4
RATIO_SPREAD: Final = 0.8
STROKE_SPREAD: Final = 0.8
FREE_SPREAD: Final = 0.25


@dataclass(frozen=True, slots=True)
class _Balancer(AngleTorque):
    """Balancer spring, shortest at q2 = phase."""

    axis: int = 1
    ratio: float = USUAL_RATIO
    phase_rad: float = 0.0
    largest_nm: float = 1.0
    name: ClassVar[str] = "balancer_spring"
    is_common: ClassVar[bool] = True

    @property
    def form(self) -> Named:
        return {"reach_m": REACH_M}

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if the balancer compensates a substantial share of the gravity torque of its axis."""
        push = self.columns(seen.motion, seen.modelled)[:, 0] @ value
        still = seen.drawn_nm[:, self.axis]
        if not still.any():
            still = seen.modelled.rigid_nm[:, self.axis]
        large = np.sqrt(np.mean(push**2)) > SMALLEST * np.sqrt(np.mean(still**2))
        return bool(large and (push @ still < 0.0 or abs(np.corrcoef(push, still)[0, 1]) < LARGEST_CORRELATION))

    def lengths(self, q_rad: Floats, fixed: Floats) -> tuple[Floats, Floats, float]:
        """Return the angle from the shortest position, length divided by reach (n,), and ratio."""
        angle = q_rad[:, self.axis] - fixed[0]
        ratio = _share(fixed[1])
        return angle, np.sqrt(1.0 - ratio * np.cos(angle)), ratio


@dataclass(frozen=True, slots=True)
class HarmonicBalancer(_Balancer):
    """First-order balancer, `-a sin(q2 - phase)`; lever and free length are not identifiable."""

    parameters: ClassVar[tuple[str, ...]] = ("cosine_nm", "sine_nm", "ratio_logit", "free_share")
    linear: ClassVar[tuple[bool, ...]] = (True, True, False, False)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN, RATIO_SPREAD, FREE_SPREAD)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, 0.0, _logit(self.ratio), USUAL_FREE)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        q = q_rad[:, self.axis]
        return np.stack([np.cos(q), np.sin(q)], axis=1)

    def named(self, theta: Floats) -> Named:
        amplitude, ratio = float(np.hypot(theta[0], theta[1])), _share(theta[2])
        return {
            "stiffness_n_m": amplitude * 2.0 / (ratio * REACH_M**2 * (1.0 - float(theta[3]))),
            "amplitude_nm": amplitude,
            "phase_rad": float(np.arctan2(theta[0], -theta[1])),
        }


@dataclass(frozen=True, slots=True)
class CoilBalancer(_Balancer):
    """Coil spring with force `k (l - free)`, as a coil of the usual free length and the deviation from it."""

    parameters: ClassVar[tuple[str, ...]] = ("usual_nm", "beyond_nm", "phase_rad", "ratio_logit")
    linear: ClassVar[tuple[bool, ...]] = (True, True, False, False)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, 0.0, self.phase_rad, _logit(self.ratio))

    @property
    def spread(self) -> tuple[float, ...]:
        # a coil as strong as gravity pulls 2.5 times its torque at full lever; half its free length is open
        return (2.5 * self.largest_nm, self.largest_nm, PHASE_SPREAD_RAD, RATIO_SPREAD)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        angle, length, _ = self.lengths(q_rad, fixed)
        return -np.sin(angle)[:, None] * np.stack([1.0 - USUAL_FREE / length, 1.0 / length], axis=1)

    def shaped(self, values: Floats) -> Self:
        return replace(self, phase_rad=float(values[0]), ratio=_share(values[1]))

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if the balancer is possible and the spring force increases with length."""
        return bool(value[0] > 0) and _Balancer.possible(self, value, std, seen)

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        """Return True if the spring is under tension in all postures and its force increases with length."""
        _, length, _ = self.lengths(rows.q_rad, theta[2:])
        force = theta[0] * (length - USUAL_FREE) + theta[1]
        return bool(theta[0] > 0 and (force > -0.1 * np.abs(force).max()).all())

    def named(self, theta: Floats) -> Named:
        strength, ratio = float(theta[0]), _share(theta[3])
        free = USUAL_FREE - float(theta[1]) / strength if strength else np.nan
        return {
            "stiffness_n_m": strength * 2.0 / (ratio * REACH_M**2),
            "free_length_m": free * REACH_M,
            "phase_rad": float(theta[2]),
            "lever_ratio": ratio,
        }


@dataclass(frozen=True, slots=True)
class GasBalancer(_Balancer):
    """Gas spring: a gas column compressed by the pull, `force = F0 (1 - x / column)^-1.3`."""

    stroke: float = 0.5
    parameters: ClassVar[tuple[str, ...]] = ("force_nm", "phase_rad", "ratio_logit", "stroke_logit")
    linear: ClassVar[tuple[bool, ...]] = (True, False, False, False)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, self.phase_rad, _logit(self.ratio), _logit(self.stroke))

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.5 * self.largest_nm, PHASE_SPREAD_RAD, RATIO_SPREAD, STROKE_SPREAD)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        angle, length, ratio = self.lengths(q_rad, fixed)
        shortest, longest = np.sqrt(1.0 - ratio), np.sqrt(1.0 + ratio)
        pressed = (1.0 - _stroke(fixed[2]) * (length - shortest) / (longest - shortest)) ** -POLYTROPIC
        return (-np.sin(angle) * pressed / length)[:, None]

    def shaped(self, values: Floats) -> Self:
        return replace(self, phase_rad=float(values[0]), ratio=_share(values[1]), stroke=_stroke(values[2]))

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if the balancer is possible and the gas pressure is positive."""
        return bool(value[0] > 0) and _Balancer.possible(self, value, std, seen)

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        return bool(theta[0] > 0)

    def named(self, theta: Floats) -> Named:
        """Return the stiffness at the shortest length, and `gas_stroke` = rod stroke / gas column length."""
        ratio, stroke = _share(theta[2]), _stroke(theta[3])
        slope = POLYTROPIC * stroke / (np.sqrt(1.0 + ratio) - np.sqrt(1.0 - ratio))
        return {
            "stiffness_n_m": float(theta[0] * slope) * 2.0 / (ratio * REACH_M**2),
            "phase_rad": float(theta[1]),
            "lever_ratio": ratio,
            "gas_stroke": stroke,
        }


def _share(logit: float) -> float:
    """Return a share from its logit, limited to values between 0 and 1."""
    return float(1.0 / (1.0 + np.exp(-np.clip(logit, -5.0, 5.0))))


def _stroke(logit: float) -> float:
    """Return the rod stroke, limited below the length of the gas column."""
    return _share(min(float(logit), 3.0))


def _logit(share: float) -> float:
    return float(np.log(share / (1.0 - share)))


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    if rows.axes < 2 or not np.isfinite(rows.sum_nm[:, 1]).any():
        return
    missed = np.nan_to_num(np.abs(rows.sum_nm - setup.torque_nm)).max(axis=0)
    size = float(max(largest_torque_nm(setup)[1], 4.0 * missed[1]))
    yield from _forms(RATIOS, size)


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    if motion.axes < 2 or not motion.measured[1]:
        return
    size = float(np.abs(motion.tau_nm[motion.judged[:, 1], 1]).max())
    yield HarmonicBalancer()
    yield from _forms((USUAL_RATIO,), size)


def _forms(ratios: Iterable[float], size_nm: float) -> Iterator[Term]:
    for ratio, phase in itertools.product(ratios, PHASES_RAD):
        yield CoilBalancer(1, ratio, phase, size_nm)
        yield from (GasBalancer(1, ratio, phase, size_nm, stroke) for stroke in STROKES)


EFFECT: Final = Effect(
    name="balancer_spring",
    words="a balancer spring",
    meaning="a coil or gas balancer on axis 2 that the model does not have",
    parameters=(
        "stiffness_n_m",
        "phase_rad",
        "reach_m",
        "free_length_m",
        "lever_ratio",
        "gas_stroke",
        "amplitude_nm",
    ),
    over=Over.ANGLE,
    at_rest=_at_rest,
    in_motion=_in_motion,
    drawn=True,
    parameter_texts={
        "stiffness_n_m": "stiffness of the spring, if it has the reach below",
        "reach_m": "reach it is stated for: √(a² + b²), a and b the distances of its ends on link and base from axis 2",
        "lever_ratio": "2 a b / (a² + b²) of these distances",
        "phase_rad": "angle of axis 2 at which the spring is shortest",
        "free_length_m": "length of the unloaded spring, if it has that reach",
        "gas_stroke": "full stroke of the rod divided by the length of the gas column",
        "amplitude_nm": "largest torque on axis 2",
    },
)
