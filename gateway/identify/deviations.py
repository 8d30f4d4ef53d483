"""Deviation of each rest visit from the prediction fitted to the other visits, by axis.

A deviation in every visit of a pose is an effect of the arm: springs, cables and ripple cancel in the contrasts between
visits of one pose. The load is fitted to contrasts between two loads. Visits without a repeat are compared with a
robust fit of all visits, whose scatter includes the effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.robust import robust_fit
from gateway.model.visits import Visits, column_medians, places_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]


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
#: Relative prior standard deviation of the gains in the contrasts: wide enough for usual errors.
_GAIN_STD: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Deviations (n, N) of half-sums and half-differences, mask of outliers, and scatter (N,) of both halves.

    The scatter is from the contrasts within poses and from the half-differences, which effects of the arm do not
    change.
    """

    sum_nm: Floats
    difference_nm: Floats
    outlier: Mask
    scatter_nm: Floats


def least_scale(visits: Visits, limits: OutlierLimits) -> Floats:
    """Smallest scale (N,) that is accepted as a scatter."""
    count = np.maximum(np.isfinite(visits.sum_nm).sum(axis=0), 1)
    size = np.sqrt(np.nansum(visits.sum_nm**2, axis=0) / count)
    sampled = column_medians(visits.sample_std_nm)
    return np.maximum(np.nan_to_num(sampled), limits.torque_share * size / limits.scales) + 1e-9


def poses_of(q_rad: Floats) -> list[Ints]:
    """Groups of visits with equal joint angles, in the order given; groups may have one visit."""
    place = places_of(q_rad)
    return [np.flatnonzero(place == k) for k in range(int(place.max(initial=-1)) + 1)]


def bands(visits: Visits) -> Floats:
    """Friction band (N,) by the size of the half-differences; NaN where there is none."""
    return column_medians(np.abs(visits.difference_nm))


@dataclass(frozen=True, slots=True, eq=False)
class PoseContrasts:
    """Pairs of visits of one pose: visits `one` and `other` (k,), and gravity rows (k, N, 4 N) of the first."""

    one: Ints
    other: Ints
    rows: Floats


def contrasts_of(visits: Visits, regressor: Floats) -> PoseContrasts:
    """Return the pairs of visits of one pose: one pair of two visits; consecutive pairs, closed in a ring, of more."""
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
    first = np.array(one, dtype=int)
    return PoseContrasts(first, np.array(other, dtype=int), regressor[first])


def deviations(
    visits: Visits, regressor: Floats, pairs: PoseContrasts, without: Mask, least: Floats, limits: OutlierLimits
) -> Deviations:
    """Deviations of every visit; `regressor` (n, N, 4 N) has the gravity rows, last the four columns of a load."""
    model, residual, scale = _whole_fit(visits, regressor, without, least)
    differences = _difference_off(visits.difference_nm, np.abs(model), without, least)
    known = np.where(np.isfinite(differences.scale), differences.scale, 0.0)
    # both halves of a visit have the same noise: a smaller scatter of the half-sums is chance
    least = np.maximum(least, known)
    band = np.nan_to_num(bands(visits))
    repeated = _contrast_off(visits, pairs, without, residual, least, limits)
    alone = repeated.alone & np.isfinite(residual)
    outlier = repeated.outlier | (
        alone & (np.abs(residual) > np.maximum(limits.scales_alone * scale, limits.alone_bands * band))
    )
    sums = np.where(alone, residual, repeated.off_nm)
    far = np.maximum(limits.scales * differences.scale, limits.difference_bands * band)
    outlier |= np.abs(np.nan_to_num(differences.off_nm)) > far
    enough = np.isfinite(visits.sum_nm).sum(axis=0) >= limits.least_rows
    return Deviations(sums, differences.off_nm, outlier & enough, np.hypot(np.nan_to_num(repeated.scatter_nm), known))


