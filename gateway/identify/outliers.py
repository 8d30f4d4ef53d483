"""Outliers of rest visits, such as a caught cable, a dragging brake or a touch, from the data alone.

An outlier (visit, axis) is isolated: the same pose under another load or at another time does not have it, nor do
neighbouring poses or the visits before and after. A deviation in every visit of a pose is an effect of the arm and is
not rejected: springs, cables and ripple cancel in the contrasts between visits of one pose. The load is fitted to
contrasts between two loads. Visits without a repeat are compared with a robust fit of all visits, whose scatter
includes the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.robust import robust_fit
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits, column_medians, places_of
from gateway.result.result import Finding, SetAside

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Relative prior standard deviation of the gains in the contrasts: wide enough for usual errors.
_GAIN_STD: Final = 0.1


@dataclass(frozen=True, slots=True)
class OutlierLimits:
    """Limits of an outlier. Origin: simulated arms of seeds 0 to 199, with and without effects and outliers."""

    #: Least deviation of an outlier, in robust standard deviations.
    scales: float = 7.0
    #: The same for a pose that is visited once: the scatter contains smooth effects.
    scales_alone: float = 9.0
    #: Least deviation in friction bands: of a half-sum, of a half-difference.
    sum_bands: float = 0.7
    difference_bands: float = 0.7
    #: The same of a half-sum without another visit of its pose.
    alone_bands: float = 1.5
    #: Share of the axis torque below which nothing is an outlier, if friction and noise are unknown.
    torque_share: float = 2e-3
    #: Largest share of the visits of an axis that may be rejected.
    most: float = 0.1
    #: Number of consecutive visits of one load that count as a change instead of outliers.
    in_a_row: int = 3
    #: Least number of rows of an axis for a decision.
    least_rows: int = 5
    #: Scatter of both halves over the friction band above which all visits of an axis count as disturbed.
    disturbed_bands: float = 1.0
    #: Share of disturbed axes above which nothing is rejected.
    disturbed_axes: float = 0.5


LIMITS: Final = OutlierLimits()


def least_scale(visits: Visits) -> Floats:
    """Smallest scale (N,) that is accepted as a scatter."""
    count = np.maximum(np.isfinite(visits.sum_nm).sum(axis=0), 1)
    size = np.sqrt(np.nansum(visits.sum_nm**2, axis=0) / count)
    sampled = column_medians(visits.sample_std_nm)
    return np.maximum(np.nan_to_num(sampled), LIMITS.torque_share * size / LIMITS.scales) + 1e-9


def poses_of(q_rad: Floats) -> list[Ints]:
    """Groups of visits with equal joint angles, in the order given; groups may have one visit."""
    place = places_of(q_rad)
    return [np.flatnonzero(place == k) for k in range(int(place.max(initial=-1)) + 1)]


def bands(visits: Visits) -> Floats:
    """Friction band (N,) by the size of the half-differences; NaN where there is none."""
    return column_medians(np.abs(visits.difference_nm))


def contrasts_of(visits: Visits) -> tuple[Ints, Ints]:
    """Return the visits (k,) of each pair of one pose: one pair of two visits; consecutive ones, in a ring, of more."""
    one: list[int] = []
    other: list[int] = []
    for group in poses_of(visits.q_rad):
        if len(group) < 2:
            continue
        order = group[np.argsort(np.nan_to_num(visits.time_s[group]), kind="stable")]
        following = np.roll(order, -1)
        count = 1 if len(order) == 2 else len(order)
        one += order[:count].tolist()
        other += following[:count].tolist()
    return np.array(one, dtype=int), np.array(other, dtype=int)


def deviations(
    visits: Visits, regressor: Floats, pairs: tuple[Ints, Ints], without: Mask, least: Floats
) -> tuple[Floats, Floats, Mask, Floats]:
    """Deviations (n, N) of half-sums and half-differences, mask of outliers, and scatter (N,) of both halves.

    The scatter is from the contrasts within poses and from the half-differences, which effects of the arm do not
    change. `regressor` (n, N, 4 N) has the gravity rows, last the four columns of a load; `pairs` are visits of one
    pose; visits `without` (n, N) take part in no fit.
    """
    model, residual, scale = _whole_fit(visits, regressor, without, least)
    difference_off, difference_scale = _difference_off(visits.difference_nm, np.abs(model), without, least)
    known = np.where(np.isfinite(difference_scale), difference_scale, 0.0)
    # both halves of a visit have the same noise: a smaller scatter of the half-sums is chance
    least = np.maximum(least, known)
    band = np.nan_to_num(bands(visits))
    repeated_off, outlier, alone, scatter = _contrast_off(visits, regressor, pairs, without, residual, least)
    alone &= np.isfinite(residual)
    outlier |= alone & (np.abs(residual) > np.maximum(LIMITS.scales_alone * scale, LIMITS.alone_bands * band))
    sums = np.where(alone, residual, repeated_off)
    far = np.maximum(LIMITS.scales * difference_scale, LIMITS.difference_bands * band)
    outlier |= np.abs(np.nan_to_num(difference_off)) > far
    enough = np.isfinite(visits.sum_nm).sum(axis=0) >= LIMITS.least_rows
    return sums, difference_off, outlier & enough, np.hypot(np.nan_to_num(scatter), known)


def _whole_fit(visits: Visits, regressor: Floats, without: Mask, least: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit links, loads, constants and friction robustly; return model (n, N), residual (n, N) and scale (N,)."""
    use = np.isfinite(visits.sum_nm)
    visit, axis = np.nonzero(use)
    rows = regressor[visit, axis]
    axes = use.shape[1]
    gravity = [rows, *_load_columns(rows, visits.load[visit])]
    own = axis[:, None] == np.arange(axes)
    constants = np.hstack([own.astype(float), own * visits.side[visit, axis][:, None]])
    left, scale = robust_fit(np.hstack([*gravity, constants]), visits.sum_nm[use], axis, least, ~without[use])
    residual, model = np.full(use.shape, np.nan), np.zeros(use.shape)
    residual[use] = left
    model[use] = visits.sum_nm[use] - left
    return model, residual, scale


