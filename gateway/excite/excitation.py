"""Excitation trajectories: periodic motions that begin and end at rest in the same posture."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.motion.trajectory import Motion
from gateway.result.values import plain_values

Floats = NDArray[np.float64]
Kind = Literal["series", "sweep"]


class Excitation(Protocol):
    """Excitation trajectory of one arm with N axes."""

    @property
    def name(self) -> str:
        """Name, such as `load` or `friction J2`."""
        ...

    @property
    def kind(self) -> Kind:
        """`series`: all joints at once; `sweep`: constant speeds of one joint."""
        ...

    @property
    def joint(self) -> int:
        """Joint that a sweep moves, from 1; 0 = all."""
        ...

    @property
    def start_rad(self) -> Floats:
        """Posture (N,) in which each period begins and ends at rest."""
        ...

    @property
    def period_s(self) -> float:
        """Duration of one period at full speed."""
        ...

    @property
    def periods(self) -> int:
        """Number of periods."""
        ...

    def motion(self, sync_period_s: float) -> Motion:
        """Setpoints of one period, one sample per SYNC, from rest at `start_rad` to rest there."""
        ...

    def plain(self) -> dict[str, Any]:
        """Plain values, as in a recording and a plan file."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Finite Fourier series of every joint about a centre, at rest at the start and end of a period.

    q_i(t) = c_i + sum_k a_ik (cos(k w t) - 1) + b_ik sin(k w t), w = 2 pi / period_s.

    So q(0) = c. Speed and acceleration are zero there: sum_k k b_ik = 0 and sum_k k^2 a_ik = 0. Swevers et al. (1997)
    use a window instead of these conditions.

    Attributes
    ----------
    name : str
    start_rad : array of shape (N,)
    cosine_rad, sine_rad : arrays of shape (N, H)
        a and b.
    period_s : float
    periods : int
    """

    name: str
    start_rad: Floats
    cosine_rad: Floats
    sine_rad: Floats
    period_s: float
    periods: int

    @property
    def kind(self) -> Kind:
        """Kind of the excitation, `series`."""
        return "series"

    @property
    def joint(self) -> int:
        """Joint number 0: all joints."""
        return 0

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return positions, speeds, accelerations and jerks, arrays of shape (n, N), at times (n,)."""
        order = np.arange(1, self.cosine_rad.shape[1] + 1)
        rate = 2.0 * np.pi * order / self.period_s
        angle = np.asarray(time_s, dtype=float)[:, None] * rate
        cosine, sine = np.cos(angle), np.sin(angle)
        a, b = self.cosine_rad.T, self.sine_rad.T
        return (
            self.start_rad + (cosine - 1.0) @ a + sine @ b,
            -(sine * rate) @ a + (cosine * rate) @ b,
            -(cosine * rate**2) @ a - (sine * rate**2) @ b,
            (sine * rate**3) @ a - (cosine * rate**3) @ b,
        )

    def motion(self, sync_period_s: float) -> Motion:
        """Return the setpoints of one period, a whole number of SYNCs (rounded up)."""
        count = max(1, int(np.ceil(self.period_s / sync_period_s - 1e-9)))
        share = np.arange(1, count + 1) / count
        q, qd, qdd, _ = self.at(share * self.period_s)
        slower = self.period_s / (count * sync_period_s)
        qd, qdd = slower * qd, slower**2 * qdd
        q[-1], qd[-1], qdd[-1] = self.start_rad, 0.0, 0.0
        return Motion(q, qd, qdd, sync_period_s)

    def plain(self) -> dict[str, Any]:
        """Return plain values for a recording or a plan file."""
        return {"kind": self.kind, **plain_values(self)}


@dataclass(frozen=True, slots=True, eq=False)
class MovingPlan:
    """Excitations of one arm, in order.

    Attributes
    ----------
    arm : str
    excitations : tuple of Excitation
    expected : dict
        Expected standard deviations of `plan --moving`; plain values, for files and pages.
    """

    arm: str
    excitations: tuple[Excitation, ...]
    expected: dict[str, Any]


def fingerprint(excitation: Excitation) -> int:
    """Return a checksum of the motion, without its name and number of periods."""
    shape = {key: value for key, value in excitation.plain().items() if key not in ("name", "periods")}
    return zlib.crc32(json.dumps(shape, sort_keys=True).encode())
