"""Sweeps: one joint moves at constant speeds, each in both directions over the same stroke, for its friction curve.

A sweep is chosen by posture and speeds at which the joint has enough travel for constant speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.errors import PlanRefused
from gateway.excite.excitation import Kind
from gateway.excite.limits import MovingLimits, States, states_of
from gateway.motion.trajectory import Motion, MotionLimits, straight, straight_duration_s
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

#: Speeds, as shares of the speed that is planned with: slow ones show a Stribeck curve, fast ones viscous friction.
SPEED_SHARES = np.array([0.02, 0.05, 0.1, 0.25, 0.5, 1.0])
#: Duration of each constant speed [s]; least duration of the fastest one where the travel is short.
STEADY_S, LEAST_STEADY_S = 2.0, 0.3
#: Acceleration, as a share of the planned limit: friction depends on the speed.
ACCELERATION_SHARE = 0.7
#: Step at which the travel of a joint is checked [rad].
_STEP_RAD = 0.02
#: Factor on speed and acceleration, and number of tries, where a limit of torque or load is exceeded.
_SOFTER, _TRIES = 0.8, 10
#: Sampling of what is checked [s].
_CHECKED_S = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Motion of one joint to the end of a stroke and back, once at each speed; all others are at rest.

    Attributes
    ----------
    name : str
    joint : int
        From 1.
    start_rad : array of shape (N,)
    speeds_rad_s : array of shape (s,)
    ends_rad : array of shape (s,)
        Turning point of the joint at each speed.
    acceleration_rad_s2, jerk_rad_s3 : float
        Limits of the joint between rest and each speed.
    periods : int
    """

    name: str
    joint: int
    start_rad: Floats
    speeds_rad_s: Floats
    ends_rad: Floats
    acceleration_rad_s2: float
    jerk_rad_s3: float
    periods: int

    @property
    def kind(self) -> Kind:
        """Kind of the excitation, `sweep`."""
        return "sweep"

    @property
    def period_s(self) -> float:
        """Duration of all strokes, in both directions."""
        return sum(straight_duration_s(*stroke) for stroke in self._strokes())

    def motion(self, sync_period_s: float) -> Motion:
        """Return the setpoints of one period; each stroke is a whole number of SYNCs."""
        parts = [straight(*stroke, sync_period_s) for stroke in self._strokes()]
        q, qd, qdd = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("q_rad", "qd_rad_s", "qdd_rad_s2")
        )
        return Motion(q, qd, qdd, sync_period_s)

    def _strokes(self) -> Iterator[tuple[Floats, Floats, MotionLimits]]:
        """Return start, end and limits of every stroke."""
        everywhere = np.ones(len(self.start_rad))
        for speed, end in zip(self.speeds_rad_s, self.ends_rad, strict=True):
            limits = MotionLimits(
                speed * everywhere, self.acceleration_rad_s2 * everywhere, self.jerk_rad_s3 * everywhere
            )
            there = self.start_rad.copy()
            there[self.joint - 1] = end
            yield self.start_rad, there, limits
            yield there, self.start_rad, limits

    def plain(self) -> dict[str, Any]:
        """Return plain values for a recording or a plan file."""
        return {"kind": self.kind, **plain_values(self)}


def chosen_sweeps(limits: MovingLimits, postures_rad: Sequence[Floats], periods: int) -> tuple[Sweep, ...]:
    """Return a sweep of every joint, each at the first of some postures (N,) with the largest travel.

    Raises
    ------
    PlanRefused
        A joint has too little travel.
    """
    return tuple(_sweep_of(limits, postures_rad, joint, periods) for joint in range(len(limits.speed_rad_s)))


