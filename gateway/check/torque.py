"""Source of a drive's torque value: compare the torque object of the profile with the drive's demand and current in
motion.

All three are sampled at the same time. A torque that is the demand has identical bits. A torque that has lost its sign
keeps it while the demand changes sign. A wrong rated current or unit shows as a factor between torque and current.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from drives.objects import OBJECTS, object_name
from drives.scaling import MotorScale
from drives.torque_signals import TorqueSignals
from gateway.cell.config import AxisConfig
from gateway.preflight.rules import Axis
from gateway.result.finding import Finding, Severity

#: Smallest number of SYNCs and of different values for a decision.
LEAST: Final = 200
LEAST_VALUES: Final = 10
#: Share of SYNCs at which a measured torque may equal the demand by chance.
EQUAL_SHARE: Final = 0.98
#: Distance of the demand from zero, in standard deviations, from which its sign is significant.
CLEAR: Final = 0.25
#: Correlation from which two signals count as equal in shape.
FOLLOWS: Final = 0.8
SIGN_SHARE: Final = 0.05
#: Relative tolerance of the factor between torque and current: for one, and for a known factor.
SAME: Final = 0.1
EXACT: Final = 0.04
FACTORS: Final = (
    (
        math.sqrt(2.0),
        "sqrt(2): an rms value is taken for a peak value",
        "correct current_reference or torque_constant_per",
    ),
    (
        math.sqrt(0.5),
        "1/sqrt(2): a peak value is taken for an rms value",
        "correct current_reference or torque_constant_per",
    ),
    (1000.0, "1000: mNm taken for uNm, or A for mA", "correct unit of [torque.rated] or [current.rated]"),
    (0.001, "1/1000: uNm taken for mNm, or mA for A", "correct unit of [torque.rated] or [current.rated]"),
)


@dataclass(frozen=True, slots=True)
class Scales:
    """Physical units per bit.

    Attributes
    ----------
    torque_nm : float
        Torque per bit of the torque object, motor side.
    current_nm : float or None
        Torque per bit of the current object (current times torque constant); None = unit not known.
    """

    torque_nm: float
    current_nm: float | None

    @classmethod
    def of(cls, scale: MotorScale, config: AxisConfig) -> Scales:
        """Return the scales of one drive."""
        current = None if scale.current_a is None else scale.current_a * config.torque_constant_nm_per_a.value
        return cls(scale.torque_nm, current)


def judge_torque(axis: Axis, words: TorqueSignals, scales: Scales) -> list[Finding]:
    """Determine the source of the torque value of one drive.

    Parameters
    ----------
    axis : Axis
    words : TorqueSignals
        Recorded while the axis moved in both directions.
    scales : Scales
    """
    reference = axis.profile.torque.object
    where = f"J{axis.joint} node {axis.config.node_id}:{object_name(reference.index, reference.subindex)}"
    torque = np.array(words.torque, dtype=float)
    if words.missing or len(torque) < LEAST:
        what = f"torque could not be compared with demand and current: {words.missing or 'too few answers'}"
        advice = "allow 0x1802 and 0x1A02 in the profile, if the drive has a third TPDO"
        return [Finding("warn", where, what, advice)]
    found = [Finding(severity, where, what, advice) for severity, what, advice in _rules(torque, words, scales)]
    return found or [_fine(where, torque, words)]


def _rules(torque: np.ndarray, words: TorqueSignals, scales: Scales) -> Iterator[tuple[Severity, str, str]]:
    if len(np.unique(torque)) < LEAST_VALUES:
        what = f"the torque showed {len(np.unique(torque))} different values in {len(torque)} SYNCs of motion"
        yield (
            "fail",
            what,
            "this is not a live measurement: look up the object of the measured torque in the drive's manual",
        )
        return
    demand = np.array(words.demand, dtype=float)
    if len(demand) == len(torque):
        found = list(_against_demand(torque, demand))
        yield from found
        if found:
            return
    current = np.array(words.current, dtype=float)
    if len(current) == len(torque):
        yield from _against_current(torque, current, scales)


def _against_demand(torque: np.ndarray, demand: np.ndarray) -> Iterator[tuple[Severity, str, str]]:
    name = OBJECTS["torque_demand"]
    if len(np.unique(demand)) < LEAST_VALUES:
        return
    same = _follows_to_the_bit(torque, demand)
    if same > EQUAL_SHARE:
        what = f"equals the demand {name} at {100 * same:.0f} % of {len(torque)} SYNCs, also in motion: it is a demand"
        yield (
            "fail",
            what,
            "name the object of the measured torque or current in the profile; this one only repeats the demand",
        )
        return
    if _lost_its_sign(torque, demand):
        what = f"never changes its sign, while the demand {name} does: it shows the magnitude only"
        yield "fail", what, "name a signed object in the profile, or read the word as signed (i16)"
        return
    r = _correlation(torque, demand)
    if r < -FOLLOWS and torque.min() >= 0:
        what = f"is positive, while the demand {name} is negative: its sign is lost or reversed"
        yield (
            "fail",
            what,
            "name a signed object in the profile; check the polarity in the drive (0x607E) and torque_sign",
        )
    elif r < -FOLLOWS:
        what = f"has the opposite sign of the demand {name} (r = {r:.2f})"
        yield "fail", what, "correct the polarity in the drive (0x607E); then check torque_sign"


def _against_current(torque: np.ndarray, current: np.ndarray, scales: Scales) -> Iterator[tuple[Severity, str, str]]:
    name = OBJECTS["current"]
    if _lost_its_sign(torque, current):
        yield "fail", f"never changes its sign, while the current {name} does", "name a signed object in the profile"
        return
    if scales.current_nm is None or abs(_correlation(torque, current)) < FOLLOWS:
        return
    across, along = torque * scales.torque_nm, current * scales.current_nm
    factor = float(across @ along / (along @ along))
    if abs(abs(factor) - 1.0) < SAME and factor > 0:
        return
    known = next(((words, advice) for value, words, advice in FACTORS if abs(factor / value - 1.0) < EXACT), None)
    if known is not None:
        yield "fail", f"is {factor:.4g} times current x torque constant, {known[0]}", known[1]
    else:
        what = f"is {factor:.3g} times current {name} x torque constant"
        yield "warn", what, "check torque_constant_nm_per_a, rated torque and rated current"


def _follows_to_the_bit(torque: np.ndarray, demand: np.ndarray) -> float:
    """Return the share of SYNCs at which the torque equals the demand except for unit and rounding."""
    power = float(demand @ demand)
    if power == 0.0:
        return 0.0
    factor = float(torque @ demand) / power
    return float(np.mean(np.abs(torque - factor * demand) <= 0.5 * max(1.0, abs(factor)) + 1e-9))


def _lost_its_sign(torque: np.ndarray, signed: np.ndarray) -> bool:
    """Return True if the torque keeps its sign while a signal of the same magnitude changes it."""
    clear = CLEAR * float(np.abs(signed).std() + np.abs(signed.mean()))
    both = min(float(np.mean(signed > clear)), float(np.mean(signed < -clear))) > SIGN_SHARE
    return bool((torque >= 0).all() and both) and _correlation(torque, np.abs(signed)) > FOLLOWS


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    spread = float(first.std() * second.std())
    return 0.0 if spread == 0.0 else float(np.mean((first - first.mean()) * (second - second.mean())) / spread)


def _fine(where: str, torque: np.ndarray, words: TorqueSignals) -> Finding:
    others = {"demand": words.demand, "current": words.current}
    compared = [name for name, values in others.items() if len(values) == len(torque)]
    if not compared:
        return Finding("warn", where, "the drive has neither demand nor current to compare the torque with")
    what = f"a measured torque: compared with {' and '.join(compared)} at {len(torque)} SYNCs"
    if torque.min() < 0:
        return Finding("ok", where, f"{what}; it has a sign")
    return Finding("info", where, f"{what}; it was never negative in this motion, so a lost sign would not be detected")
