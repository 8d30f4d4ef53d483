"""Noise and sign errors from repeated visits, approach directions and samples, before any fit of a model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.identify.rest.linear import Fit, Noise, RestProblem
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.solve import solve
from gateway.model.visits import column_medians

Floats = NDArray[np.float64]

#: Degrees of freedom from which repeated visits determine a standard deviation to about a third.
FEWEST_REPEATS = 4
#: Standard errors below zero from which a friction band is negative: one healthy axis in three million.
_NEGATIVE_STD = 5.0


def half_difference_scatter(half_nm: Floats, torque_nm: Floats) -> tuple[Floats, Floats]:
    """Return the mean square [Nm2] of half-differences about `band + nu |torque|`, and its degrees of freedom.

    Parameters
    ----------
    half_nm, torque_nm : arrays of shape (n, N)
        NaN where not measured.

    Returns
    -------
    square, freedom : arrays of shape (N,)
        NaN and 0 for an axis with too few half-differences.
    """
    axes = half_nm.shape[1]
    square, freedom = np.full(axes, np.nan), np.zeros(axes)
    for k in range(axes):
        use = np.isfinite(half_nm[:, k]) & np.isfinite(torque_nm[:, k])
        half = half_nm[use, k]
        columns = [np.ones(len(half))]
        if len(half) >= 5:
            columns.append(np.abs(torque_nm[use, k]))
        if len(half) <= len(columns):
            continue
        design = np.stack(columns, axis=1)
        left = solve(design, half, np.ones(len(half))).residual
        freedom[k] = len(half) - len(columns)
        square[k] = float(left @ left) / freedom[k]
    return square, freedom


def repeated_std(torque_nm: Floats, group: NDArray[np.int_], side: Floats) -> Floats:
    """Return the pooled standard deviation (N,) [Nm] of visits that repeat a pose under one load from one side.

    Parameters
    ----------
    torque_nm, side : arrays of shape (n, N)
    group : int array of shape (n,)
        Equal for visits of one pose under one load.

    Returns
    -------
    array of shape (N,)
        NaN below four degrees of freedom.
    """
    out = np.full(torque_nm.shape[1], np.nan)
    for k in range(len(out)):
        use = np.isfinite(torque_nm[:, k])
        value = torque_nm[use, k]
        _, place = np.unique(3 * group[use] + side[use, k].astype(int), return_inverse=True)
        count = np.bincount(place)
        mean = np.bincount(place, weights=value) / np.maximum(count, 1)
        freedom = len(value) - len(count)
        if freedom >= FEWEST_REPEATS:
            out[k] = float(np.sqrt(np.sum((value - mean[place]) ** 2) / freedom))
    return out


def negative_bands(half_nm: Floats) -> NDArray[np.bool_]:
    """Return which friction bands (N,) are negative beyond their noise: torque and direction have opposite signs.

    Friction dissipates energy, so the half-difference in the direction of motion is positive. A band whose sign the
    data do not determine counts as positive.
    """
    out = np.zeros(half_nm.shape[1], dtype=bool)
    for k in range(len(out)):
        half = half_nm[np.isfinite(half_nm[:, k]), k]
        if len(half) > FEWEST_REPEATS:
            out[k] = half.mean() < -_NEGATIVE_STD * half.std(ddof=1) / np.sqrt(len(half)) and np.median(half) < 0.0
    return out


def first_noise(problem: RestProblem) -> Noise:
    """Noise floor per group from the data alone: sides of a visit, repeated visits, averaged samples.

    Both halves of a two-sided visit carry the same asymmetry of friction, so the scatter of the half differences about
    `band + nu |tau|` stands for that of the half sums. Repeated visits of a pose under one load determine it directly.
    """
    rows, axes = problem.rows, problem.axes
    start = np.full(3 * axes, np.nan)
    least = np.full(3 * axes, 1e-9)
    load = np.unique(rows.load, return_inverse=True)[1].ravel()
    repeats = repeated_std(rows.sum_nm, problem.place + (problem.place.max(initial=0) + 1) * load, rows.side)
    halves = np.where(problem.use_difference, rows.difference_nm, np.nan)
    scatter = np.sqrt(half_difference_scatter(halves, rows.sum_nm)[0])
    band = np.nan_to_num(np.abs(column_medians(halves)))
    for axis in range(axes):
        measured = problem.use_sum[:, axis]
        if not measured.any():
            continue
        size = float(np.sqrt(np.mean(rows.sum_nm[measured, axis] ** 2)))
        samples = rows.sample_std_nm[measured, axis]
        quiet = float(np.nanmedian(samples)) if np.isfinite(samples).any() else 0.0
        floor = max(0.5 * quiet, REST_MODEL.relative_floor * size, 1e-9)
        least[[axis, axis + axes, axis + 2 * axes]] = floor
        seen = scatter[axis] if np.isfinite(scatter[axis]) else 0.2 * band[axis]
        start[[axis, axis + axes]] = max(seen, floor)
        start[axis + 2 * axes] = max(quiet, 0.02 * size, floor, _side_unknown(problem, axis, band[axis]))
        repeated = float(repeats[axis])
        if np.isfinite(repeated):
            start[axis] = max(repeated, floor)
            start[axis + 2 * axes] = max(repeated, floor)
    start = np.where(np.isnan(start), 1.0, start)
    return Noise(start, start.copy(), least)


def _side_unknown(problem: RestProblem, axis: int, band_nm: float) -> float:
    """Standard deviation [Nm] due to friction and gear in rows with unknown approach direction; 0 without such rows."""
    rows = problem.rows
    blind = problem.use_sum[:, axis] & ~problem.use_difference[:, axis] & (rows.side[:, axis] == 0)
    if not blind.any():
        return 0.0
    return float(np.sqrt((band_nm**2 + np.mean(rows.gear_nm[blind, axis] ** 2)) / 3.0))


def settled_noise(problem: RestProblem, plain: Fit) -> Noise:
    """Start value of the noise of all hypotheses: that of the approach directions, or of the residual if smaller.

    Half-differences contain structure of friction that half-sums lack; half-sums contain the effects.
    """
    repeated = plain.noise.repeated(problem)
    freedom = problem.by_group(1.0 / repeated) - plain.taken
    left = np.sqrt(problem.by_group(plain.residual**2 / repeated) / np.maximum(freedom, 1.0))
    start = np.where(freedom >= REST_MODEL.noise_weight, np.minimum(plain.noise.start, left), plain.noise.start)
    start = np.maximum(start, plain.noise.least)
    return Noise(start, start.copy(), plain.noise.least, plain.noise.shared, is_settled=True)