def _whole_fit(visits: Visits, regressor: Floats, without: Mask, least: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit links, loads, constants and friction robustly; return model (n, N), residual (n, N) and scale (N,)."""
    use = np.isfinite(visits.sum_nm)
    visit, axis = np.nonzero(use)
    rows = regressor[visit, axis]
    axes = use.shape[1]
    gravity = [rows, *_load_columns(rows, visits.load[visit])]
    own = axis[:, None] == np.arange(axes)
    constants = np.hstack([own.astype(float), own * visits.side[visit, axis][:, None]])
    fit = robust_fit(np.hstack([*gravity, constants]), visits.sum_nm[use], axis, least, ~without[use])
    residual, model = np.full(use.shape, np.nan), np.zeros(use.shape)
    residual[use] = fit.residual
    model[use] = visits.sum_nm[use] - fit.residual
    return model, residual, fit.scale


def _load_columns(rows: Floats, load: NDArray[np.str_]) -> list[Floats]:
    """Columns of each load except the first, which is not separable from the last link."""
    return [rows[:, -4:] * (load == label)[:, None] for label in dict.fromkeys(load.tolist())][1:]


@dataclass(frozen=True, slots=True, eq=False)
class _Repeated:
    off_nm: Floats
    outlier: Mask
    alone: Mask
    scatter_nm: Floats


def _contrast_off(
    visits: Visits, contrasts: PoseContrasts, without: Mask, residual: Floats, least: Floats, limits: OutlierLimits
) -> _Repeated:
    """Return the deviation of each half-sum from the other visits of its pose, without any model of the pose."""
    shape = visits.sum_nm.shape
    one, other = contrasts.one, contrasts.other
    use = np.isfinite(visits.sum_nm[one] - visits.sum_nm[other]) & (visits.side[one] == visits.side[other])
    few = use.sum(axis=0) < limits.least_rows
    use &= ~few
    off, outlier, alone = np.zeros(shape), np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool)
    scatter = np.full(shape[1], np.nan)
    if not use.any():
        return _Repeated(off, outlier, alone, scatter)
    left, scale = _contrast_fit(visits, contrasts, use, without, least)
    scatter = np.where(few, np.nan, scale / np.sqrt(2.0))
    far = np.maximum(limits.scales * scale, limits.sum_bands * np.nan_to_num(bands(visits)))
    for axis in np.flatnonzero(~few):
        at = np.flatnonzero(use[:, axis])
        pairs = np.stack([one[at], other[at]], axis=1)
        value = left[at, axis]
        here = np.unique(pairs)
        alone[here, axis] = False
        signed, members = np.concatenate([value, -value]), pairs.T.ravel()
        nearest = np.lexsort((np.abs(signed), members))
        off[here, axis] = signed[nearest[np.searchsorted(members[nearest], here)]]
        for visit in here[np.abs(off[here, axis]) > far[axis]]:
            partner = pairs[(pairs == visit).any(axis=1)]
            rest = partner[partner != visit]
            outlier[visit, axis] = len(rest) > 1 or abs(residual[visit, axis]) >= abs(residual[rest[0], axis])
    return _Repeated(off, outlier, alone, scatter)


def _contrast_fit(
    visits: Visits, contrasts: PoseContrasts, use: Mask, without: Mask, least: Floats
) -> tuple[Floats, Floats]:
    """Fit the contrasts (k, N) with loads, gains and drifts between loads; return the residual and its scale (N,)."""
    axes, one, other = use.shape[1], contrasts.one, contrasts.other
    contrast, axis = np.nonzero(use)
    first, second = one[contrast], other[contrast]
    rows = contrasts.rows[contrast, axis]
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
    fit = robust_fit(free, target, axis, least, sound)
    if labels:
        # the modelled torque of the load is the column of a gain
        columns = np.hstack([free, own * (target - fit.residual)[:, None]])
        prior_std = np.concatenate([np.full(free.shape[1], np.inf), np.full(axes, _GAIN_STD)])
        fit = robust_fit(columns, target, axis, least, sound, prior_std)
    left = np.full(use.shape, np.nan)
    left[use] = fit.residual
    return left, fit.scale


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    off_nm: Floats
    scale: Floats


def _difference_off(difference_nm: Floats, torque_nm: Floats, without: Mask, least: Floats) -> _Differences:
    """Half-differences less a robust fit of `band + nu |tau|`, and their scale (N,)."""
    off, scale = np.full(difference_nm.shape, np.nan), np.full(len(least), np.inf)
    use = np.isfinite(difference_nm)
    use &= use.sum(axis=0) >= LIMITS.least_rows
    if not use.any():
        return _Differences(off, scale)
    axis = np.nonzero(use)[1]
    own = (axis[:, None] == np.arange(len(least))).astype(float)
    design = np.hstack([own, own * torque_nm[use][:, None]])
    fit = robust_fit(design, difference_nm[use], axis, least, ~without[use])
    off[use] = fit.residual
    seen = use.any(axis=0)
    scale[seen] = fit.scale[seen]
    return _Differences(off, scale)