def _sweep_of(limits: MovingLimits, postures_rad: Sequence[Floats], joint: int, periods: int) -> Sweep:
    wanted = _stroke_rad(limits, joint, (1.0, 1.0), STEADY_S)
    best: tuple[float, Floats, float] | None = None
    for q_rad in postures_rad:
        span = _travel(limits, q_rad, joint)
        if span is None:
            continue
        width = min(span[1] - span[0], wanted)
        if best is None or width > best[0] + _STEP_RAD:
            start = q_rad.copy()
            start[joint] = max(span[0], min(q_rad[joint] - width / 2, span[1] - width))
            best = width, start, width
        if width >= wanted:
            break
    if best is not None:
        sweep = _within(limits, best[1], joint, best[2], periods)
        if sweep is not None:
            return sweep
    raise PlanRefused(
        f"joint {joint + 1} has too little travel for a constant speed from any tested posture: widen its"
        " position_limit_rad, or correct the assumed surroundings in the cell file (floor_m, wall, column_radius_m, "
        "link_radius_m, load_size_m)"
    )


def _stroke_rad(limits: MovingLimits, joint: int, shares: tuple[float, float], steady_s: float) -> float:
    """Return the stroke that holds a speed for a given time: two jerk-limited ramps and the constant part.

    `shares` of the speed limit, and of the limits of the ramps.
    """
    speed, softer = shares[0] * limits.speed_rad_s[joint], shares[1]
    acceleration = softer * ACCELERATION_SHARE * limits.acceleration_rad_s2[joint]
    ramp_s = speed / acceleration + acceleration / (softer * limits.jerk_rad_s3[joint])
    return float(speed * (steady_s + ramp_s))


def _travel(limits: MovingLimits, q_rad: Floats, joint: int) -> tuple[float, float] | None:
    """Return the travel (lowest, highest) of a joint from a posture (N,) while the others rest; None = no travel."""
    low, high = limits.middle_rad[joint] - limits.half_rad[joint], limits.middle_rad[joint] + limits.half_rad[joint]
    count = max(int(np.ceil((high - low) / _STEP_RAD)), 2)
    turned = np.tile(q_rad, (count, 1))
    turned[:, joint] = np.linspace(low, high, count)
    still = np.zeros_like(turned)
    workspace = limits.workspace
    good = limits.shares(States(turned, still, still, still)).max(axis=1) <= 1.0 + 1e-9
    good &= workspace.feasible(turned, torque_share=workspace.rest_share)
    at = int(np.argmin(np.abs(turned[:, joint] - q_rad[joint])))
    if not good[at]:
        return None
    bad = np.flatnonzero(~good)
    first, last = bad[bad < at].max(initial=-1) + 1, bad[bad > at].min(initial=count) - 1
    return float(turned[first, joint]), float(turned[last, joint])


def _within(limits: MovingLimits, start_rad: Floats, joint: int, width_rad: float, periods: int) -> Sweep | None:
    """Return the fastest sweep that travel, torque and load allow; None = none is possible."""
    softer = 1.0
    for _ in range(_TRIES):
        if _stroke_rad(limits, joint, (softer, softer), LEAST_STEADY_S) <= width_rad:
            sweep = _with_speeds(limits, start_rad, joint, (width_rad, softer), periods)
            states = states_of(sweep, _CHECKED_S)
            path = np.vstack([start_rad, states.q_rad])
            inside = limits.shares(states).max() <= 1.0 + 1e-6
            if inside and limits.workspace.refused_on(path[:: max(len(path) // 500, 1)]) is None:
                return sweep
        softer *= _SOFTER
    return None


def _with_speeds(
    limits: MovingLimits, start_rad: Floats, joint: int, ranges: tuple[float, float], periods: int
) -> Sweep:
    """Return a sweep within a width and with reduced limits: `ranges` is (width, share of the limits)."""
    width_rad, softer = ranges
    shares = SPEED_SHARES * softer
    strokes = np.array([min(_stroke_rad(limits, joint, (share, softer), STEADY_S), width_rad) for share in shares])
    return Sweep(
        name=f"friction J{joint + 1}",
        joint=joint + 1,
        start_rad=start_rad,
        speeds_rad_s=shares * limits.speed_rad_s[joint],
        ends_rad=start_rad[joint] + strokes,
        acceleration_rad_s2=float(softer * ACCELERATION_SHARE * limits.acceleration_rad_s2[joint]),
        jerk_rad_s3=float(softer * limits.jerk_rad_s3[joint]),
        periods=periods,
    )
