"""Outliers of rest visits, such as a caught cable, a dragging brake or a touch, from the data alone.

An outlier (visit, axis) is isolated: the same pose under another load or at another time does not have it, nor do
neighbouring poses or the visits before and after. A deviation in every visit of a pose is an effect of the arm and is
not rejected: springs, cables and ripple cancel in the contrasts between visits of one pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.identify.deviations import LIMITS, Deviations, OutlierLimits, bands, contrasts_of, deviations, least_scale
from gateway.model.visits import Visits
from gateway.result.result import Finding, SetAside

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class OutlierEntry:
    """One outlier: axis and visit, deviation in friction bands (NaN without a band), and which half deviates."""

    visit: int
    axis: int
    off_nm: float
    bands: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Outliers:
    """Outliers of a set of rest visits.

    Attributes
    ----------
    entries : torques to reject
    too_many : axes from 0, with the number of deviating visits: too many, or in a row; none of them is rejected
    disturbed : axes from 0, with the scatter of both halves in friction bands; where most axes are, outliers cannot be
        identified and none is rejected
    """

    entries: tuple[OutlierEntry, ...] = ()
    too_many: tuple[tuple[int, int], ...] = ()
    disturbed: tuple[tuple[int, float], ...] = ()

    def mask(self, shape: tuple[int, int]) -> Mask:
        """Mask (n, N) of the outliers."""
        out = np.zeros(shape, dtype=bool)
        for entry in self.entries:
            out[entry.visit, entry.axis] = True
        return out


def find_outliers(visits: Visits, regressor: Floats, limits: OutlierLimits = LIMITS) -> Outliers:
    """Find isolated outliers of rest visits.

    Parameters
    ----------
    visits : Visits
    regressor : array of shape (n, N, 4 N)
        Gravity rows; the last four columns are those of a load.
    limits : OutlierLimits, optional
    """
    none = np.zeros(visits.sum_nm.shape, dtype=bool)
    least = least_scale(visits, limits)
    pairs = contrasts_of(visits, regressor)
    first = deviations(visits, regressor, pairs, none, least, limits)
    # repeat without the outliers found, so that they do not bias the fit
    found = deviations(visits, regressor, pairs, first.outlier, least, limits)
    return _isolated(visits, found, limits)


def _isolated(visits: Visits, found: Deviations, limits: OutlierLimits) -> Outliers:
    """Return the entries without those of axes that have too many of them."""
    band = bands(visits)
    seen = np.isfinite(visits.sum_nm).sum(axis=0)
    count = found.outlier.sum(axis=0)
    many = count > np.ceil(limits.most * seen)
    flagged = np.flatnonzero(found.outlier.any(axis=1))
    spread = _in_a_row(visits, flagged, limits.in_a_row) | found.outlier[:, many].any(axis=1)
    many |= found.outlier[spread].any(axis=0)
    too_many = tuple((int(axis), int(count[axis])) for axis in np.flatnonzero(many))
    where = np.argwhere(found.outlier & ~many)
    entries = tuple(_entry(found, int(visit), int(axis), float(band[axis])) for visit, axis in where)
    disturbed = tuple(
        (int(axis), float(found.scatter_nm[axis] / band[axis]))
        for axis in np.flatnonzero((band > 0) & (found.scatter_nm > limits.disturbed_bands * band))
    )
    if len(disturbed) >= limits.disturbed_axes * max(int((seen > 0).sum()), 1):
        return Outliers(disturbed=disturbed)
    return Outliers(entries, too_many, disturbed)


def _in_a_row(visits: Visits, flagged: Ints, least: int) -> Mask:
    """Mask (n,) of flagged visits (k,) that follow each other in time under one load."""
    out, wanted = np.zeros(len(visits.load), dtype=bool), set(flagged.tolist())
    for label in np.unique(visits.load):
        here = np.flatnonzero(visits.load == label)
        order = here[np.argsort(np.nan_to_num(visits.time_s[here]), kind="stable")]
        row: list[int] = []
        for visit in order.tolist():
            row = [*row, visit] if visit in wanted else []
            if len(row) >= least:
                out[row] = True
    return out


def _entry(found: Deviations, visit: int, axis: int, band_nm: float) -> OutlierEntry:
    middle = float(np.nan_to_num(found.sum_nm[visit, axis]))
    half = float(np.nan_to_num(found.difference_nm[visit, axis]))
    known = np.isfinite(found.difference_nm[visit, axis])
    if not known:
        off, reason = middle, "the torque deviates from the prediction of the other visits"
    elif abs(half) < 0.5 * abs(middle):
        off, reason = (
            middle,
            "both approach directions deviate to the same side, as if a cable or a touch had pushed the joint",
        )
    elif abs(middle) < 0.5 * abs(half):
        off, reason = half, "the approach directions differ by more than friction, as if a brake had held the joint"
    else:
        off, reason = middle + float(np.sign(middle)) * abs(half), "one approach direction deviates"
    return OutlierEntry(visit, axis, off, abs(off) / band_nm if band_nm > 0 else np.nan, reason)


def set_aside(outliers: Outliers, run: Sequence[str], load: Sequence[str], pose: Sequence[int]) -> tuple[SetAside, ...]:
    """Entries of the result for the outliers, with run, load and pose of the n visits."""
    return tuple(
        SetAside(str(run[e.visit]), str(load[e.visit]), e.axis + 1, e.bands, pose=int(pose[e.visit]), reason=e.reason)
        for e in outliers.entries
    )


def outlier_findings(outliers: Outliers, rejected: Sequence[SetAside]) -> tuple[Finding, ...]:
    """Findings on outliers; `rejected` holds the entries from `set_aside`."""
    out = []
    if rejected:
        where = "; ".join(_of_visit(visit, rejected) for visit in dict.fromkeys((a.load, a.pose) for a in rejected))
        out.append(
            Finding(
                "warn", "outliers", f"{_torques(len(rejected))} in no fit: {where}",
                "check what touched or held the arm there; `record` these poses again",
            )
        )  # fmt: skip
    for axis, count in outliers.too_many:
        out.append(
            Finding(
                "warn", f"J{axis + 1}",
                f"{count} visits deviate from the others, too many or too close in time for outliers: none is rejected",
                "`diagnose` says whether a load has shifted or an effect is missing",
            )
        )  # fmt: skip
    if outliers.disturbed:
        what = ", ".join(f"J{axis + 1} {bands:.1f}" for axis, bands in outliers.disturbed)
        out.append(
            Finding(
                "warn", "repeatability",
                f"visits of one pose disagree by more than the friction band ({what} bands): outliers cannot be"
                " identified on these axes",
                "check the wiring of these axes and whether something touches the arm, then record again",
            )
        )  # fmt: skip
    return tuple(out)


def _of_visit(visit: tuple[str, int | None], rejected: Sequence[SetAside]) -> str:
    """Axes of one visit with outliers, and their deviations in bands."""
    load, pose = visit
    here = [each for each in rejected if (each.load, each.pose) == visit]
    axes = ", ".join(dict.fromkeys(f"J{each.joint}" for each in here))
    bands = [each.bands for each in here if np.isfinite(each.bands)]
    by = "" if not bands else f" by {min(bands):.1f}" + (f" to {max(bands):.1f}" if len(bands) > 1 else "") + " bands"
    return f"pose {pose} under {load}, {axes}{by}"


def _torques(count: int) -> str:
    return "1 outlier is" if count == 1 else f"{count} outliers are"
