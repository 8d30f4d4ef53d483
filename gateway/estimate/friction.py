"""Friction at rest as the estimators see it: bands per axis, and the noise groups of the rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.noise import Groups
from gateway.identify.repeats import half_difference_scatter
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_SEEN_WEIGHT = 6.0
_ONE_SIDED_WEIGHT = 4.0
_TORQUE_SHARE = 0.05


def friction_bands(visits: Visits) -> Floats:
    """Friction band (N,) [Nm]: median of the half differences; NaN where no axis was approached from both sides."""
    seen = np.isfinite(visits.band_nm)
    return np.array(
        [
            abs(float(np.median(visits.band_nm[seen[:, k], k]))) if seen[:, k].any() else np.nan
            for k in range(visits.axes)
        ]
    )


def band_scatter(visits: Visits) -> tuple[Floats, Floats]:
    """Return the scatter of the half-differences of the visits, as `half_difference_scatter`."""
    return half_difference_scatter(visits.band_nm, visits.tau_nm)


def noise_groups(visits: Visits, visit: Ints, axis: Ints) -> Groups:
    """Noise groups of rows (visit, axis): axis for two-sided visits, axis + N for one-sided ones."""
    axes, bands = visits.axes, friction_bands(visits)
    square, freedom = band_scatter(visits)
    one_sided = np.isnan(visits.band_nm[visit, axis])
    index = axis + axes * one_sided
    sampled = visits.tau_std_nm[visit, axis]
    gear = visits.gear_nm[visit, axis] ** 2 / 3.0
    stated = np.where(np.isfinite(sampled), sampled**2, 0.0) + gear
    scale = _scales(visits, bands)
    mean_stated = np.array(
        [
            float(stated[(axis == k) & ~one_sided].mean()) if ((axis == k) & ~one_sided).any() else 0.0
            for k in range(axes)
        ]
    )
    return Groups(
        index=index,
        stated=stated,
        scale_nm=np.concatenate([scale, scale]),
        seen=np.concatenate([square, np.where(np.isfinite(bands), bands**2 / 3.0, np.nan)]),
        seen_stated=np.concatenate([mean_stated, np.zeros(axes)]),
        seen_weight=np.concatenate(
            [np.minimum(freedom, _SEEN_WEIGHT), np.where(np.isfinite(bands), _ONE_SIDED_WEIGHT, 0.0)]
        ),
    )


def _scales(visits: Visits, bands: Floats) -> Floats:
    """Relative size of friction on each axis: its band, or a share of its torque where no band was seen."""
    used = np.isfinite(visits.tau_nm)
    rms = np.array(
        [
            float(np.sqrt(np.mean(visits.tau_nm[used[:, k], k] ** 2))) if used[:, k].any() else 1.0
            for k in range(visits.axes)
        ]
    )
    ratio = bands / np.maximum(rms, 1e-12)
    share = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else _TORQUE_SHARE
    return np.maximum(np.where(np.isfinite(bands), bands, share * rms), 1e-9)
