"""Drift of an arm between two measurements of the same poses under the same load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.visits import SAME_POSE_RAD, Visits
from gateway.result.numerals import half_width
from gateway.result.result import Finding

Floats = NDArray[np.float64]

#: Added to the number of a pose when it is measured a second time.
AGAIN = 1000
#: Least number of poses for a change.
_FEWEST = 3
#: Half of a 95 % interval above which a change counts as unknown, such as of an axis without load.
_LARGEST_HALF = 0.1
#: Significance of a change in halves of its 95 % interval; strict, because twelve changes are tested.
_SIGNIFICANT = 1.5


@dataclass(frozen=True, slots=True)
class AxisDrift:
    """Change of torque and friction of one axis from the first to the second measurement.

    Attributes
    ----------
    joint : counts from 1
    gain, gain_std : of the torque, over the torque
    band, band_std : of the friction band, over the band
    """

    joint: int
    gain: float
    gain_std: float
    band: float
    band_std: float

    @property
    def shows(self) -> bool:
        """Return whether a change of torque or friction is significant."""
        return any(_known(std) and abs(value) > _SIGNIFICANT * half_width(std) for value, std in self.changes)

    @property
    def changes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Changes of torque and friction with their standard deviations."""
        return (self.gain, self.gain_std), (self.band, self.band_std)


def drift_of(visits: Visits) -> tuple[AxisDrift, ...]:
    """Estimate the change of every axis with repeated poses.

    Parameters
    ----------
    visits : Visits
        The second time of a pose has its number and `AGAIN`.
    """
    first = {(visits.load[row], int(visits.pose[row])): row for row in range(len(visits)) if visits.pose[row] < AGAIN}
    pairs = [
        (first[key], row)
        for row in range(len(visits))
        if (key := (visits.load[row], int(visits.pose[row]) - AGAIN)) in first
        and np.abs(visits.q_rad[row] - visits.q_rad[first[key]]).max() < SAME_POSE_RAD
    ]
    if len(pairs) < _FEWEST:
        return ()
    before, after = np.array(pairs).T
    found = []
    for axis in range(visits.sum_nm.shape[1]):
        torque, band = visits.sum_nm[:, axis], visits.difference_nm[:, axis]
        gain = _slope(torque[before], torque[after] - torque[before])
        level = _slope(np.abs(band[before]), np.sign(band[before]) * (band[after] - band[before]))
        found.append(AxisDrift(axis + 1, *gain, *level))
    return tuple(found)


def _slope(size: Floats, change: Floats) -> tuple[float, float]:
    """Slope of change over size through zero by least squares, and its standard deviation from the residual."""
    use = np.isfinite(size) & np.isfinite(change)
    x, y = size[use], change[use]
    power = float(x @ x)
    if use.sum() < _FEWEST or power <= 0.0:
        return float("nan"), float("nan")
    slope = float(x @ y) / power
    left = y - slope * x
    return slope, float(np.sqrt(left @ left / (len(x) - 1) / power))


def drift_findings(drifts: tuple[AxisDrift, ...]) -> tuple[Finding, ...]:
    """Findings on the drift: one per axis with a change, or one that no axis changed."""
    if not drifts:
        return ()
    shown = [one for one in drifts if one.shows]
    if not shown:
        what = "no axis has drifted between the first and the second measurement of the poses"
        return (Finding("info", "drift", what),)
    return tuple(Finding("info", f"J{one.joint}", _said(one)) for one in shown)


def _said(drift: AxisDrift) -> str:
    changed = [
        f"its {what} changed by {100 * value:+.1f} ± {100 * half_width(std):.1f} %"
        for what, (value, std) in zip(("torque", "friction"), drift.changes, strict=True)
        if _known(std)
    ]
    return (
        f"between both measurements {', '.join(changed)}: a change that is linear in time cancels "
        "in this order of the loads"
    )


def _known(std: float) -> bool:
    return bool(half_width(std) < _LARGEST_HALF)