def _load_columns(rows: Floats, load: NDArray[np.str_]) -> list[Floats]:
    """Columns of each load except the first, which is not separable from the last link."""
    return [rows[:, -4:] * (load == label)[:, None] for label in dict.fromkeys(load.tolist())][1:]


def _contrast_off(
    visits: Visits, regressor: Floats, pairs: tuple[Ints, Ints], without: Mask, residual: Floats, least: Floats
) -> tuple[Floats, Mask, Mask, Floats]:
    """Return the deviation (n, N) of each half-sum from the other visits of its pose, without any model of the pose.

    Then masks (n, N) of the outliers, and of half-sums without another visit of their pose, and the scatter (N,).
    """
    shape = visits.sum_nm.shape
    one, other = pairs
    use = np.isfinite(visits.sum_nm[one] - visits.sum_nm[other]) & (visits.side[one] == visits.side[other])
    few = use.sum(axis=0) < LIMITS.least_rows
    use &= ~few
    off, outlier, alone = np.zeros(shape), np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool)
    scatter = np.full(shape[1], np.nan)
    if not use.any():
        return off, outlier, alone, scatter
    left, scale = _contrast_fit(visits, regressor, pairs, use, without, least)
    scatter = np.where(few, np.nan, scale / np.sqrt(2.0))
    far = np.maximum(LIMITS.scales * scale, LIMITS.sum_bands * np.nan_to_num(bands(visits)))
    for axis in np.flatnonzero(~few):
        at = np.flatnonzero(use[:, axis])
        both = np.stack([one[at], other[at]], axis=1)
        value = left[at, axis]
        here = np.unique(both)
        alone[here, axis] = False
        signed, members = np.concatenate([value, -value]), both.T.ravel()
        nearest = np.lexsort((np.abs(signed), members))
        off[here, axis] = signed[nearest[np.searchsorted(members[nearest], here)]]
        for visit in here[np.abs(off[here, axis]) > far[axis]]:
            partner = both[(both == visit).any(axis=1)]
            rest = partner[partner != visit]
            outlier[visit, axis] = len(rest) > 1 or abs(residual[visit, axis]) >= abs(residual[rest[0], axis])
    return off, outlier, alone, scatter


