"""Derive the state of a robot from trends and loads: visit, not seen, cannot tell, healthy. Missing data never count as
healthy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from gateway.fleet.history import History, program_masses
from gateway.result.fleet import GAIN, MASS, FleetTrend, ProgramLoad, RobotLine, State, quantity
from gateway.result.numerals import half_width, plain
from gateway.result.result import Outcome
from gateway.result.values import NAN

#: A robot without a check for longer counts as not seen [days].
SILENT_DAYS: Final = 30.0
#: Share of the tolerance per year from which on a detected drift requires a visit.
_WORTH: Final = 0.5
#: A load that is verified weighs what it weighed first, to this share.
_SAME_MASS: Final = 0.05
#: A failing finding has priority over any drift.
_FAILING: Final = 100.0


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason for a state: message, resulting state and weight."""

    state: State
    urgency: float
    said: str


def judged(
    robot: str,
    history: History,
    trends: Sequence[FleetTrend],
    loads: Sequence[ProgramLoad],
    as_of: datetime,
) -> RobotLine:
    """Return the state of a robot from its rows."""
    rows = history.rows
    last = rows["time_utc"][rows.num_rows - 1].as_py().replace(tzinfo=UTC) if rows.num_rows else None
    silent = list(_silent(last, as_of))
    if silent:
        loads = [load for load in loads if load.outcome == "fail"]
    reasons = sorted(
        [
            *_failing(rows),
            *_drifting(trends),
            *_changed(loads),
            *silent,
            *_undetectable(history, trends),
        ],
        key=lambda reason: (_ORDER[reason.state], -reason.urgency),
    )
    state: State = reasons[0].state if reasons else "healthy"
    urgency = reasons[0].urgency if reasons else _nearest(trends)
    first = rows["time_utc"][0].as_py() if rows.num_rows else None
    gain = max((each for each in trends if _gain_detectable(each)), key=_sureness, default=None)
    return RobotLine(
        robot=robot,
        cell=rows["cell"][0].as_py() if rows.num_rows else "",
        arm=rows["arm"][0].as_py() if rows.num_rows else "",
        state=state,
        urgency=urgency,
        why=tuple(reason.said for reason in reasons),
        checks=rows.num_rows,
        first_seen="" if first is None else f"{first:%Y-%m-%d}",
        last_seen="" if last is None else f"{last:%Y-%m-%d}",
        serial_numbers=tuple(rows["serial_numbers"][0].as_py() or ()) if rows.num_rows else (),
        gain_joint=0 if gain is None else gain.joint,
        gain_per_year=NAN if gain is None else gain.drift_per_year,
        gain_std_per_year=NAN if gain is None else gain.drift_std_per_year,
    )


def _gain_detectable(trend: FleetTrend) -> bool:
    return trend.quantity == GAIN.key and math.isfinite(trend.sigmas)


def _sureness(trend: FleetTrend) -> tuple[float, float]:
    """Return the significance of a drift; for inconsistent checks, drift over its standard deviation."""
    return abs(trend.sigmas), abs(trend.drift_per_year) / (trend.drift_std_per_year or math.inf)


_ORDER: Final[dict[State, int]] = {"visit": 0, "not seen": 1, "cannot tell": 2, "healthy": 3}


def _failing(rows: Any) -> Iterator[Reason]:
    """Return a reason for each failing finding of the last check."""
    if rows.num_rows:
        for said in rows["failing"][rows.num_rows - 1].as_py() or ():
            yield Reason("visit", _FAILING, f"the last check fails: {said}")


def _drifting(trends: Sequence[FleetTrend]) -> Iterator[Reason]:
    for trend in trends:
        kind = quantity(trend.quantity)
        share = abs(trend.share_per_year) / kind.tolerance
        if trend.found_on is None or not share >= _WORTH or math.isnan(trend.share_per_year):
            continue
        yield Reason("visit", share, f"{where_of(trend)}: {kind.words} drifts by {drift_in_words(trend)} a year,"
                     f" detected on {trend.found_on}")  # fmt: skip


def where_of(trend: FleetTrend) -> str:
    """Return the name of the axis or load of a trend."""
    return f"load '{trend.program}'" if trend.quantity == MASS.key else f"J{trend.joint}"


def drift_in_words(trend: FleetTrend) -> str:
    """Return the drift with its 95 % interval as text: relative, or in its unit."""
    kind = quantity(trend.quantity)
    if kind.relative or not kind.unit:
        return f"{plain(100 * trend.share_per_year, 1)} ± {plain(100 * half_width(trend.share_std_per_year), 1)} %"
    milli = 1000.0
    half = half_width(trend.drift_std_per_year)
    return f"{plain(milli * trend.drift_per_year, 2)} ± {plain(milli * half, 2)} m{kind.unit}"


