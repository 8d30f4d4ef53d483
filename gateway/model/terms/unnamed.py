"""Structure that no effect of the library explains: smooth shapes that a residual may have, without a cause.

They are rivals of the named effects: where one of them beats every effect, something is there that has no name here,
and that is what is said.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.reading import AlteredModel, RestRows
from gateway.model.terms.term import OnAxis

Floats = NDArray[np.float64]
NAN = float("nan")


@dataclass(frozen=True, slots=True)
class _Unnamed(OnAxis):
    name: ClassVar[str] = "unnamed"


@dataclass(frozen=True, slots=True)
class PositionTorque(_Unnamed):
    """A torque on one axis that depends on the angle of one joint: three harmonics."""

    joint: int = 0
    linear: ClassVar[tuple[bool, ...]] = (True,) * 6
    parameters: ClassVar[tuple[str, ...]] = tuple(f"{part}{k}_nm" for k in (1, 2, 3) for part in ("cosine", "sine"))
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 6

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        q = rows.q_rad[:, self.joint]
        torque = sum(theta[2 * k] * np.cos((k + 1) * q) + theta[2 * k + 1] * np.sin((k + 1) * q) for k in range(3))
        passive = setting.passive_nm.copy()
        passive[:, self.axis] += torque
        return replace(setting, passive_nm=passive)


@dataclass(frozen=True, slots=True)
class SumTorque(_Unnamed):
    """A torque on one axis that depends on the sum of the angles of joints 2 and 3: two harmonics and a constant."""

    linear: ClassVar[tuple[bool, ...]] = (True,) * 5
    parameters: ClassVar[tuple[str, ...]] = ("constant_nm", "cosine1_nm", "sine1_nm", "cosine2_nm", "sine2_nm")
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 5

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        q = rows.q_rad[:, 1] + rows.q_rad[:, 2]
        basis = np.stack([np.ones_like(q), np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)], axis=1)
        passive = setting.passive_nm.copy()
        passive[:, self.axis] += basis @ theta
        return replace(setting, passive_nm=passive)


@dataclass(frozen=True, slots=True)
class Pull(_Unnamed):
    """A constant force in the base frame on the origin of link `axis`."""

    linear: ClassVar[tuple[bool, ...]] = (True,) * 3
    parameters: ClassVar[tuple[str, ...]] = ("x_n", "y_n", "z_n")
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 3

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        pull = setting.pull_n.copy()
        pull[self.axis] += theta
        return replace(setting, pull_n=pull)


@dataclass(frozen=True, slots=True)
class UnevenGain(_Unnamed):
    """A gain of one axis that swings with its own angle."""

    linear: ClassVar[tuple[bool, ...]] = (True,) * 2
    parameters: ClassVar[tuple[str, ...]] = ("cosine", "sine")
    SPREAD: ClassVar[tuple[float, ...]] = (0.3, 0.3)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        q = rows.q_rad[:, self.axis]
        gain = setting.gain.copy()
        gain[:, self.axis] *= 1.0 + theta[0] * np.cos(q) + theta[1] * np.sin(q)
        return replace(setting, gain=gain)


@dataclass(frozen=True, slots=True)
class BentGain(_Unnamed):
    """A gain of one axis that depends on its modelled torque (a motor that saturates)."""

    largest_nm: float = 1.0
    linear: ClassVar[tuple[bool, ...]] = (True,)
    parameters: ClassVar[tuple[str, ...]] = ("at_largest",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.3,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        slope = setting.gain_per_nm.copy()
        slope[self.axis] += theta[0] / self.largest_nm
        return replace(setting, gain_per_nm=slope)


@dataclass(frozen=True, slots=True)
class UnevenBand(_Unnamed):
    """Friction of one axis that depends on the angle of a joint: two harmonics."""

    joint: int = 0
    linear: ClassVar[tuple[bool, ...]] = (True,) * 4
    parameters: ClassVar[tuple[str, ...]] = ("cosine1", "sine1", "cosine2", "sine2")
    SPREAD: ClassVar[tuple[float, ...]] = (0.5,) * 4

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        q = rows.q_rad[:, self.joint]
        swing = theta[0] * np.cos(q) + theta[1] * np.sin(q) + theta[2] * np.cos(2 * q) + theta[3] * np.sin(2 * q)
        band = setting.band_gain.copy()
        band[:, self.axis] *= 1.0 + swing
        return replace(setting, band_gain=band)
