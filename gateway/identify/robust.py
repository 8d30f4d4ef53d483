"""Robust regression that rejects the influence of a few outliers."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Ratio of standard deviation to median absolute deviation of a Gaussian.
_MAD: Final = 1.4826
#: Standard deviations above which a row has weight 0 (Tukey's biweight).
_TUKEY: Final = 6.0
_STEPS: Final = 12
#: Convergence: largest change of a residual in the last step, over the scale.
_SETTLED: Final = 0.02
_RANK: Final = 1e-7


def robust_fit(
    design: Floats, target: Floats, group: Ints, least: Floats, sound: Mask, prior_std: Floats | None = None
) -> tuple[Floats, Floats]:
    """Robust regression: least absolute values, then Tukey's biweight with the scatter of each group.

    Parameters
    ----------
    design : array of shape (r, p)
        Of any rank.
    target : array of shape (r,)
    group : int array of shape (r,)
        Axis of each row; each has a scale of its own.
    least : array of shape (g,)
        What no scale falls below.
    sound : bool array of shape (r,)
        Rows that take part; residuals are given for all.
    prior_std : array of shape (p,), optional
        Standard deviation of parameters of mean 0.

    Returns
    -------
    residual (r,), and robust standard deviation (g,) of each group from its inner half
    """
    basis, held = _basis(design, prior_std)
    weight = 1.0 / least[group]
    scale = np.full(len(least), np.inf)
    residual = target
    for bounded in (False, True):
        for _ in range(_STEPS):
            value = _weighted(basis, target, np.where(sound, weight, 0.0), held)
            moved, residual = residual, target - basis @ value
            scale = np.maximum(_scales(residual, group, sound, basis.shape[1], len(least)), least)
            ratio = np.abs(residual) / scale[group]
            if bounded:
                weight = np.maximum(1.0 - (ratio / _TUKEY) ** 2, 0.0) / scale[group]
            else:
                weight = 1.0 / (scale[group] * np.sqrt(np.maximum(ratio, 0.1)))
            if (np.abs(residual - moved) <= _SETTLED * scale[group]).all():
                break
    return residual, scale


def _basis(design: Floats, prior_std: Floats | None) -> tuple[Floats, Floats]:
    """Independent columns (r, k) that span the free ones, then those with a prior, and rows (h, k) of that prior."""
    held = np.zeros(design.shape[1], dtype=bool) if prior_std is None else np.isfinite(prior_std)
    free = design[:, ~held]
    length = np.linalg.norm(free, axis=0)
    free = free / np.where(length > 1e-12 * length.max(initial=0.0), length, 1.0)
    left, size, _ = np.linalg.svd(free, full_matrices=False)
    span = left[:, size > _RANK * size.max(initial=0.0)] if size.max(initial=0.0) > 0 else left[:, :0]
    rows = np.zeros((int(held.sum()), span.shape[1] + int(held.sum())))
    if prior_std is not None:
        rows[:, span.shape[1] :] = np.diag(1.0 / prior_std[held])
    return np.hstack([span, design[:, held]]), rows


def _weighted(basis: Floats, target: Floats, weight: Floats, prior: Floats) -> Floats:
    rows = basis * weight[:, None]
    normal = rows.T @ rows + prior.T @ prior
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / size / size[:, None]
    scaled[np.diag_indices_from(scaled)] += 1e-12
    return np.linalg.solve(scaled, rows.T @ (target * weight) / size) / size


def _scales(residual: Floats, group: Ints, sound: Mask, parameters: int, count: int) -> Floats:
    """Robust standard deviation of each group, corrected for the degrees of freedom of the fit."""
    rows = max(int(sound.sum()), 1)
    freedom = np.sqrt(rows / max(rows - parameters, 0.25 * rows))
    return np.array(
        [
            freedom * _MAD * median(np.abs(residual[sound & (group == k)])) if (sound & (group == k)).any() else np.inf
            for k in range(count)
        ]
    )


def median(values: Floats) -> float:
    """Median; NaN for no values."""
    return float(np.median(values)) if len(values) else np.nan