def _changed(loads: Sequence[ProgramLoad]) -> Iterator[Reason]:
    for load in loads:
        if load.outcome == "fail":
            yield Reason("visit", _FAILING / 2, f"load '{load.program}': {load.why}")
        elif load.outcome == "cannot tell":
            yield Reason("cannot tell", 1.0, f"load '{load.program}': {load.why}")


def _silent(last: datetime | None, as_of: datetime) -> Iterator[Reason]:
    if last is None:
        yield Reason("not seen", _FAILING, "no check with a plausible time: set the clock of the robot")
        return
    days = (as_of - last).total_seconds() / 86400.0
    if days > SILENT_DAYS:
        yield Reason("not seen", days / SILENT_DAYS, f"not seen since {last:%Y-%m-%d}, {days:.0f} days")


def _undetectable(history: History, trends: Sequence[FleetTrend]) -> Iterator[Reason]:
    """Return the axes whose gain drift is not yet detectable, or whose gain is not measured."""
    gains = {trend.joint: trend for trend in trends if trend.quantity == GAIN.key}
    missing = [f"J{joint}" for joint in range(1, history.axes + 1) if joint not in gains]
    if not history.axes:
        yield Reason("cannot tell", 3.0, "no check determines any axis")
    elif missing:
        yield Reason("cannot tell", 2.0, f"the gain of {', '.join(missing)} was never measured")
    young = [f"J{joint}" for joint, trend in sorted(gains.items()) if math.isnan(trend.detectable_per_year)]
    if young:
        yield Reason("cannot tell", 1.5, f"too few checks to detect a drift of {', '.join(young)}")
    weak = {
        joint: each.detectable_per_year for joint, each in gains.items() if each.detectable_per_year > GAIN.tolerance
    }
    if weak:
        worst = max(weak.values())
        named = ", ".join(f"J{joint}" for joint in sorted(weak))
        yield Reason(
            "cannot tell", 1.0,
            f"a drift of the gain of {named} below {100 * worst:.1f} % a year is not yet detectable",
        )  # fmt: skip


def _nearest(trends: Sequence[FleetTrend]) -> float:
    """Return how close the nearest trend is to detection."""
    near = [abs(trend.sigmas) / trend.needed_sigmas for trend in trends if math.isfinite(trend.sigmas)]
    return max(near, default=0.0)


# -- loads -------------------------------------------------------------------------------------------------------------


def program_loads(rows: Any, as_of: datetime) -> tuple[ProgramLoad, ...]:
    """Return the load of every program, and whether it is verified."""
    outcomes = {each["program"]: each["outcome"] for loads in rows["loads"].to_pylist() for each in loads or ()}
    return tuple(
        _program(program, rows, mass, std, outcomes.get(program), as_of)
        for program, (mass, std) in sorted(program_masses(rows).items())
    )


def _program(
    program: str, rows: Any, mass: np.ndarray, std: np.ndarray, said: Outcome | None, as_of: datetime
) -> ProgramLoad:
    known = np.flatnonzero(np.isfinite(mass))
    if not len(known):
        return ProgramLoad(program, 0, NAN, NAN, NAN, NAN, "", "cannot tell", "its mass was never identified")
    first, last = int(known[0]), int(known[-1])
    last_seen = rows["time_utc"][last].as_py().replace(tzinfo=UTC)
    outcome, why = _verified(mass, std, (first, last), said)
    days = (as_of - last_seen).total_seconds() / 86400.0
    if outcome == "pass" and days > SILENT_DAYS:
        outcome, why = "cannot tell", f"not seen since {last_seen:%Y-%m-%d}"
    return ProgramLoad(
        program, len(known), float(mass[first]), float(std[first]), float(mass[last]), float(std[last]),
        f"{last_seen:%Y-%m-%d}", outcome, why,
    )  # fmt: skip


def _verified(mass: np.ndarray, std: np.ndarray, ends: tuple[int, int], said: Outcome | None) -> tuple[Outcome, str]:
    first, last = ends
    if said == "fail":
        return "fail", "the last check did not accept it"
    if said == "pass":
        return "pass", "accepted by the last check"
    if first == last:
        return "cannot tell", "identified once, without a value to compare with"
    change, half = float(mass[last] - mass[first]), half_width(float(np.hypot(std[first], std[last])))
    allowed = _SAME_MASS * abs(float(mass[first]))
    masses = f"{plain(mass[last], 2)} kg, first {plain(mass[first], 2)} kg"
    if not math.isfinite(half):
        return "cannot tell", f"{masses}, without standard deviation: cannot be compared"
    if abs(change) + half <= allowed:
        return "pass", f"{masses}: unchanged"
    if abs(change) - half > allowed:
        return "fail", f"{masses}: another load"
    return "cannot tell", f"{masses}: ± {plain(half, 2)} kg does not decide whether it is the same"
