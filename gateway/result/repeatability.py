"""Repeatability: does the spread of repeated measurements of one load agree with their stated standard deviations?

The error of repetition i is `own_i + c_i z`. The vector z holds the errors that all measurements of the arm share, each
of variance 1: torque constants, link masses, lasting friction. Row c_i is in the result (`common_errors`); it changes
with the poses. The covariance of the n repetitions is therefore

    V = diag(s_i^2 - |c_i|^2) + C C^T        s_i: the stated standard deviation

and the expected spread is `sqrt(tr(M V) / (n - 1))` with `M = I - 1 1^T / n`. What is common and equal in all
repetitions is not part of it. The ratio of spread over expected spread has a chi-square interval; its degrees of
freedom are `tr(M V)^2 / tr(M V M V)` (Satterthwaite), n - 1 for equal and independent repetitions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from gateway.errors import InputError
from gateway.result.compare import CANNOT_TELL, FALSE_ALARM, refuse_other_arms, shared_errors
from gateway.result.data_roles import shared_rows
from gateway.result.result import LoadResult, Result
from gateway.result.values import numbers, plain_values

Floats = NDArray[np.float64]
Outcome = Literal["hold", "too small", "too large", "cannot tell"]
HOLD: Final = "hold"
TOO_SMALL: Final = "too small"
TOO_LARGE: Final = "too large"
FEWEST: Final = 2
#: Deviation from the weighted mean, in its standard deviations, from which a measurement is listed.
FAR: Final = 3.0
#: Upper end of the 95 % interval over the ratio above which the repetitions are too few to decide.
RESOLUTION: Final = 2.0
#: Least share of a variance that is of one repetition: rounding.
_LEAST_OWN: Final = 1e-6
_MOMENTS: Final = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


@dataclass(frozen=True, slots=True)
class RepeatedQuantity:
    """One quantity over the repetitions.

    Attributes
    ----------
    where, what, unit : str
    repetition : tuple of int
        Repetitions that hold the quantity, from 1; the next three have one number for each.
    value, std : tuple of float
        Value and stated standard deviation.
    deviation : tuple of float
        Value less weighted mean, over the standard deviation of that difference.
    mean, mean_std : float
        Weighted mean and its standard deviation, with the errors that all repetitions share.
    spread, expected, stated : float
        Standard deviation over the repetitions; what V predicts of it; root mean square of the stated ones.
    ratio, low, high : float
        `spread / expected` and its 95 % interval.
    is_separated : bool
        Whether the results state which errors they share; otherwise all stated errors are expected to differ.
    outcome : "hold", "too small", "too large" or "cannot tell"
        Of the stated standard deviations.
    """

    where: str
    what: str
    unit: str
    repetition: tuple[int, ...]
    value: tuple[float, ...]
    std: tuple[float, ...]
    deviation: tuple[float, ...]
    mean: float
    mean_std: float
    spread: float
    expected: float
    stated: float
    ratio: float
    low: float
    high: float
    is_separated: bool
    outcome: Outcome

    @property
    def far(self) -> tuple[int, ...]:
        """Repetitions that deviate by more than three standard deviations."""
        return tuple(
            number for number, away in zip(self.repetition, self.deviation, strict=True) if not abs(away) <= FAR
        )


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Quantities of repeated measurements, verdict, and remarks."""

    robot: str
    files: tuple[str, ...]
    measured: tuple[str | None, ...]
    quantities: tuple[RepeatedQuantity, ...]
    verdict: Outcome
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return plain values; NaN becomes None."""
        rows = [asdict(each) | {"beyond_3_std": list(each.far)} for each in self.quantities]
        found = {"verdict": self.verdict, "conclusion": conclusion(self), "quantities": rows, "remarks": self.remarks}
        about = {"robot": self.robot, "files": self.files, "measured": self.measured}
        return {"schema": 1, "kind": "repeatability", **plain_values(about | found)}


def repeatability(results: Sequence[Result], names: Sequence[str]) -> Repeatability:
    """Compare the spread of repeated measurements with their stated standard deviations.

    Parameters
    ----------
    results : sequence of Result
        In the order of measurement.
    names : sequence of str
        Their files, for messages.

    Raises
    ------
    InputError
        Fewer than two results, of different arms, two of the same data, or no load that two of them hold.
    """
    if len(results) < FEWEST:
        raise InputError(f"{len(results)} result: at least {FEWEST} repetitions are needed for a spread")
    for result, name in zip(results, names, strict=True):
        refuse_other_arms(results[0], result, (names[0], name))
    for (one, other), files in zip(combinations(results, 2), combinations(names, 2), strict=True):
        if None is not one.sha256 == other.sha256 or shared_rows(one.data_roles, other.data_roles)["all"]:
            raise InputError(f"{' and '.join(files)} are of the same data: give each repetition once")
    labels = dict.fromkeys(load.label for result in results for load in result.loads)
    series = [series for label in labels for series in _series(results, label)]
    if not series:
        raise InputError(f"{', '.join(names)}: no load with an uncertainty in two of the results")
    quantities = tuple(_judged(each, FALSE_ALARM / len(series)) for each in series)
    remarks = tuple(_remarks(results, names, quantities, list(labels)))
    measured = tuple(map(_measured, results))
    return Repeatability(results[0].robot, tuple(names), measured, quantities, _verdict(quantities), remarks)


def conclusion(found: Repeatability) -> str:
    """Return the verdict as one line."""
    count = len(found.files)
    if found.verdict == TOO_SMALL:
        worst = max((row for row in found.quantities if row.outcome == TOO_SMALL), key=lambda row: row.low)
        return f"the spread of {worst.what} of {worst.where} is {worst.ratio:.1f} times the expected one"
    if found.verdict == CANNOT_TELL:
        return f"{count} repetitions do not decide within a factor of {RESOLUTION:g}: repeat more often"
    if found.verdict == TOO_LARGE:
        least = min((row for row in found.quantities if row.outcome == TOO_LARGE), key=lambda row: row.high)
        return (
            f"the stated standard deviations are cautious: the spread of {least.what} of {least.where} is "
            f"{least.ratio:.2f} times the expected one"
        )
    ratios = [row.ratio for row in found.quantities]
    return (
        f"the stated standard deviations hold: spread over expected spread {min(ratios):.2f} to {max(ratios):.2f} in "
        f"{count} repetitions"
    )


#: Place, name and unit of a quantity, repetitions that hold it, values (n,), their standard deviations (n,), and the
#: errors (n, m) that they share, or None.
_Series = tuple[str, str, str, tuple[int, ...], Floats, Floats, Floats | None]


def _series(results: Sequence[Result], label: str) -> Iterator[_Series]:
    """Yield the quantities of a load that at least two results hold with an uncertainty."""
    found = {k: load for k, result in enumerate(results, 1) for load in result.loads if load.label == label}
    frame = next(iter(found.values())).frame
    if any(load.frame != frame for load in found.values()):
        raise InputError(f"load {label}: the results give its centre of gravity in different frames")
    names = [("mass", "kg"), *((f"centre {axis} in {frame}", "m") for axis in "xyz")]
    names += [(f"inertia {moment}", "kg m2") for moment in _MOMENTS]
    for part, (what, unit) in enumerate(names):
        pairs = {k: _numbers(load)[part] for k, load in found.items()}
        kept = [k for k, (value, std) in pairs.items() if math.isfinite(value) and std > 0]
        if len(kept) < FEWEST:
            continue
        value, std = np.array([pairs[k] for k in kept]).T
        common = shared_errors([found[k] for k in kept], part) if part < 4 else None
        yield f"load {label}", what, unit, tuple(kept), value, std, common


def _numbers(load: LoadResult) -> list[tuple[float, float]]:
    """Return value and standard deviation of mass, centre of gravity (3) and moments of inertia (6); NaN if unknown."""
    unknown = (math.nan,) * len(_MOMENTS)
    vectors = ((load.com_m, load.com_std_m, 3), (load.inertia_kg_m2, load.inertia_std_kg_m2, len(_MOMENTS)))
    parts = [
        pair for values, stds, k in vectors for pair in zip((values or unknown)[:k], (stds or unknown)[:k], strict=True)
    ]
    return [(load.mass_kg, load.mass_std_kg), *parts]


def _judged(series: _Series, false_alarm: float) -> RepeatedQuantity:
    """Compare the spread of a quantity; `false_alarm` is the chance of a wrong verdict on it."""
    where, what, unit, repetition, value, std, stated_common = series
    n, variance = len(value), std**2
    common = np.zeros((n, 0)) if stated_common is None else stated_common
    own = np.maximum(variance - np.sum(common**2, axis=1), _LEAST_OWN * variance)
    covariance = np.diag(own) + common @ common.T
    weight = 1.0 / own / np.sum(1.0 / own)
    mean = float(weight @ value)
    away = np.eye(n) - weight
    deviation = (value - mean) / np.sqrt(np.diag(away @ covariance @ away.T))
    scatter = covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None] + covariance.mean()
    spread, expected = float(np.std(value, ddof=1)), math.sqrt(np.trace(scatter) / (n - 1))
    freedom = float(np.trace(scatter) ** 2 / np.sum(scatter**2))
    ratio = spread / expected
    low, high = _interval(ratio, freedom, FALSE_ALARM)
    judged_low, judged_high = _interval(ratio, freedom, false_alarm)
    outcome: Outcome = CANNOT_TELL
    if judged_low > 1.0:
        outcome = TOO_SMALL
    elif judged_high < 1.0:
        outcome = TOO_LARGE if stated_common is not None else CANNOT_TELL
    elif high <= RESOLUTION * ratio:
        outcome = HOLD
    return RepeatedQuantity(
        where=where,
        what=what,
        unit=unit,
        repetition=repetition,
        value=numbers(value),
        std=numbers(std),
        deviation=numbers(deviation),
        mean=mean,
        mean_std=math.sqrt(weight @ covariance @ weight),
        spread=spread,
        expected=expected,
        stated=math.sqrt(variance.mean()),
        ratio=ratio,
        low=low,
        high=high,
        is_separated=stated_common is not None,
        outcome=outcome,
    )


def _interval(ratio: float, freedom: float, false_alarm: float) -> tuple[float, float]:
    """Return the interval of a ratio of standard deviations; the chi-square quantile is `2 gammaincinv(f / 2, p)`."""
    squares = [2.0 * float(gammaincinv(freedom / 2.0, p)) for p in (1.0 - false_alarm / 2.0, false_alarm / 2.0)]
    low, high = (ratio * math.sqrt(freedom / square) for square in squares)
    return low, high


def _verdict(quantities: Sequence[RepeatedQuantity]) -> Outcome:
    outcomes = {row.outcome for row in quantities}
    order: tuple[Outcome, ...] = (TOO_SMALL, CANNOT_TELL, TOO_LARGE, HOLD)
    return next(outcome for outcome in order if outcome in outcomes)


def _measured(result: Result) -> str | None:
    """Return when the first recording of a result was made, else when the result was computed."""
    if result.data is None:
        return None
    return next((source.created for source in result.data.sources if source.created), result.data.created)


def _remarks(
    results: Sequence[Result], names: Sequence[str], quantities: Sequence[RepeatedQuantity], labels: Sequence[str]
) -> Iterator[str]:
    if any(row.outcome == TOO_SMALL for row in quantities):
        yield (
            "find what changes between the repetitions (mounting, temperature, hoses); until then use the spread as "
            "standard deviation"
        )
    for number, name in enumerate(names, 1):
        far = [
            f"{row.what} of {row.where} by {row.deviation[row.repetition.index(number)]:+.1f}"
            for row in quantities
            if number in row.far
        ]
        if far:
            yield (
                f"{name} deviates from the mean: {', '.join(far)} standard deviations; check how the load was mounted, "
                "and repeat it"
            )
    for label in labels:
        lacking = [
            name
            for name, result in zip(names, results, strict=True)
            if not any(load.label == label and math.isfinite(load.mass_kg) for load in result.loads)
        ]
        if lacking:
            yield f"load {label}: no mass in {', '.join(lacking)}"
    if any(not row.is_separated for row in quantities):
        yield (
            "some results do not state which errors all repetitions share (motion, another method, an older version): "
            "there a small ratio proves nothing"
        )
    poses = {tuple(sorted(tuple(np.round(q, 2)) for q in result.rows.q_rad)) for result in results if result.rows}
    if len(poses) == 1 and all(result.rows for result in results):
        yield "all repetitions use the same poses: errors of a pose (cogging, joint zeros) are not in the spread"
