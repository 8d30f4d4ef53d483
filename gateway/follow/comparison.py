"""Evaluate a comparison of feedforward settings: figures, findings, and data for the pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.feedforward.identified import notes_of
from gateway.feedforward.load import FRAME
from gateway.follow.settings import Prepared
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
from gateway.result.numerals import SAID, with_interval
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
#: Keys of the cell file for terms that may be missing.
KEYS = {
    "rotor inertia": "rotor_inertia_kg_m2",
    "Coulomb friction": "coulomb_nm",
    "viscous friction": "viscous_nm_s_rad",
}
#: Number of axes drawn with torque and trend: those with the largest load torque.
DRAWN_AXES = 2


def result_of(prepared: Prepared, tracks: Sequence[Track]) -> FollowResult:
    """Return a comparison as a result; `tracks` are the recorded passes, one per setting."""
    path, trend = prepared.path, None
    loads: dict[str, FedLoad | None] = {}
    for setting, track in zip(prepared.settings, tracks, strict=True):
        load = setting.load
        loads[setting.name] = (
            None
            if load is None
            else FedLoad(
                label=load.label,
                mass_kg=load.mass_kg,
                mass_std_kg=load.mass_std_kg,
                com_m=numbers(load.com_m),
                frame=FRAME,
                inertia_kg_m2=matrix(load.inertia_kg_m2),
                source=load.source,
                inertia_source=load.inertia_source,
            )
        )
        if setting.name == IDENTIFIED and load is not None:
            trend = load_trend(track, prepared.model, load)
    settings = tuple(following(track, loads[track.setting]) for track in tracks)
    peak = {setting.name: np.array(setting.peak_rad) for setting in settings}
    over_off = {name: numbers(value / peak[OFF]) for name, value in peak.items() if name != OFF and OFF in peak}
    both = IDENTIFIED in peak and MAXIMUM in peak
    times = np.concatenate([track.computing_s[track.computing_s > 0] for track in tracks])
    quantiles = (float(np.median(times)), float(np.percentile(times, 99)), float(times.max())) if len(times) else None
    left_out = sum(int(np.isnan(track.measured_rad).any(axis=1).sum()) for track in tracks)
    return FollowResult(
        robot=prepared.model.robot.name,
        cell=prepared.loaded.cell.name,
        arm=prepared.arm.name,
        path=FollowedPath(path.name, prepared.path_file, path.duration_s, path.period_s),
        settings=settings,
        ratio=PeakRatio(over_off, numbers(peak[IDENTIFIED] / peak[MAXIMUM]) if both else None),
        trend=None if trend is None else trend.values,
        model=FedModel(prepared.model.links_source, prepared.model.sources),
        computing_s=None if quantiles is None else ComputingTime(*quantiles, len(times)),
        left_out_syncs=left_out,
        findings=findings(prepared, tracks, trend, peak, left_out),
        series=_series(tracks, trend),
    )


def findings(
    prepared: Prepared, tracks: Sequence[Track], trend: Trend | None, peak: Mapping[str, Floats], left_out: int
) -> tuple[Finding, ...]:
    """Return the findings, the worst first; `peak` (6,) error of each setting [rad], `left_out` SYNCs of the tracks."""
    found = _load_finding(prepared, trend)
    if OFF in peak and IDENTIFIED in peak:
        what = "follows worse with the identified load than without feedforward"
        advice = "check velocity_share in the drive profile, gear_efficiency and friction of this axis, and the load"
        worse = np.flatnonzero(peak[IDENTIFIED] > peak[OFF] + WORSE_RAD)
        found += [Finding("warn", f"J{axis + 1}", what, advice) for axis in worse]
    found += [
        Finding("info", joints, note) for joints, note in notes_of([axis.notes for axis in prepared.model.sources])
    ]
    found += [
        Finding(
            "info",
            joints,
            f"{name} is not in the offset: it is neither identified nor stated",
            f"identify it (plan --moving, record, estimate), or give {KEYS[name]} of these axes in the cell file",
        )
        for joints, name in notes_of([axis.missing for axis in prepared.model.sources])
    ]
    if left_out:
        total = sum(len(track.target_rad) for track in tracks)
        found.append(
            Finding(
                "info",
                "bus",
                f"{left_out} of {total} SYNCs are left out because an answer was missing, delayed or repeated",
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
    torques: list[TorqueCurve] = []
    clouds: list[TrendCloud] = []
    for axis in np.sort(np.argsort(weight)[-DRAWN_AXES:]).tolist():
        rows = _spread_over(len(fed.target_rad), CURVE_POINTS)
        measured_nm, offset_nm = numbers(fed.torque_nm[rows, axis]), numbers(fed.torque_offset_nm[rows, axis])
        torques.append(TorqueCurve(axis + 1, numbers(fed.time_s[rows]), measured_nm, offset_nm))
        known = np.flatnonzero(np.isfinite(trend.load_nm[:, axis]))
        rows = known[_spread_over(len(known), CLOUD_POINTS)]
        load_nm, residual_nm = numbers(trend.load_nm[rows, axis]), numbers(trend.residual_nm[rows, axis])
        clouds.append(TrendCloud(axis + 1, load_nm, residual_nm))
    return FollowSeries(curves, tuple(torques), tuple(clouds))


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
