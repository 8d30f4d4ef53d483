"""Balancers of axis 2: a coil spring or a gas spring between base and link 2."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.reading import AlteredModel, RestRows
from gateway.model.terms.term import Plain, plus

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Balancer(Plain):
    """A spring between base and link 2: torque `F(l) dl/dq2`, shortest at q2 = phase.

    Lever a and anchor b enter as `ratio = 2 a b / (a^2 + b^2)`, fitted as its logit; in units of sqrt(a^2 + b^2) the
    length is `l = sqrt(1 - ratio cos(q2 - phase))`. Torque alone gives k a b and not k, so stiffness is reported for
    `sqrt(a^2 + b^2) = reach_m`.
    """

    ratio: float = 0.6
    phase_rad: float = 0.0
    largest_nm: float = 1.0
    name: ClassVar[str] = "balancer_spring"
    REACH_M: ClassVar[float] = 1.0

    @property
    def joints(self) -> tuple[int, ...]:
        return (2,)

    def geometry(self, theta: Floats, rows: RestRows) -> tuple[Floats, Floats, float]:
        """Angle, length (n,) and ratio for the last two or three parameters."""
        angle = rows.q_rad[:, 1] - theta[0]
        ratio = float(1.0 / (1.0 + np.exp(-np.clip(theta[1], -5.0, 5.0))))
        return angle, np.sqrt(1.0 - ratio * np.cos(angle)), ratio

    def _with(self, setting: AlteredModel, torque: Floats) -> AlteredModel:
        return replace(setting, passive_nm=plus(setting.passive_nm, (slice(None), 1), torque))

    @property
    def _logit(self) -> float:
        return float(np.log(self.ratio / (1.0 - self.ratio)))

    def _shape(self, theta: Floats, std: Floats) -> tuple[dict[str, float], dict[str, float]]:
        ratio = float(1.0 / (1.0 + np.exp(-theta[1])))
        values = {"phase_rad": float(theta[0]), "lever_ratio": ratio, "reach_m": self.REACH_M}
        return values, {"phase_rad": float(std[0]), "lever_ratio": float(std[1]) * ratio * (1.0 - ratio)}


@dataclass(frozen=True, slots=True)
class CoilBalancer(_Balancer):
    """Coil spring: force `k (l - l0)`."""

    parameters: ClassVar[tuple[str, ...]] = ("stiffness_n_m", "preload_nm", "phase_rad", "lever_ratio")
    units: ClassVar[tuple[str, ...]] = ("N/m", "Nm", "rad", "1")
    linear: ClassVar[tuple[bool, ...]] = (True, True, False, False)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, 0.0, self.phase_rad, self._logit)

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.5 * self.largest_nm, 0.5 * self.largest_nm, 0.4, 0.8)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        angle, length, _ = self.geometry(theta[2:], rows)
        return self._with(setting, -np.sin(angle) * (theta[0] + theta[1] / length))

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        """The spring is under tension wherever the arm was, and pulls harder the longer it is."""
        _, length, _ = self.geometry(theta[2:], rows)
        force = theta[0] * length + theta[1]
        return bool(theta[0] > 0 and (force > -0.1 * np.abs(force).max()).all())

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        values, errors = self._shape(theta[2:], std[2:])
        unit = 2.0 / (values["lever_ratio"] * self.REACH_M**2)
        first = {"stiffness_n_m": float(theta[0]) * unit, "preload_nm": float(theta[1])}
        return first | values, {"stiffness_n_m": float(std[0]) * unit, "preload_nm": float(std[1])} | errors


@dataclass(frozen=True, slots=True)
class GasBalancer(_Balancer):
    """Gas spring: a column of gas that the pull shortens, `force = F0 (1 - x / column)^-1.3`."""

    stroke: float = 0.5
    parameters: ClassVar[tuple[str, ...]] = ("stiffness_n_m", "phase_rad", "lever_ratio", "gas_stroke")
    units: ClassVar[tuple[str, ...]] = ("N/m", "rad", "1", "1")
    linear: ClassVar[tuple[bool, ...]] = (True, False, False, False)
    POLYTROPIC: ClassVar[float] = 1.3

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, self.phase_rad, self._logit, float(np.log(self.stroke / (1.0 - self.stroke))))

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.5 * self.largest_nm, 0.4, 0.8, 0.8)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        angle, length, ratio = self.geometry(theta[1:], rows)
        shortest, longest = np.sqrt(1.0 - ratio), np.sqrt(1.0 + ratio)
        stroke = 1.0 / (1.0 + np.exp(-np.clip(theta[3], -5.0, 3.0)))
        pressed = (1.0 - stroke * (length - shortest) / (longest - shortest)) ** -self.POLYTROPIC
        return self._with(setting, -np.sin(angle) * theta[0] * pressed / length)

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return bool(theta[0] > 0)

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        """Stiffness at the shortest length; `gas_stroke` = full stroke of the rod over the length of the gas column."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        values, errors = self._shape(theta[1:], std[1:])
        ratio = values["lever_ratio"]
        stroke = float(1.0 / (1.0 + np.exp(-theta[3])))
        slope = self.POLYTROPIC * stroke / (np.sqrt(1.0 + ratio) - np.sqrt(1.0 - ratio))
        unit = float(2.0 / (ratio * self.REACH_M**2) * slope)
        first = {"stiffness_n_m": float(theta[0]) * unit, "gas_stroke": stroke}
        return first | values, {"stiffness_n_m": float(std[0]) * unit} | errors
