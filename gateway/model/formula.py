"""Dictionary of a candidate formula for a torque that no effect of the library explains, in consistent units.

A formula is a sum of few pieces on one axis, or the constant force of one hose on the arm. The pieces are waves of one
joint angle or of the sum or difference of two, and buffers that are touched beyond an angle. Others are a gain or a
friction that varies with an angle, and a gain that varies with the torque.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import RestSetup, largest_torque_nm, measured_axes
from gateway.model.kinematics import link_frames
from gateway.model.rest import AlteredModel
from gateway.model.term import NAN, AngleTorque, OnAxis, Term
from gateway.model.unnamed import BentGain, Pull, Slosh, UnevenBand, UnevenGain, harmonics, sloshing
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

FORMULA: Final = "formula"
#: Multiples of one joint angle, and of the sum or difference of two, that a wave may have.
SINGLE: Final = (1, 2, 3, 4)
DOUBLE: Final = (1, 2)
#: Share of the visited angles beyond which a buffer begins, and powers of its compression.
SHARES: Final = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
POWERS: Final = (1, 2)


#: Shares of the largest torque at which a knee may be.
KNEES: Final = (0.25, 0.45, 0.65)
#: Where a hose may be anchored, in units of the arm's reach; shares of the visited distances at which it is taut.
ANCHORS: Final = tuple(at for at in product((-0.8, 0.0, 0.8), repeat=3) if any(at))
TAUT: Final = (0.3, 0.5, 0.7)


@dataclass(frozen=True, slots=True)
class Piece:
    """One product of a formula.

    Attributes
    ----------
    expression : in q1 .. qN [rad], `u` (modelled torque of the axis) and `friction` (its friction band) [Nm]
    unit : of its coefficient
    sign : of the coefficient by the parameter of the term
    """

    expression: str
    unit: str
    sign: float = 1.0


@dataclass(frozen=True, slots=True)
class AngleWave(AngleTorque):
    """Torque on one axis that is a sine of a whole-number combination of joint angles."""

    multiples: tuple[int, ...] = ()
    name: ClassVar[str] = FORMULA
    linear: ClassVar[tuple[bool, ...]] = (True,) * 2
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,) * 2

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return harmonics(q_rad @ np.array(self.multiples, dtype=float), 1)


@dataclass(frozen=True, slots=True)
class Buffer(AngleTorque):
    """Torque on one axis that grows with the compression beyond an angle, on one side."""

    at_rad: float = 0.0
    side: int = 1
    power: int = 1
    name: ClassVar[str] = FORMULA
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,)

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        return np.maximum(self.side * (q_rad[:, [self.axis]] - self.at_rad), 0.0) ** self.power


@dataclass(frozen=True, slots=True)
class Knee(OnAxis):
    """Gain of one axis that changes beyond a motor torque: a current sensor or a magnetic circuit that saturates.

    `share` of the largest torque is where.
    """

    share: float
    largest_nm: float
    name: ClassVar[str] = FORMULA
    linear: ClassVar[tuple[bool, ...]] = (True, False)
    modelled: ClassVar[bool] = True

    @property
    def start(self) -> tuple[float, ...]:
        return 0.0, self.share

    @property
    def spread(self) -> tuple[float, ...]:
        return 0.5, 0.3

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        knee = self.axis, float(theta[1]) * self.largest_nm, float(theta[0])
        return replace(setting, knees=(*setting.knees, knee))

    def shaped(self, values: Floats) -> Self:
        return replace(self, share=float(values[0]))


@dataclass(frozen=True, slots=True)
class Hose(Term):
    """Hose or cable from a fixed point to the origin of a link: slack up to its free length, elastic beyond."""

    link: int
    anchor_m: tuple[float, ...]
    free_m: float
    reach_m: float
    name: ClassVar[str] = FORMULA
    linear: ClassVar[tuple[bool, ...]] = (True, False, False, False, False)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, *self.anchor_m, self.free_m)

    @property
    def spread(self) -> tuple[float, ...]:
        return (NAN, *(0.5 * self.reach_m,) * 4)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, hoses=(*setting.hoses, (self.link, theta)))

    def exists(self, theta: Floats, std: Floats) -> bool:
        """Return True for a hose that pulls."""
        return bool(theta[0] >= 0.0)

    def shaped(self, values: Floats) -> Self:
        return replace(self, anchor_m=tuple(values[:3].tolist()), free_m=float(values[3]))


#: Terms that act on the whole arm: a formula consists of such a term alone.
ON_ARM: Final = (Pull, Slosh, Hose)
#: Terms that are the law of one mechanism; others are shapes that may describe many.
MECHANISMS: Final = (*ON_ARM, Knee)


def formula_terms(rows: Visits, setup: RestSetup) -> list[Term]:
    """Return all terms that a formula may have."""
    measured, count = measured_axes(rows), rows.axes
    largest = largest_torque_nm(setup)
    terms: list[Term] = []
    for axis in measured:
        terms += [AngleWave(axis, multiples) for multiples in _multiples(count)]
        angles = np.quantile(rows.q_rad[:, axis], SHARES).round(3).tolist()
        terms += [Buffer(axis, at, side, power) for at in angles for side in (-1, 1) for power in POWERS]
        terms.append(UnevenBand(axis, axis))
    for axis in (axis for axis in measured if axis > 0):
        terms += [UnevenGain(axis), BentGain(axis, float(largest[axis]))]
        terms += [Knee(axis, share, float(largest[axis])) for share in KNEES]
    terms += [Pull(link) for link in range(2, count)]
    return [*terms, *sloshing(rows), *_hoses(rows, setup)]


def _hoses(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    """Hoses to the last link and to the one that carries the wrist."""
    if setup.robot is None:
        return
    origins = link_frames(setup.robot, rows.q_rad)[:, :, :3, 3]
    for link in {rows.axes - 1, max(rows.axes - 3, 0)}:
        reach_m = float(np.linalg.norm(origins[:, link], axis=1).max())
        for point in ANCHORS:
            anchor = reach_m * np.array(point)
            free = np.quantile(np.linalg.norm(origins[:, link] - anchor, axis=1), TAUT).tolist()
            yield from (Hose(link, tuple(anchor.tolist()), length, reach_m) for length in free)


def _multiples(count: int) -> Iterator[tuple[int, ...]]:
    unit = np.eye(count, dtype=int)
    for joint in range(count):
        yield from (tuple((k * unit[joint]).tolist()) for k in SINGLE)
    for first, second in combinations(range(count), 2):
        for sign in (1, -1):
            yield from (tuple((k * (unit[first] + sign * unit[second])).tolist()) for k in DOUBLE)


def pieces(term: Term) -> tuple[Piece, ...]:
    """Return the products of a term, one for each of its parameters.

    Torque of a part beside the gear counts as the motor's: a part that pushes the joint relieves the motor.
    """
    match term:
        case AngleWave():
            return tuple(Piece(f"{wave}({angle(term.multiples)})", "Nm", -1.0) for wave in ("cos", "sin"))
        case Buffer():
            q, at = f"q{term.axis + 1}", f"{abs(term.at_rad):g}"
            beyond = f"{q} {'-' if term.at_rad >= 0.0 else '+'} {at}"
            inside = beyond if term.side > 0 else f"-({beyond})"
            power = f"**{term.power}" if term.power > 1 else ""
            return (Piece(f"max({inside}, 0){power}", f"Nm/rad{term.power if term.power > 1 else ''}", -1.0),)
        case UnevenGain():
            return tuple(Piece(f"u*{wave}(q{term.axis + 1})", "") for wave in ("cos", "sin"))
        case BentGain():
            return (Piece("u*abs(u)", "1/Nm", 1.0 / term.largest_nm),)
        case Knee():
            return (Piece(f"max(abs(u) - {float(f'{term.share * term.largest_nm:.3g}'):g}, 0)*sign(u)", ""),)
        case UnevenBand():
            waves = [f"{wave}({k}*q{term.joint + 1})" for k in (1, 2) for wave in ("cos", "sin")]
            return tuple(Piece(f"friction*{wave.replace('(1*', '(')}", "") for wave in waves)
        case Hose():
            anchor = ", ".join(f"{value:.2f}" for value in term.anchor_m)
            taut = f"hose from ({anchor}) m to link {term.link + 1}, taut beyond {term.free_m:.2f} m"
            return (Piece(taut, "N/m"),)
        case Slosh():
            return tuple(Piece(f"{axis} of the load by {_slosh(axis, term.steepness)}", "m") for axis in "xyz")
        case Pull():
            return tuple(Piece(f"force_{axis} on the origin of link {term.axis + 1}", "N") for axis in "xyz")
        case _:
            raise TypeError(f"{term!r} cannot be part of a formula")


def _slosh(axis: str, steepness: float) -> str:
    """Return the displacement of a liquid by the direction of gravity in the last link as text."""
    return f"tanh({steepness:g}*down_{axis})" if steepness > 0.0 else f"down_{axis}"


def angle(multiples: tuple[int, ...]) -> str:
    """Return a combination of joint angles as text."""
    parts = [
        f"{'-' if k < 0 else '+'} {'' if abs(k) == 1 else f'{abs(k)}*'}q{joint}"
        for joint, k in enumerate(multiples, start=1)
        if k
    ]
    return " ".join(parts).removeprefix("+ ")