def _contrast_fit(
    visits: Visits, regressor: Floats, pairs: tuple[Ints, Ints], use: Mask, without: Mask, least: Floats
) -> tuple[Floats, Floats]:
    """Fit the contrasts (k, N) with loads, gains and drifts between loads; return the residual and its scale (N,)."""
    axes, (one, other) = use.shape[1], pairs
    contrast, axis = np.nonzero(use)
    first, second = one[contrast], other[contrast]
    rows = regressor[first, axis]
    labels = list(dict.fromkeys(visits.load.tolist()))[1:]
    member = [((visits.load[first] == name).astype(float) - (visits.load[second] == name))[:, None] for name in labels]
    own = (axis[:, None] == np.arange(axes)).astype(float)
    target = (visits.sum_nm[one] - visits.sum_nm[other])[use]
    sound = ~(without[one] | without[other])[use]
    loads = [rows[:, -4:] * each for each in member]
    shifts = [own * each for each in member]
    if not labels:
        loads, shifts = [np.zeros((len(axis), 1))], []
    free = np.hstack([*loads, *shifts])
    residual, scale = robust_fit(free, target, axis, least, sound)
    if labels:
        # the modelled torque of the load is the column of a gain
        columns = np.hstack([free, own * (target - residual)[:, None]])
        prior_std = np.concatenate([np.full(free.shape[1], np.inf), np.full(axes, _GAIN_STD)])
        residual, scale = robust_fit(columns, target, axis, least, sound, prior_std)
    left = np.full(use.shape, np.nan)
    left[use] = residual
    return left, scale


def _difference_off(difference_nm: Floats, torque_nm: Floats, without: Mask, least: Floats) -> tuple[Floats, Floats]:
    """Half-differences less a robust fit of `band + nu |tau|`, and their scale (N,)."""
    off, scale = np.full(difference_nm.shape, np.nan), np.full(len(least), np.inf)
    use = np.isfinite(difference_nm)
    use &= use.sum(axis=0) >= LIMITS.least_rows
    if not use.any():
        return off, scale
    axis = np.nonzero(use)[1]
    own = (axis[:, None] == np.arange(len(least))).astype(float)
    design = np.hstack([own, own * torque_nm[use][:, None]])
    off[use], fitted = robust_fit(design, difference_nm[use], axis, least, ~without[use])
    seen = use.any(axis=0)
    scale[seen] = fitted[seen]
    return off, scale


@dataclass(frozen=True, slots=True, eq=False)
class Outliers:
    """Rejected torques of rest visits: mask (n, N), their entries in the result, and findings."""

    mask: Mask
    entries: tuple[SetAside, ...] = ()
    findings: tuple[Finding, ...] = ()

    def among(self, first: int) -> tuple[SetAside, ...]:
        """Return the rejected torques of the visits from `first` on."""
        visits = np.argwhere(self.mask)[:, 0]
        return tuple(entry for entry, visit in zip(self.entries, visits, strict=True) if visit >= first)


