"""Compare a load with its expected mass and with the rating of the arm: pass, fail, or "cannot tell with this data".

With U the half width of the 95 % interval: pass where the whole interval is within the allowed range, fail where it is
wholly outside, else the data cannot decide: a load of 6.05 kg that is known to 0.2 kg is neither within nor beyond 6 kg
with a tolerance of 0.1 kg.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.result.numerals import SAID, half_width, holds_zero, interval_text, significant, with_interval
from gateway.result.result import Acceptance, Finding, LoadResult, Outcome, Result

Floats = NDArray[np.float64]

PASS: Final[Outcome] = "pass"
FAIL: Final[Outcome] = "fail"
CANNOT_TELL: Final[Outcome] = "cannot tell"
IN_WORDS: Final = {PASS: "pass", FAIL: "fail", CANNOT_TELL: "cannot tell with this data"}
OPTION: Final = "--expect"
#: What an arm can be rated for, and its unit: reach is that of the centre of gravity from the flange.
QUANTITIES: Final = {"mass": "kg", "reach": "m", "moment": "Nm"}


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected mass [kg] of a load, with its tolerance [kg]."""

    label: str
    mass_kg: float
    tolerance_kg: float


@dataclass(frozen=True, slots=True)
class Rating:
    """Rated limit of the arm: `what` is a key of `QUANTITIES`, `most` the limit in its unit, `source` its origin."""

    what: str
    most: float
    source: str


def parse_expected(text: str) -> Expected:
    """Parse the option value `LABEL=MASS,TOLERANCE`.

    Raises
    ------
    InputError
        Not of that form, or a number that is not positive.
    """
    label, _, numbers = text.rpartition("=")
    try:
        values = [float(word) for word in numbers.split(",")]
    except ValueError:
        values = []
    if not label.strip() or len(values) != 2 or not all(math.isfinite(value) and value > 0 for value in values):
        raise InputError(
            f"{OPTION} {text}: expected LABEL=MASS,TOLERANCE, both in kg and above 0, such as tool=12.5,0.2"
        )
    return Expected(label.strip(), values[0], values[1])


def check_expected(expected: Sequence[Expected], labels: Iterable[str], data: str = "these data") -> None:
    """Check that every expected mass is of an estimated load, and that each load has at most one; `data` names files.

    Raises
    ------
    InputError
        Names the label.
    """
    present = list(labels)
    asked = [each.label for each in expected]
    for label in asked:
        if label not in present:
            held = ", ".join(present) or "none"
            raise InputError(f"{OPTION} {label}: no such load is estimated from {data}; they hold: {held}")
        if asked.count(label) > 1:
            raise InputError(f"{OPTION} {label}: is given twice; give one mass and one tolerance")


def accepted(result: Result, expected: Sequence[Expected], ratings: Sequence[Rating]) -> Result:
    """Return the result with the comparison of its loads with expected masses and ratings, and the findings.

    Parameters
    ----------
    result : Result
        Completed: the frame of the flange is in `data`.
    expected : sequence of Expected
    ratings : sequence of Rating
        A load without a mass is compared with none.
    """
    loads = {load.label: load for load in result.loads}
    rows = [_as_expected(loads.get(each.label, LoadResult(each.label)), each) for each in expected]
    for load in result.loads:
        if math.isfinite(load.mass_kg):
            rows += [_as_rated(load, rated, *_quantity(result, load, rated.what)) for rated in ratings]
    return replace(result, acceptance=tuple(rows), findings=(*result.findings, *acceptance_findings(rows)))


def outcome_of(off: float, half: float, allowed: float) -> Outcome:
    """Return the outcome of a deviation `off` with 95 % half width `half` for the tolerance `allowed`."""
    if off + half <= allowed:
        return PASS
    return FAIL if off - half > allowed else CANNOT_TELL


def _as_expected(load: LoadResult, expected: Expected) -> Acceptance:
    half = half_width(load.mass_std_kg)
    return Acceptance(
        load=load.label,
        what="mass",
        unit="kg",
        value=load.mass_kg,
        half_width=half,
        outcome=outcome_of(abs(load.mass_kg - expected.mass_kg), half, expected.tolerance_kg),
        source=OPTION,
        expected=expected.mass_kg,
        tolerance=expected.tolerance_kg,
    )


