"""Noise and sign errors from repeated visits and half-differences, without a model of the arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.identify.solve import solve

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
        keys = np.stack([group[use].astype(float), side[use, k]], axis=1)
        _, place = np.unique(keys, axis=0, return_inverse=True)
        place = place.ravel()
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