def without_outliers(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> tuple[Visits, Outliers]:
    """Return the visits with outliers marked as not measured, and the outliers."""
    outliers = find_outliers(visits, robot, gravity_m_s2)
    return visits.unmeasured(outliers.mask), outliers


def find_outliers(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> Outliers:
    """Find isolated outliers of rest visits, from the visits alone.

    None is rejected on an axis with too many of them or several in a row, nor where most axes are disturbed: there
    outliers cannot be identified.
    """
    regressor = gravity_regressor(robot, visits.q_rad, gravity_m_s2)
    none = np.zeros(visits.sum_nm.shape, dtype=bool)
    least = least_scale(visits)
    pairs = contrasts_of(visits)
    outlier = deviations(visits, regressor, pairs, none, least)[2]
    # repeat without the outliers found, so that they do not bias the fit
    sum_nm, difference_nm, outlier, scatter_nm = deviations(visits, regressor, pairs, outlier, least)
    band = bands(visits)
    seen = np.isfinite(visits.sum_nm).sum(axis=0)
    count = outlier.sum(axis=0)
    many = count > np.ceil(LIMITS.most * seen)
    flagged = np.flatnonzero(outlier.any(axis=1))
    spread = _in_a_row(visits, flagged, LIMITS.in_a_row) | outlier[:, many].any(axis=1)
    many |= outlier[spread].any(axis=0)
    rejected = outlier & ~many
    disturbed = np.flatnonzero((band > 0) & (scatter_nm > LIMITS.disturbed_bands * band))
    if len(disturbed) >= LIMITS.disturbed_axes * max(int((seen > 0).sum()), 1):
        rejected, many = none, np.zeros(len(many), dtype=bool)
    entries = tuple(
        _entry(visits, visit, axis, float(sum_nm[visit, axis]), float(difference_nm[visit, axis]), float(band[axis]))
        for visit, axis in np.argwhere(rejected).tolist()
    )
    findings: list[Finding] = []
    if entries:
        where = "; ".join(_of_visit(visit, entries) for visit in dict.fromkeys((a.load, a.pose) for a in entries))
        torques = "1 outlier is" if len(entries) == 1 else f"{len(entries)} outliers are"
        findings.append(
            Finding(
                "warn", "outliers", f"{torques} in no fit: {where}",
                "check what touched or held the arm there; `record` these poses again",
            )
        )  # fmt: skip
    findings += [
        Finding(
            "warn", f"J{axis + 1}",
            f"{count[axis]} visits deviate from the others, too many or too close in time for outliers: none is"
            " rejected",
            "a load may have shifted, or the model lacks an effect",
        )
        for axis in np.flatnonzero(many)
    ]  # fmt: skip
    if len(disturbed):
        what = ", ".join(f"J{axis + 1} {scatter_nm[axis] / band[axis]:.1f}" for axis in disturbed)
        findings.append(
            Finding(
                "warn", "repeatability",
                f"visits of one pose disagree by more than the friction band ({what} bands): outliers cannot be"
                " identified on these axes",
                "check the wiring of these axes and whether something touches the arm, then record again",
            )
        )  # fmt: skip
    return Outliers(rejected, entries, tuple(findings))


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


def _entry(visits: Visits, visit: int, axis: int, sum_nm: float, difference_nm: float, band_nm: float) -> SetAside:
    """Entry of the result: deviation in friction bands (NaN without a band), and which half deviates."""
    middle, half = float(np.nan_to_num(sum_nm)), float(np.nan_to_num(difference_nm))
    known = np.isfinite(difference_nm)
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
    return SetAside(
        run=str(visits.run[visit]),
        load=str(visits.load[visit]),
        joint=axis + 1,
        bands=abs(off) / band_nm if band_nm > 0 else np.nan,
        pose=int(visits.pose[visit]),
        reason=reason,
    )


def _of_visit(visit: tuple[str, int | None], rejected: Sequence[SetAside]) -> str:
    """Axes of one visit with outliers, and their deviations in bands."""
    load, pose = visit
    here = [each for each in rejected if (each.load, each.pose) == visit]
    axes = ", ".join(dict.fromkeys(f"J{each.joint}" for each in here))
    bands = [each.bands for each in here if np.isfinite(each.bands)]
    by = "" if not bands else f" by {min(bands):.1f}" + (f" to {max(bands):.1f}" if len(bands) > 1 else "") + " bands"
    return f"pose {pose} under {load}, {axes}{by}"
