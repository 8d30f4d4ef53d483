"""Evaluate a comparison of feedforward settings: figures, findings, and data for the pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.feedforward.identified import notes_of
from gateway.feedforward.load import FRAME, FeedLoad
from gateway.follow.job import Prepared
from gateway.follow.settings import FeedModel
from gateway.follow.track import Track, following
from gateway.follow.trend import Trend, load_trend
from gateway.result.follow import (
    IDENTIFIED,
    MAXIMUM,
    OFF,
    ComputingTime,
    ErrorCurve,
    FedLoad,
    FedModel,
    FollowedPath,
    FollowResult,
    FollowSeries,
    PeakRatio,
    TorqueCurve,
    TrendCloud,
)
from gateway.result.interval import SAID
from gateway.result.numerals import with_interval
from gateway.result.result import Finding
from gateway.result.values import matrix, numbers

Floats = NDArray[np.float64]
#: Number of points of a curve, and of dots of a scatter plot.
CURVE_POINTS, CLOUD_POINTS = 360, 260
#: Significance of a trend in standard deviations, and shares of the load from which it is reported.
SIGMAS = 3.0
NOTED_SHARE, FAILED_SHARE = 0.07, 0.10
#: Ratio of errors above which an axis counts as worse than without feedforward.
WORSE_RAD = 2e-5
#: Number of axes drawn with torque and trend: those with the largest load torque.
DRAWN_AXES = 2


def result_of(prepared: Prepared, tracks: Sequence[Track]) -> FollowResult:
    """Return a comparison as a result; `tracks` are the recorded passes, one per setting."""
    path, trend = prepared.path, None
    for setting, track in zip(prepared.settings, tracks, strict=True):
        if setting.name == IDENTIFIED and setting.load is not None:
            trend = load_trend(track, prepared.model, setting.load)
    loads = {setting.name: None if setting.load is None else _load(setting.load) for setting in prepared.settings}
    settings = tuple(following(track, loads[track.setting]) for track in tracks)
    peak = {setting.name: np.array(setting.peak_rad) for setting in settings}
    return FollowResult(
        robot=prepared.model.robot.name,
        cell=prepared.loaded.cell.name,
        arm=prepared.arm.name,
        path=FollowedPath(path.name, prepared.path_file, path.duration_s, path.period_s),
        settings=settings,
        ratio=_ratio(peak),
        trend=None if trend is None else trend.values,
        model=FedModel(prepared.model.links_source, prepared.model.sources),
        computing_s=_computing(tracks),
        left_out_syncs=_left_out(tracks),
        findings=findings(prepared, tracks, trend, peak),
        series=_series(tracks, trend),
    )


def _load(load: FeedLoad) -> FedLoad:
    return FedLoad(
        label=load.label,
        mass_kg=load.mass_kg,
        mass_std_kg=load.mass_std_kg,
        com_m=numbers(load.com_m),
        frame=FRAME,
        inertia_kg_m2=matrix(load.inertia_kg_m2),
        source=load.source,
        inertia_source=load.inertia_source,
    )


def _ratio(peak: Mapping[str, Floats]) -> PeakRatio:
    over_off = {name: numbers(value / peak[OFF]) for name, value in peak.items() if name != OFF and OFF in peak}
    both = IDENTIFIED in peak and MAXIMUM in peak
    return PeakRatio(over_off, numbers(peak[IDENTIFIED] / peak[MAXIMUM]) if both else None)


def _computing(tracks: Sequence[Track]) -> ComputingTime | None:
    times = np.concatenate([track.computing_s[track.computing_s > 0] for track in tracks])
    if not len(times):
        return None
    return ComputingTime(float(np.median(times)), float(np.percentile(times, 99)), float(times.max()), len(times))


def _left_out(tracks: Sequence[Track]) -> int:
    return sum(int(np.isnan(track.measured_rad).any(axis=1).sum()) for track in tracks)


def findings(
    prepared: Prepared, tracks: Sequence[Track], trend: Trend | None, peak: Mapping[str, Floats]
) -> tuple[Finding, ...]:
    """Return the findings, the worst first; `peak` (6,) error of each setting [rad]."""
    found = [*_load_finding(prepared, trend), *_worse(peak), *_missing(prepared.model)]
    if left := _left_out(tracks):
        total = sum(len(track.target_rad) for track in tracks)
        found.append(
            Finding(
                "info",
                "bus",
                f"{left} of {total} SYNCs are left out because an answer was missing, delayed or repeated",
            )
        )
    order = ("fail", "warn", "info")
    return tuple(sorted(found, key=lambda item: order.index(item.severity)))


def _load_finding(prepared: Prepared, trend: Trend | None) -> list[Finding]:
    fed = next((setting.load for setting in prepared.settings if setting.name == IDENTIFIED), None)
    if fed is None:
        return []
    where = f"load {fed.label}"
    if trend is None or not math.isfinite(trend.values.scale_std):
        what = "the path moves too little to check the load by the torque"
        return [Finding("warn", where, what, "follow a longer path that lifts and lowers the load")]
    scale, scale_std = trend.values.scale, trend.values.scale_std
    asked = (1.0 + scale) * fed.mass_kg
    said = (
        f"{with_interval(scale, scale_std, 100)} % of its torque ({SAID}) remains in the residual: the"
        f" torque corresponds to {asked:.2f} kg, the feedforward used {fed.mass_kg:.2f} kg"
    )
    proven = abs(scale) > SIGMAS * scale_std
    if not proven or abs(scale) < NOTED_SHARE:
        return [Finding("info", where, f"the torque agrees with the load in the feedforward ({said})")]
    severity = "fail" if abs(scale) >= FAILED_SHARE else "warn"
    advice = "the mounted load is not the identified one: identify it again, or mount the identified load"
    return [Finding(severity, where, said, advice)]


def _worse(peak: Mapping[str, Floats]) -> list[Finding]:
    if OFF not in peak or IDENTIFIED not in peak:
        return []
    worse = peak[IDENTIFIED] > peak[OFF] + WORSE_RAD
    advice = "check velocity_share in the drive profile, gear_efficiency and friction of this axis, and the load"
    return [
        Finding("warn", f"J{axis + 1}", "follows worse with the identified load than without feedforward", advice)
        for axis in np.flatnonzero(worse)
    ]


def _missing(model: FeedModel) -> list[Finding]:
    lacking: dict[str, list[int]] = {}
    for axis, source in enumerate(model.sources, start=1):
        for name in source.missing:
            lacking.setdefault(name, []).append(axis)
    keys = {
        "rotor inertia": "rotor_inertia_kg_m2",
        "Coulomb friction": "coulomb_nm",
        "viscous friction": "viscous_nm_s_rad",
    }
    return [
        *(Finding("info", joints, note) for joints, note in notes_of([source.notes for source in model.sources])),
        *(
            Finding(
                "info",
                ", ".join(f"J{axis}" for axis in axes),
                f"{name} is not in the offset: it is neither identified nor stated",
                f"identify it (record --moving, estimate), or give {keys[name]} of these axes in the cell file",
            )
            for name, axes in lacking.items()
        ),
    ]


# -- curves ------------------------------------------------------------------------------------------------------------


def _series(tracks: Sequence[Track], trend: Trend | None) -> FollowSeries:
    curves = {}
    for track in tracks:
        chosen = _chosen(track)
        curves[track.setting] = ErrorCurve(numbers(track.time_s[chosen]), matrix(track.error_rad[chosen].T))
    fed = next((track for track in tracks if track.setting == IDENTIFIED), None)
    if fed is None or trend is None:
        return FollowSeries(curves)
    weight = np.nan_to_num(np.abs(trend.load_nm)).max(axis=0)
    axes = np.sort(np.argsort(weight)[-DRAWN_AXES:]).tolist()
    return FollowSeries(
        curves,
        tuple(_torque_curve(fed, axis) for axis in axes),
        tuple(_cloud(trend, axis) for axis in axes),
    )


def _torque_curve(track: Track, axis: int) -> TorqueCurve:
    rows = _spread_over(len(track.target_rad), CURVE_POINTS)
    return TorqueCurve(
        axis=axis + 1,
        time_s=numbers(track.time_s[rows]),
        measured_nm=numbers(track.torque_nm[rows, axis]),
        offset_nm=numbers(track.torque_offset_nm[rows, axis]),
    )


def _cloud(trend: Trend, axis: int) -> TrendCloud:
    known = np.flatnonzero(np.isfinite(trend.load_nm[:, axis]))
    rows = known[_spread_over(len(known), CLOUD_POINTS)]
    return TrendCloud(axis + 1, numbers(trend.load_nm[rows, axis]), numbers(trend.residual_nm[rows, axis]))


def _spread_over(count: int, most: int) -> NDArray[np.int_]:
    """Return at most `most` of `count` row indices, evenly spaced."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)


def _chosen(track: Track) -> NDArray[np.int_]:
    """Return the rows of a curve: the largest error of any axis in every short segment, and the peak of every axis.

    Errors are compared in units of the peak of their axis; the peaks of the table are in the curve too.
    """
    error = np.abs(np.nan_to_num(track.error_rad))
    size = (error / np.maximum(error.max(axis=0), 1e-12)).max(axis=1)
    edges = np.unique(np.linspace(0, len(size), min(CURVE_POINTS, len(size)) + 1).astype(int))
    largest = [low + int(np.argmax(size[low:high])) for low, high in zip(edges[:-1], edges[1:], strict=True)]
    return np.union1d(largest, error.argmax(axis=0))
