"""Smooth residual structure without a named cause, as a rival of the named effects.

If such a shape explains the residual better than every named effect, the result reports an unexplained structure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.labels import BARE_LABEL
from gateway.model.effect import RestSetup, largest_torque_nm, measured_axes
from gateway.model.rest import AlteredModel
from gateway.model.term import NAN, AngleTorque, OnAxis, Term, plus
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


#: Name of a shape that no effect explains.
UNNAMED: Final = "unnamed"
#: Steepness of a liquid's displacement by the direction of gravity: in proportion, and in flatter tanks.
STEEPNESSES: Final = (0.0, 2.0, 6.0)
#: Usual play of a gear [rad]: 5 arc minutes, as of planetary gears; strain-wave and cycloidal gears have less.
PLAY_RAD: Final = 0.0015


@dataclass(frozen=True, slots=True)
class PositionTorque(AngleTorque):
    """Torque on one axis that depends on the angle of one joint: three harmonics."""

    joint: int = 0
    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 6
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 6

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return harmonics(q_rad[:, self.joint], 3)


@dataclass(frozen=True, slots=True)
class SumTorque(AngleTorque):
    """Torque on one axis that depends on the sum of the angles of joints 2 and 3: two harmonics and a constant."""

    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 5
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 5

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        q = q_rad[:, 1] + q_rad[:, 2]
        return np.column_stack([np.ones_like(q), harmonics(q, 2)])


@dataclass(frozen=True, slots=True)
class Pull(OnAxis):
    """Constant force in the base frame on the origin of link `axis`."""

    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 3
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 3

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, pull_n=plus(setting.pull_n, self.axis, theta))


@dataclass(frozen=True, slots=True)
class Slosh(Term):
    """Centre of the load that moves with the direction of gravity in the last link: a liquid, or a loose part.

    With `steepness` the displacement saturates where the liquid has run to one side; 0 = it does not.
    """

    steepness: float
    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 3
    SPREAD: ClassVar[tuple[float, ...]] = (0.1,) * 3
    modelled: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, slosh=(*setting.slosh, (self.steepness, theta)))


@dataclass(frozen=True, slots=True)
class UnevenGain(OnAxis):
    """Gain of one axis that varies with its own angle."""

    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 2
    SPREAD: ClassVar[tuple[float, ...]] = (0.3, 0.3)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        gain = setting.gain.copy()
        gain[:, self.axis] *= 1.0 + harmonics(rows.q_rad[:, self.axis], 1) @ theta
        return replace(setting, gain=gain)


@dataclass(frozen=True, slots=True)
class BentGain(OnAxis):
    """Gain of one axis that depends on its modelled torque (motor saturation)."""

    largest_nm: float = 1.0
    name: ClassVar[str] = UNNAMED
    SPREAD: ClassVar[tuple[float, ...]] = (0.3,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, gain_per_nm=plus(setting.gain_per_nm, self.axis, theta[0] / self.largest_nm))


@dataclass(frozen=True, slots=True)
class UnevenBand(OnAxis):
    """Friction of one axis that depends on the angle of a joint: two harmonics."""

    joint: int = 0
    name: ClassVar[str] = UNNAMED
    linear: ClassVar[tuple[bool, ...]] = (True,) * 4
    SPREAD: ClassVar[tuple[float, ...]] = (0.5,) * 4

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        band = setting.band_gain.copy()
        band[:, self.axis] *= 1.0 + harmonics(rows.q_rad[:, self.joint], 2) @ theta
        return replace(setting, band_gain=band)


@dataclass(frozen=True, slots=True)
class Play(OnAxis):
    """Play of a gear, which every gear has: elasticity is not named if its play explains the data as well."""

    name: ClassVar[str] = UNNAMED
    SPREAD: ClassVar[tuple[float, ...]] = (PLAY_RAD,)
    looks_like: ClassVar[str] = "joint_elasticity"
    modelled: ClassVar[bool] = True

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, play_rad=plus(setting.play_rad, self.axis, theta[0]))


def harmonics(angle_rad: Floats, count: int) -> Floats:
    """Return cosine and sine (n, 2 count) of the first `count` multiples of an angle (n,)."""
    return np.column_stack([wave(k * angle_rad) for k in range(1, count + 1) for wave in (np.cos, np.sin)])


def unnamed_terms(rows: Visits, setup: RestSetup) -> list[Term]:
    """Return the smooth shapes without a cause; gravity causes no torque on a vertical first axis."""
    measured, count = measured_axes(rows), rows.axes
    largest = largest_torque_nm(setup)
    carrying = [axis for axis in measured if axis > 0]
    terms: list[Term] = [PositionTorque(axis, joint) for axis in measured for joint in range(1, count)]
    terms += [SumTorque(axis) for axis in (1, 2) if axis in measured and count > 2]
    terms += [UnevenGain(axis) for axis in carrying]
    terms += [BentGain(axis, float(largest[axis])) for axis in carrying]
    terms += [UnevenBand(axis, axis) for axis in measured]
    terms += [Play(axis) for axis in carrying]
    terms += [Pull(link) for link in range(2, count)]
    terms += sloshing(rows)
    return terms


def sloshing(rows: Visits) -> list[Term]:
    """Return liquids and loose parts in the load."""
    return [Slosh(steepness) for steepness in STEEPNESSES if (rows.load != BARE_LABEL).any()]
