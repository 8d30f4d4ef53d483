"""What an arm has drifted by between two times at which it measured the same poses under the same load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.visits import SAME_POSE_RAD, Visits
from gateway.result.interval import half_width
from gateway.result.result import Finding

Floats = NDArray[np.float64]

#: A pose that is measured a second time has the number of the first time and so much.
AGAIN = 1000
#: Poses that tell a change.
_FEWEST = 3
#: Half of a 95 % interval beyond which a change is not known, as of an axis that carries nothing.
_LARGEST_HALF = 0.1
#: Halves of a 95 % interval from none at which a change is told: twelve are asked for, most of them of few poses.
_TOLD = 1.5
#: The same of the torque of an arm, any axis: 1 % of steady arms with twelve poses.
_SURELY = 2.0


@dataclass(frozen=True, slots=True)
class AxisDrift:
    """Change of one axis from the first to the second time.

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
        """Whether either is told from none."""
        return any(_known(std) and abs(value) > _TOLD * half_width(std) for value, std in self.changes)

    @property
    def gain_shows(self) -> bool:
        """Whether the torque has changed; stricter, since it is asked of all axes at once, from few poses each."""
        return _known(self.gain_std) and abs(self.gain) > _SURELY * half_width(self.gain_std)

    @property
    def changes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Change and standard deviation of the torque and of the friction."""
        return (self.gain, self.gain_std), (self.band, self.band_std)


def drift_of(visits: Visits) -> tuple[AxisDrift, ...]:
    """Change of every axis of which poses were measured twice.

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
    """Change over size by least squares through zero, and its standard deviation by what is left."""
    use = np.isfinite(size) & np.isfinite(change)
    x, y = size[use], change[use]
    power = float(x @ x)
    if use.sum() < _FEWEST or power <= 0.0:
        return float("nan"), float("nan")
    slope = float(x @ y) / power
    left = y - slope * x
    return slope, float(np.sqrt(left @ left / (len(x) - 1) / power))


def is_steady(drifts: tuple[AxisDrift, ...]) -> bool:
    """Whether poses were measured twice and no torque has changed in between."""
    return bool(drifts) and not any(axis.gain_shows for axis in drifts)


def drift_findings(drifts: tuple[AxisDrift, ...]) -> tuple[Finding, ...]:
    """What is said of the drift: a line per axis that shows one, or one that none does."""
    if not drifts:
        return ()
    shown = [one for one in drifts if one.shows]
    if not shown:
        what = "no axis has drifted between the first and the second time that the poses were measured"
        return (Finding("info", "drift", what),)
    return tuple(Finding("info", f"J{one.joint}", _said(one)) for one in shown)


def _said(drift: AxisDrift) -> str:
    changed = [
        f"its {what} changed by {100 * value:+.1f} ± {100 * half_width(std):.1f} %"
        for what, (value, std) in zip(("torque", "friction"), drift.changes, strict=True)
        if _known(std)
    ]
    return f"between both times {', '.join(changed)}: what changes evenly in time cancels in this order of the loads"


def _known(std: float) -> bool:
    return bool(half_width(std) < _LARGEST_HALF)
