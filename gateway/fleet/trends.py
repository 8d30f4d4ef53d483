"""Trends of a robot: yearly drift of every quantity, and the day on which a drift was first detected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.fleet.correlated_noise import (
    DRIFT,
    FEWEST_CHECKS,
    FEWEST_DAYS,
    SHAPES,
    FittedLines,
    Sums,
    detectable,
    lines,
    log_seen,
    mixed,
    needed_sigmas,
    sigmas,
    sums,
    weights,
)
from gateway.fleet.history import CheckSeries
from gateway.result.fleet import MASS, FleetTrend, TrendCurve
from gateway.result.numerals import half_width
from gateway.result.values import NAN

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Days between looks at the same line: more looks cost no false alarm.
LOOK_DAYS: Final = 3.0
DAYS_OF_A_YEAR: Final = 365.25
LEVEL, PER_K, PER_KG = 0, 2, 3
#: Dots of a curve that is drawn.
_DOTS: Final = 90
_LINE: Final = 25
#: Prior weight of the noise shapes, equal for all, together that of one observed series.
_PRIOR_SERIES: Final = 1.0


@dataclass(frozen=True, slots=True)
class NoiseShapes:
    """Log frequency of each shape of correlated noise within the fleet, by quantity."""

    log_share: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def of(self, series: CheckSeries) -> Floats:
        """Return the log frequency (G, M) of every shape for every series."""
        even = (-float(np.log(len(SHAPES))),) * len(SHAPES)
        rows = [self.log_share.get(each.key, even) for each in series.quantities]
        return np.array(rows).reshape(-1, len(SHAPES)).T


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """Fitted lines after a number of checks."""

    checks: int
    day: float
    sums: Sums


def looks_of(series: CheckSeries) -> list[Look]:
    """Return the fitted lines at every look: the first after four weeks, the last after the last check."""
    count = len(series.time_a)
    if not count or not series.quantities:
        return []
    day = series.time_a * DAYS_OF_A_YEAR
    marks = np.arange(FEWEST_DAYS, day[-1] + LOOK_DAYS, LOOK_DAYS)
    at = np.unique(np.append(np.searchsorted(day, marks[marks <= day[-1]], side="right"), count))
    at = at[at >= 1]
    shape = series.value.shape
    time = np.broadcast_to(series.time_a[:, None], shape)
    known = np.isfinite(series.std) & (series.std > 0.0) & np.isfinite(series.value)
    usual = np.array(
        [np.median(column[flags]) if flags.any() else 1.0 for column, flags in zip(series.std.T, known.T, strict=True)]
    )
    reported = sums(
        series.time_a,
        np.stack([np.ones(shape), time, series.temperature_c, series.load_kg, series.value], axis=2),
        np.where(known, np.where(known, series.std, 1.0) / np.maximum(usual, 1e-300), 1.0),
        at,
    )
    return [Look(int(row), float(day[row - 1]), each) for row, each in zip(at, reported, strict=True)]


def active_columns(series: CheckSeries) -> Flags:
    """Return the active columns (M, 4): level, drift, temperature, load."""
    changed = [_changes(series.value, table) for table in (series.temperature_c, series.load_kg)]
    always = np.ones(len(series.quantities), dtype=bool)
    return np.stack([always, always, *changed], axis=1)


def _changes(value: Floats, table: Floats) -> Flags:
    there = np.isfinite(value) & np.isfinite(table)
    span = np.where(there, table, -np.inf).max(axis=0, initial=-np.inf) - np.where(there, table, np.inf).min(
        axis=0, initial=np.inf
    )
    return np.isfinite(span) & (span > 1e-9)


# -- correlated noise of the fleet
# ---------------------------------------------------------------------------------------------


def seen_likelihoods(series: CheckSeries) -> dict[str, list[Floats]]:
    """Return the log likelihoods (G,) of every shape, by quantity, for each series that is long enough."""
    looks = looks_of(series)
    if not looks:
        return {}
    last = lines(looks[-1].sums, active_columns(series))
    seen = log_seen(last, _tolerance(series, last))
    out: dict[str, list[Floats]] = {}
    for index, each in enumerate(series.quantities):
        if last.freedom[index] >= FEWEST_CHECKS:
            out.setdefault(each.key, []).append(seen[:, index])
    return out


def _tolerance(series: CheckSeries, line: FittedLines) -> Floats:
    """Return the tolerated yearly drift (M,), in the units of the series; by default the scatter of one check."""
    relative = np.array([each.relative for each in series.quantities])
    named = np.array([each.tolerance for each in series.quantities])
    named = named * np.where(relative, np.abs(line.value[0, :, LEVEL]), 1.0)
    return np.where(named > 0.0, named, np.sqrt(line.square[0]))


def noise_shapes_of(seen: Sequence[Mapping[str, Sequence[Floats]]]) -> NoiseShapes:
    """Estimate the frequency of each shape by maximum likelihood over the series of the fleet (EM)."""
    keys = {key for each in seen for key in each}
    shares: dict[str, tuple[float, ...]] = {}
    for key in sorted(keys):
        log = np.stack([row for each in seen for row in each.get(key, ())])
        like = np.exp(log - log.max(axis=1, keepdims=True))
        share = np.full(len(SHAPES), 1.0 / len(SHAPES))
        for _ in range(200):
            part = like * share
            part /= part.sum(axis=1, keepdims=True)
            share = (part.sum(axis=0) + _PRIOR_SERIES / len(SHAPES)) / (len(log) + _PRIOR_SERIES)
        shares[key] = tuple(np.log(share).tolist())
    return NoiseShapes(shares)


# -- trends ------------------------------------------------------------------------------------------------------------


def trends_of(
    series: CheckSeries, noise_shapes: NoiseShapes, first: datetime
) -> tuple[tuple[FleetTrend, ...], tuple[TrendCurve, ...]]:
    """Return trend and curve of every series.

    Parameters
    ----------
    series : CheckSeries
    noise_shapes : NoiseShapes
        Noise shapes of the fleet.
    first : datetime
        Of the first check.
    """
    looks = looks_of(series)
    if not looks:
        return (), ()
    active, log_prior = active_columns(series), noise_shapes.of(series)
    seen = np.isfinite(series.value).sum(axis=0)
    needed = needed_sigmas(int((seen >= FEWEST_CHECKS).sum()))
    found: dict[int, float] = {}
    for look in looks:
        reported = lines(look.sums, active)
        size = _long_enough(series, look, sigmas(reported, log_prior, _tolerance(series, reported)))
        for index in np.flatnonzero(np.abs(np.nan_to_num(size)) >= needed):
            found.setdefault(int(index), look.day)
    reported = lines(looks[-1].sums, active)
    tolerance = _tolerance(series, reported)
    size = _long_enough(series, looks[-1], sigmas(reported, log_prior, tolerance))
    mean, covariance = mixed(reported, weights(reported, log_prior))
    both = zip(mean, covariance, strict=True)
    detected = [_trend(series, index, line, active[index], float(size[index])) for index, line in enumerate(both)]
    least = detectable(np.array([trend.drift_std_per_year for trend in detected]), tolerance, needed)
    trends = tuple(
        replace(
            trend,
            needed_sigmas=needed,
            found_on=_day(first, found.get(index)),
            detectable_per_year=float(least[index]),
        )
        for index, trend in enumerate(detected)
    )
    curves = tuple(_curve(series, index, mean[index], covariance[index]) for index in range(len(series.quantities)))
    return trends, curves


def _long_enough(series: CheckSeries, look: Look, size: Floats) -> Floats:
    """Suppress lines from fewer than four weeks or fourteen checks."""
    there = np.isfinite(series.value[: look.checks])
    day = series.time_a[: look.checks, None] * DAYS_OF_A_YEAR
    span = np.where(there, day, -np.inf).max(axis=0) - np.where(there, day, np.inf).min(axis=0)
    return np.where((span >= FEWEST_DAYS - 0.5) & (there.sum(axis=0) >= FEWEST_CHECKS), size, np.nan)


def _day(first: datetime, day: float | None) -> str | None:
    return None if day is None else f"{first + timedelta(days=day):%Y-%m-%d}"


def _trend(series: CheckSeries, index: int, line: tuple[Floats, Floats], active: Flags, size: float) -> FleetTrend:
    """Return the trend of a line, before comparison with the threshold."""
    mean, covariance = line
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.isfinite(size)
    return FleetTrend(
        quantity=series.quantities[index].key,
        joint=series.joints[index],
        program=series.programs[index],
        checks=int(np.isfinite(series.value[:, index]).sum()),
        level=float(mean[LEVEL]),
        level_std=float(std[LEVEL]),
        drift_per_year=float(mean[DRIFT]) if known else NAN,
        drift_std_per_year=float(std[DRIFT]) if known else NAN,
        sigmas=size,
        per_k=float(mean[PER_K]) if active[PER_K] and known else NAN,
        per_kg=float(mean[PER_KG]) if active[PER_KG] and known and series.quantities[index] is not MASS else NAN,
    )


def _curve(series: CheckSeries, index: int, mean: Floats, covariance: Floats) -> TrendCurve:
    """Return the checks corrected to mean temperature and load, averaged in groups, with the line and its 95 % band."""
    value = series.value[:, index]
    moved = mean[PER_K] * series.temperature_c[:, index] + mean[PER_KG] * series.load_kg[:, index]
    use = np.isfinite(value) & np.isfinite(moved)
    day, level = series.time_a[use] * DAYS_OF_A_YEAR, (value - moved)[use]
    groups = [group for group in np.array_split(np.arange(len(day)), min(_DOTS, max(len(day), 1))) if len(group)]
    at = np.linspace(day[0], day[-1], _LINE) if len(day) > 1 else np.zeros(0)
    time = at / DAYS_OF_A_YEAR
    line = mean[LEVEL] + mean[DRIFT] * time
    spread = covariance[LEVEL, LEVEL] + 2.0 * time * covariance[LEVEL, DRIFT] + time**2 * covariance[DRIFT, DRIFT]
    half = half_width(1.0) * np.sqrt(np.maximum(spread, 0.0))
    return TrendCurve(
        quantity=series.quantities[index].key,
        joint=series.joints[index],
        program=series.programs[index],
        day=tuple(round(float(day[group].mean()), 3) for group in groups),
        value=tuple(float(level[group].mean()) for group in groups),
        line_day=tuple(at.tolist()),
        line=tuple(line.tolist()),
        low=tuple((line - half).tolist()),
        high=tuple((line + half).tolist()),
    )
