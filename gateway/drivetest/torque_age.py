"""Age of the torque word: delay of the measured torque behind the position in the same TPDO.

An axis moves slowly in one direction with a speed that varies at two frequencies, then back. Its torque is
tau(t) = J qdd(t - d) + b qd(t - d) + k q(t - d) + c, with one c per direction. The delay d is fitted with J, b, k and c
by least squares; two frequencies separate it from the viscous friction b.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import savgol_filter
from scipy.stats import t as student

from gateway.drivetest.estimates import CONFIDENCE, not_measured
from gateway.errors import PlanRefused
from gateway.motion.trajectory import Motion
from gateway.motion.workspace import Workspace
from gateway.result.drive_test import TimingFigure

NAME: Final = "torque_age_s"
#: Mean of the speed, and amplitudes of its slow and fast variation [rad/s]: it keeps its sign.
MEAN_RAD_S: Final = 0.0225
SLOW_RAD_S: Final = 0.0075
FAST_RAD_S: Final = 0.0125
#: Highest frequency of the fast variation [rad/s], that of the slow one as a share, share of the limits that is used.
FASTEST_RAD_S: Final = 24.0
SLOW_SHARE: Final = 0.2
SHARE: Final = 0.7
#: Duration in each direction, and of the smooth begin and end [s].
DURATION_S: Final = 3.0
BLEND_S: Final = 0.4
#: Parts of the motion of which each in turn is left out for the standard deviation.
_PARTS: Final = 10
#: Samples slower than this share of the largest speed are left out: friction is not linear there.
_LEAST_SHARE: Final = 0.1
#: Delays that are tried [s].
_DELAYS_S: Final = (-0.03, 0.08)
_GRID_S: Final = 0.002
#: Window in which the positions are smoothed [s], symmetric: it delays nothing.
_WINDOW_S: Final = 0.05
#: A gap between two answers longer than this [SYNC periods] disturbs the motion for some time [s].
_GAP_PERIODS: Final = 1.5
_SETTLE_S: Final = 0.3
#: Residual over the median residual from which on a sample is left out, and how often that is done.
_OUTLIER: Final = 6.0
_REJECTIONS: Final = 2
#: Torque of the acceleration over the residual, both root mean square, below which there is no figure.
_LEAST_SIGNAL: Final = 0.5
#: Part of the delay that the model of the friction may explain wrongly [s].
SYSTEMATIC_S: Final = 0.001
#: The interpolation of the drive shifts the acceleration by up to this share of a SYNC period, to either side.
INTERPOLATION_PERIODS: Final = 0.75
METHOD: Final = (
    "slow motion with a speed that varies at two frequencies; delay of the torque behind the acceleration of the "
    "position in the same TPDO, fitted with inertia and friction; the interpolation of the drive limits the interval"
)


def modulated(workspace: Workspace, start_rad: np.ndarray, joint: int, period_s: float) -> tuple[Motion, Motion]:
    """Return the motion of one joint, forth and back, inside all limits.

    Raises
    ------
    PlanRefused
        There is no free space for it.
    """
    acceleration, jerk = float(workspace.acceleration_rad_s2[joint]), float(workspace.jerk_rad_s3[joint])
    omega = min(FASTEST_RAD_S, SHARE * acceleration / FAST_RAD_S, (SHARE * jerk / FAST_RAD_S) ** 0.5)
    at_s = period_s * np.arange(0, round(DURATION_S / period_s) + 1)
    rise = np.clip(np.minimum(at_s, at_s[-1] - at_s) / BLEND_S, 0.0, 1.0)
    blend = 0.5 - 0.5 * np.cos(np.pi * rise)
    speed = blend * (MEAN_RAD_S + SLOW_RAD_S * np.sin(SLOW_SHARE * omega * at_s) + FAST_RAD_S * np.sin(omega * at_s))
    travel = np.cumsum(0.5 * (speed[1:] + speed[:-1])) * period_s
    inward = -1.0 if start_rad[joint] > (workspace.lower_rad[joint] + workspace.upper_rad[joint]) / 2 else 1.0
    for sign in (inward, -inward):
        line = sign * np.eye(len(start_rad))[joint]
        target = start_rad + travel[-1] * line
        if workspace.path_clear(start_rad[None], target[None])[0]:
            rates = (speed[1:, None] * line, np.gradient(speed, period_s)[1:, None] * line)
            forth = Motion(start_rad + travel[:, None] * line, *rates, period_s)
            return forth, Motion(target - travel[:, None] * line, -rates[0], -rates[1], period_s)
    raise PlanRefused(f"joint {joint + 1} has no free space for {travel[-1]:.3f} rad to either side")


def torque_age(samples: np.ndarray, period_s: float) -> TimingFigure:
    """Return the age of the torque word.

    A drive interpolates between setpoints, so that it accelerates at one instant of each SYNC period. The torque that
    is sampled at the SYNC shows that acceleration shifted by a part of a period, which cannot be separated from the age
    of the word. The interval allows for it. A torque that leads the position by more has no age: that motion was not
    the commanded one.

    Parameters
    ----------
    samples : array of shape (K, 3)
        Of each SYNC of the motion: time [s], position [counts] and torque word, both in any unit.
    period_s : float
        SYNC period.
    """
    time_s, count, torque = samples.T
    window = max(5, 2 * round(_WINDOW_S / period_s / 2.0) + 1)
    if len(time_s) < 6 * window:
        return not_measured(NAME, "too few answers in the motion")
    smooth = np.array(savgol_filter(count, window, 3), dtype=float)
    fits = _Fit(time_s, smooth, torque)
    parts = np.array_split(np.arange(len(time_s)), _PARTS)
    delay_s = fits.best(np.arange(len(time_s)))
    for _ in range(_REJECTIONS):
        fits.reject(delay_s)
        delay_s = fits.best(np.arange(len(time_s)))
    if not fits.follows(delay_s):
        return not_measured(NAME, "the torque word does not follow the acceleration of this axis enough")
    singles = np.array([fits.best(np.setdiff1d(np.arange(len(time_s)), part)) for part in parts])
    number = len(parts)
    std_s = float(np.sqrt((number - 1) / number * np.sum((singles - singles.mean()) ** 2)))  # jackknife
    half = float(student.ppf((1.0 + CONFIDENCE) / 2.0, number - 1)) * std_s
    half += SYSTEMATIC_S
    half += INTERPOLATION_PERIODS * period_s
    if delay_s + half < 0.0:
        return not_measured(NAME, "the torque word leads the acceleration of this axis: it did not move as commanded")
    return TimingFigure(NAME, max(0.0, delay_s), (max(0.0, delay_s - half), delay_s + half), "s", len(time_s), METHOD)


class _Fit:
    """Least squares of the torque over the columns at a delay."""

    def __init__(self, time_s: np.ndarray, count: np.ndarray, torque: np.ndarray) -> None:
        self._time_s, self._torque = time_s - time_s[0], torque
        self._spline = make_interp_spline(self._time_s, count / np.ptp(count), 5)
        self._delays = np.arange(*_DELAYS_S, _GRID_S)
        speed = self._spline(self._time_s, 1)
        inside = (self._time_s > _DELAYS_S[1]) & (self._time_s < self._time_s[-1] + _DELAYS_S[0])
        self._used = (np.abs(speed) > _LEAST_SHARE * np.abs(speed).max()) & inside
        gaps = np.diff(self._time_s)
        for end_s in self._time_s[1:][gaps > _GAP_PERIODS * np.median(gaps)]:
            self._used &= np.abs(self._time_s - end_s) > _SETTLE_S

    def best(self, rows: np.ndarray) -> float:
        """Return the delay with the smallest residual over some rows [s], by a parabola through the grid."""
        chosen = rows[self._used[rows]]
        cost = np.array([self._cost(chosen, delay) for delay in self._delays])
        least = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
        before, here, after = cost[least - 1 : least + 2]
        bend = before - 2.0 * here + after
        return float(self._delays[least] + (0.5 * _GRID_S * (before - after) / bend if bend > 0.0 else 0.0))

    def reject(self, delay_s: float) -> None:
        """Leave out samples that are outliers: contact of a cable, a setpoint that came with a delay."""
        rows = np.flatnonzero(self._used)
        residual = np.abs(self._parts(rows, delay_s)[1])
        self._used[rows[residual > _OUTLIER * np.median(residual)]] = False

    def follows(self, delay_s: float) -> bool:
        """Return whether the delay is inside the grid, and the torque of the acceleration above the residual."""
        rows = np.flatnonzero(self._used)
        if not len(rows):
            return False
        parts, residual = self._parts(rows, delay_s)
        inside = self._delays[1] < delay_s < self._delays[-2]
        return inside and float(np.std(parts[:, 0])) > _LEAST_SIGNAL * float(np.std(residual))

    def _cost(self, rows: np.ndarray, delay_s: float) -> float:
        residual = self._parts(rows, delay_s)[1]
        return float(residual @ residual)

    def _parts(self, rows: np.ndarray, delay_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the torque of each column, acceleration first, and the residual."""
        at = self._time_s[rows] - delay_s
        speed = self._spline(at, 1)
        columns = [self._spline(at, 2), speed, self._spline(at), speed > 0.0, speed < 0.0]
        matrix = np.column_stack([np.asarray(column, dtype=float) for column in columns])
        matrix /= np.linalg.norm(matrix, axis=0) + 1e-12
        parts = matrix * np.linalg.lstsq(matrix, self._torque[rows], rcond=None)[0]
        return parts, self._torque[rows] - parts.sum(axis=1)
