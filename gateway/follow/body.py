"""What a comparison of the three settings says, as plain values: figures, findings, and what the pictures are drawn of.

{"schema": 1, "kind": "follow", "robot", "cell", "arm", "path": {"name", "file", "duration_s", "sync_period_s"},
 "settings": [{"name": "off" | "maximum" | "identified", "load": {..} | null, "peak_rad": [6], "rms_rad": [6],
               "lag_s": [6], "overshoot_rad": [6]}],
 "ratio": {"peak_over_off": {NAME: [6]}, "peak_over_maximum": [6]},
 "trend": {"scale", "scale_std", "mass_kg", "mass_std_kg", "com_m", "com_std_m", "rms_nm": [6]} | null,
 "model": {"links", "axes": [{"gear_losses", "rotor_inertia", "coulomb", "viscous", "velocity_share", "missing"}]},
 "computing_s": {"median", "p99", "largest"}, "left_out_syncs": 0,
     "findings": [..], "series": {..}}
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.feedforward.load import FeedLoad
from gateway.follow.path import FollowPath
from gateway.follow.settings import IDENTIFIED, MAXIMUM, OFF, FeedModel, Setting
from gateway.follow.track import Following, Track, following
from gateway.follow.trend import Trend
from gateway.result.result import plain_values

Floats = NDArray[np.float64]
SCHEMA = 1
#: Points of a curve, dots of a cloud.
CURVE_POINTS, CLOUD_POINTS = 360, 260
#: The trend counts as real from this many standard deviations, and matters from these shares on.
SIGMAS = 3.0
NOTED_SHARE, FAILED_SHARE = 0.07, 0.10
#: An axis counts as worse than without feedforward beyond this.
WORSE_RAD = 2e-5
#: Axes of which torque and trend are drawn: those on which the load weighs most.
DRAWN_AXES = 2


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Everything of one job; `tracks` belong to `settings` one by one."""

    robot: str
    cell: str
    arm: str
    path: FollowPath
    path_file: str
    model: FeedModel
    settings: tuple[Setting, ...]
    tracks: tuple[Track, ...]
    trend: Trend | None


def body_of(job: Comparison) -> dict[str, Any]:
    """Plain values of a comparison; NaN becomes null."""
    figures = {track.setting: following(track) for track in job.tracks}
    body = {
        "schema": SCHEMA,
        "kind": "follow",
        "robot": job.robot,
        "cell": job.cell,
        "arm": job.arm,
        "path": {
            "name": job.path.name,
            "file": job.path_file,
            "duration_s": job.path.duration_s,
            "sync_period_s": job.path.period_s,
        },
        "settings": [_setting(setting, figures[setting.name]) for setting in job.settings],
        "ratio": _ratios(figures),
        "trend": None if job.trend is None else _trend(job.trend),
        "model": {
            "links": job.model.links_source,
            "axes": [{**asdict(source), "missing": list(source.missing)} for source in job.model.sources],
        },
        "computing_s": _computing(job.tracks),
        "left_out_syncs": _left_out(job.tracks),
        "findings": findings(job, figures),
        "series": _series(job),
    }
    return plain_values(body)


def _setting(setting: Setting, figures: Following) -> dict[str, Any]:
    return {"name": setting.name, "load": None if setting.load is None else _load(setting.load), **asdict(figures)}


def _load(load: FeedLoad) -> dict[str, Any]:
    return {
        "label": load.label,
        "mass_kg": load.mass_kg,
        "mass_std_kg": load.mass_std_kg,
        "com_m": load.com_m,
        "frame": "link_6",
        "inertia_kg_m2": load.inertia_kg_m2,
        "source": load.source,
        "inertia_source": load.inertia_source,
    }


def _ratios(figures: dict[str, Following]) -> dict[str, Any]:
    peak = {name: item.peak_rad for name, item in figures.items()}
    over_off = {name: value / peak[OFF] for name, value in peak.items() if name != OFF and OFF in peak}
    over_maximum = peak[IDENTIFIED] / peak[MAXIMUM] if IDENTIFIED in peak and MAXIMUM in peak else None
    return {"peak_over_off": over_off, "peak_over_maximum": over_maximum}


def _trend(trend: Trend) -> dict[str, Any]:
    names = ("scale", "scale_std", "mass_kg", "mass_std_kg", "com_m", "com_std_m", "rms_nm")
    return {name: getattr(trend, name) for name in names}


def _computing(tracks: Sequence[Track]) -> dict[str, Any] | None:
    times = np.concatenate([track.computing_s[track.computing_s > 0] for track in tracks])
    if not len(times):
        return None
    return {"median": np.median(times), "p99": np.percentile(times, 99), "largest": times.max(), "count": len(times)}


def _left_out(tracks: Sequence[Track]) -> int:
    return sum(int(np.isnan(track.measured_rad).any(axis=1).sum()) for track in tracks)


