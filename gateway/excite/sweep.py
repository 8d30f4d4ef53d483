"""Sweeps: one joint moves at constant speeds, each in both directions over the same stroke, for its friction curve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.excite.excitation import Kind
from gateway.motion.trajectory import Motion, MotionLimits, straight, straight_duration_s
from gateway.result.values import plain_values

Floats = NDArray[np.float64]


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