def _as_rated(load: LoadResult, rated: Rating, value: float, std: float) -> Acceptance:
    half = half_width(std)
    outcome = outcome_of(value, half, rated.most)
    return Acceptance(
        load.label, f"rated {rated.what}", QUANTITIES[rated.what], value, half, outcome, rated.source, most=rated.most
    )


def _quantity(result: Result, load: LoadResult, what: str) -> tuple[float, float]:
    """Return value and standard deviation of a rated quantity; NaN if the centre of gravity in the flange frame is
    unknown.
    """
    if what == "mass":
        return load.mass_kg, load.mass_std_kg
    spread = None if result.data is None else result.data.flange.get(load.label)
    if load.com_flange_m is None or spread is None:
        return math.nan, math.nan
    std = np.array([load.mass_std_kg, *spread.com_std_m])
    covariance = np.array(spread.correlation) * np.outer(std, std)
    com_m = np.array(load.com_flange_m)
    reach_m = float(np.linalg.norm(com_m))
    away = com_m / reach_m if reach_m > 0 else np.ones(3)
    if what == "reach":
        return reach_m, _std(np.array([0.0, *away]), covariance)
    gravity = float(np.linalg.norm(STANDARD_GRAVITY_M_S2))
    slope = gravity * np.array([reach_m, *(load.mass_kg * away)])
    return gravity * load.mass_kg * reach_m, _std(slope, covariance)


def _std(slope: Floats, covariance: Floats) -> float:
    """Return the standard deviation of a quantity with gradient `slope` (4,) and covariance (4, 4)."""
    return float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def asked_for(row: Acceptance) -> str:
    """Return the text of the allowed value."""
    if math.isfinite(row.most):
        return f"at most {significant(row.most, 6)} {row.unit} ({row.source})"
    return f"{significant(row.expected, 6)} {row.unit}, tolerance {significant(row.tolerance, 6)} {row.unit}"


def measured(row: Acceptance) -> str:
    """Return the text of the measured value with its interval."""
    if not math.isfinite(row.value):
        return "unknown"
    return f"{interval_text(row.value, row.half_width)} {row.unit}"


def acceptance_findings(rows: Iterable[Acceptance]) -> tuple[Finding, ...]:
    """Return a failing finding for every comparison that did not pass."""
    return tuple(_finding(row) for row in rows if row.outcome != PASS)


def _finding(row: Acceptance) -> Finding:
    said = f"{row.what} {measured(row)} ({SAID}), allowed: {asked_for(row)}: {IN_WORDS[row.outcome]}"
    if row.outcome == FAIL:
        advice = "check the mounted load and its fastening; the data are valid"
    elif not math.isfinite(row.value):
        advice = "the data give no such number: see what is said of this load, and measure what `next` names"
    else:
        advice = "the interval is too wide for a decision: measure more poses, or calibrate the torque constants"
    return Finding("fail", f"load {row.load}", said, advice)


def no_body(loads: Iterable[LoadResult]) -> tuple[Finding, ...]:
    """Return a failing finding for every load whose mass is significantly negative."""
    return tuple(
        Finding(
            "fail",
            f"load {load.label}",
            f"the mass comes out as {with_interval(load.mass_kg, load.mass_std_kg)} kg, which no body has",
            "check units (radians), signs and torque constants, and that the load was mounted in its own run only",
        )
        for load in loads
        if load.mass_kg < 0 and not holds_zero(load.mass_kg, load.mass_std_kg)
    )


def not_hung(loads: Iterable[LoadResult]) -> tuple[Finding, ...]:
    """Return a failing finding for every load whose mass interval contains 0: it may not be mounted."""
    return tuple(
        Finding(
            "fail",
            f"load {load.label}",
            f"{with_interval(load.mass_kg, load.mass_std_kg)} kg: no load detected. Is it mounted?",
            f"its {SAID} interval holds 0: mount it and measure it again, or measure more poses if it was mounted",
        )
        for load in loads
        if holds_zero(load.mass_kg, load.mass_std_kg)
    )


def open_findings(result: Result) -> frozenset[Finding]:
    """Return the failing findings caused by missing information, not by an error; pages show them in amber."""
    doubts = (row for row in result.acceptance if row.outcome == CANNOT_TELL)
    return frozenset((*not_hung(result.loads), *acceptance_findings(doubts)))