def findings(job: Comparison, figures: dict[str, Following]) -> list[dict[str, str]]:
    """What the reader has to know, the worst first."""
    found = [*_load_finding(job), *_worse(figures), *_missing(job.model)]
    if left := _left_out(job.tracks):
        total = sum(len(track.target_rad) for track in job.tracks)
        found.append(_finding("info", "bus", f"{left} of {total} SYNCs are left out: unanswered, late or repeated"))
    order = ("fail", "warn", "info")
    return sorted(found, key=lambda item: order.index(item["severity"]))


def _load_finding(job: Comparison) -> list[dict[str, str]]:
    fed = next((setting.load for setting in job.settings if setting.name == IDENTIFIED), None)
    if fed is None:
        return []
    where = f"load {fed.label}"
    if job.trend is None or not math.isfinite(job.trend.scale_std):
        what = "the path moves too little to tell from the torque whether the load is right"
        return [_finding("warn", where, what, "follow a longer path that lifts and lowers the load")]
    trend = job.trend
    asked = (1.0 + trend.scale) * fed.mass_kg
    said = (
        f"{100 * trend.scale:+.1f} +- {100 * trend.scale_std:.1f} % of its torque is left in the residual: the torque "
        f"asks for {asked:.2f} kg, {fed.mass_kg:.2f} kg was fed"
    )
    proven = abs(trend.scale) > SIGMAS * trend.scale_std
    if not proven or abs(trend.scale) < NOTED_SHARE:
        return [_finding("info", where, f"the torque agrees with the load that was fed ({said})")]
    severity = "fail" if abs(trend.scale) >= FAILED_SHARE else "warn"
    advice = "what hangs there is not what was identified: identify it again, or hang the load that was"
    return [_finding(severity, where, said, advice)]


def _worse(figures: dict[str, Following]) -> list[dict[str, str]]:
    if OFF not in figures or IDENTIFIED not in figures:
        return []
    worse = figures[IDENTIFIED].peak_rad > figures[OFF].peak_rad + WORSE_RAD
    advice = "check velocity_share in the drive profile, gear_efficiency and friction of this axis, and the load"
    return [
        _finding("warn", f"J{axis + 1}", "follows worse with the identified load than without feedforward", advice)
        for axis in np.flatnonzero(worse)
    ]


def _missing(model: FeedModel) -> list[dict[str, str]]:
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
        _finding(
            "info",
            ", ".join(f"J{axis}" for axis in axes),
            f"{name} is not in the offset: it is not given",
            f"give {keys[name]} of these axes in the cell file",
        )
        for name, axes in lacking.items()
    ]


def _finding(severity: str, where: str, what: str, advice: str = "") -> dict[str, str]:
    return {"severity": severity, "where": where, "what": what, "advice": advice}


# -- curves ------------------------------------------------------------------------------------------------------------


def _series(job: Comparison) -> dict[str, Any]:
    curves = {}
    for track in job.tracks:
        chosen = _chosen(track)
        curves[track.setting] = {"time_s": track.time_s[chosen], "error_rad": track.error_rad[chosen].T}
    fed = next((track for track in job.tracks if track.setting == IDENTIFIED), None)
    series: dict[str, Any] = {"error": curves, "torque": [], "trend": []}
    if fed is None or job.trend is None:
        return series
    weight = np.nan_to_num(np.nanmax(np.abs(np.nan_to_num(job.trend.load_nm)), axis=0))
    rows = np.linspace(0, len(fed.target_rad) - 1, min(CURVE_POINTS, len(fed.target_rad))).astype(int)
    for axis in np.sort(np.argsort(weight)[-DRAWN_AXES:]):
        known = np.flatnonzero(np.isfinite(job.trend.load_nm[:, axis]))
        cloud = known[np.linspace(0, len(known) - 1, min(CLOUD_POINTS, len(known))).astype(int)]
        series["torque"].append(
            {
                "axis": int(axis) + 1,
                "time_s": fed.time_s[rows],
                "measured_nm": fed.torque_nm[rows, axis],
                "offset_nm": fed.torque_offset_nm[rows, axis],
            }
        )
        series["trend"].append(
            {
                "axis": int(axis) + 1,
                "load_nm": job.trend.load_nm[cloud, axis],
                "residual_nm": job.trend.residual_nm[cloud, axis],
            }
        )
    return series


def _chosen(track: Track) -> NDArray[np.int_]:
    """Rows of a curve: of every short stretch the row with the largest error of any axis, in units of its peak."""
    error = np.abs(np.nan_to_num(track.error_rad))
    size = (error / np.maximum(error.max(axis=0), 1e-12)).max(axis=1)
    edges = np.unique(np.linspace(0, len(size), min(CURVE_POINTS, len(size)) + 1).astype(int))
    return np.array([low + int(np.argmax(size[low:high])) for low, high in zip(edges[:-1], edges[1:], strict=True)])
