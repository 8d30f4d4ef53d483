"""Source of a drive's torque value: compare the torque object of the profile with the drive's demand and current in
motion.

All three are sampled at the same time. A torque that is the demand has identical bits. A torque that has lost its sign
keeps it while the demand changes sign. A wrong rated current or unit shows as a factor between torque and current.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from drives.objects import OBJECTS
from drives.torque_signals import TorqueSignals
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


def judge_torque(axis: Axis, signals: TorqueSignals, torque_nm: float, current_a: float | None) -> Finding:
    """Determine the source of the torque value of one drive.

    Parameters
    ----------
    axis : Axis
    signals : TorqueSignals
        Recorded while the axis moved in both directions.
    torque_nm : float
        Torque per bit of the torque object, motor side.
    current_a : float or None
        Current per bit of the current object; None = unit not known.
    """
    reference = axis.profile.torque.object
    address, torque = (reference.index, reference.subindex), np.array(signals.torque, dtype=float)
    if signals.missing or len(torque) < LEAST:
        what = f"torque could not be compared with demand and current: {signals.missing or 'too few answers'}"
        return axis.item("warn", address, what, "allow 0x1802 and 0x1A02 in the profile, if the drive has a third TPDO")
    others = {"demand": np.array(signals.demand, dtype=float), "current": np.array(signals.current, dtype=float)}
    compared = {name: values for name, values in others.items() if len(values) == len(torque)}
    if len(np.unique(torque)) < LEAST_VALUES:
        what = f"the torque showed {len(np.unique(torque))} different values in {len(torque)} SYNCs of motion"
        advice = "this is not a live measurement: look up the object of the measured torque in the drive's manual"
        return axis.item("fail", address, what, advice)
    fault = _against_demand(torque, compared["demand"]) if "demand" in compared else None
    if fault is None and "current" in compared:
        current_nm = None if current_a is None else current_a * axis.config.torque_constant_nm_per_a.value
        fault = _against_current(torque, compared["current"], torque_nm, current_nm)
    if fault is not None:
        severity, what, advice = fault
        return axis.item(severity, address, what, advice)
    if not compared:
        return axis.item("warn", address, "the drive has neither demand nor current to compare the torque with")
    what = f"a measured torque: compared with {' and '.join(compared)} at {len(torque)} SYNCs"
    if torque.min() < 0:
        return axis.item("ok", address, f"{what}; it has a sign")
    what = f"{what}; it was never negative in this motion, so a lost sign would not be detected"
    return axis.item("info", address, what)


def _against_demand(torque: np.ndarray, demand: np.ndarray) -> tuple[Severity, str, str] | None:
    name = OBJECTS["torque_demand"]
    if len(np.unique(demand)) < LEAST_VALUES:
        return None
    # equal except for unit and rounding
    factor = float(torque @ demand) / float(demand @ demand)
    same = float(np.mean(np.abs(torque - factor * demand) <= 0.5 * max(1.0, abs(factor)) + 1e-9))
    if same > EQUAL_SHARE:
        what = f"equals the demand {name} at {100 * same:.0f} % of {len(torque)} SYNCs, also in motion: it is a demand"
        advice = "name the object of the measured torque or current in the profile; this one only repeats the demand"
        return "fail", what, advice
    if _lost_its_sign(torque, demand):
        what = f"never changes its sign, while the demand {name} does: it shows the magnitude only"
        return "fail", what, "name a signed object in the profile, or read the word as signed (i16)"
    r = _correlation(torque, demand)
    if r >= -FOLLOWS:
        return None
    if torque.min() >= 0:
        what = f"is positive, while the demand {name} is negative: its sign is lost or reversed"
        advice = "name a signed object in the profile; check the polarity in the drive (0x607E) and torque_sign"
        return "fail", what, advice
    what = f"has the opposite sign of the demand {name} (r = {r:.2f})"
    return "fail", what, "correct the polarity in the drive (0x607E); then check torque_sign"


def _against_current(
    torque: np.ndarray, current: np.ndarray, torque_nm: float, current_nm: float | None
) -> tuple[Severity, str, str] | None:
    name = OBJECTS["current"]
    if _lost_its_sign(torque, current):
        return "fail", f"never changes its sign, while the current {name} does", "name a signed object in the profile"
    if current_nm is None or abs(_correlation(torque, current)) < FOLLOWS:
        return None
    across, along = torque * torque_nm, current * current_nm
    factor = float(across @ along / (along @ along))
    if abs(abs(factor) - 1.0) < SAME and factor > 0:
        return None
    for value, reason, advice in FACTORS:
        if abs(factor / value - 1.0) < EXACT:
            return "fail", f"is {factor:.4g} times current x torque constant, {reason}", advice
    what = f"is {factor:.3g} times current {name} x torque constant"
    return "warn", what, "check torque_constant_nm_per_a, rated torque and rated current"


def _lost_its_sign(torque: np.ndarray, signed: np.ndarray) -> bool:
    """Return True if the torque keeps its sign while a signal of the same magnitude changes it."""
    clear = CLEAR * float(np.abs(signed).std() + np.abs(signed.mean()))
    both = min(float(np.mean(signed > clear)), float(np.mean(signed < -clear))) > SIGN_SHARE
    return bool((torque >= 0).all() and both) and _correlation(torque, np.abs(signed)) > FOLLOWS


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    spread = float(first.std() * second.std())
    return 0.0 if spread == 0.0 else float(np.mean((first - first.mean()) * (second - second.mean())) / spread)
