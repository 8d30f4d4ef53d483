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

from gateway.drivetest.estimates import CONFIDENCE
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


def modulated(
    workspace: Workspace, start_rad: np.ndarray, joint: int, period_s: float, override: float = 1.0
) -> tuple[Motion, Motion]:
    """Return the motion of one joint, forth and back, inside all limits, at a speed override.

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
    speed *= override * min(1.0, float(workspace.speed_rad_s[joint]) / (MEAN_RAD_S + SLOW_RAD_S + FAST_RAD_S))
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
    if len(time_s) < 6 * window or not np.ptp(count):
        return TimingFigure(NAME, "too few answers in the motion")
    time_s, smooth = time_s - time_s[0], np.array(savgol_filter(count, window, 3), dtype=float)
    position = make_interp_spline(time_s, smooth / np.ptp(smooth), 5)
    speed, gap_s, delays_s = position(time_s, 1), np.diff(time_s), np.arange(*_DELAYS_S, _GRID_S)
    used = np.abs(speed) > _LEAST_SHARE * np.abs(speed).max()
    used &= (time_s > _DELAYS_S[1]) & (time_s < time_s[-1] + _DELAYS_S[0])
    for end_s in time_s[1:][gap_s > _GAP_PERIODS * np.median(gap_s)]:
        used &= np.abs(time_s - end_s) > _SETTLE_S

    def fit(rows: np.ndarray, delay_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the torque of each column at a delay, acceleration first, and the residual."""
        at_s = time_s[rows] - delay_s
        speed = position(at_s, 1)
        columns = [position(at_s, 2), speed, position(at_s), speed > 0.0, speed < 0.0]
        matrix = np.column_stack([np.asarray(column, dtype=float) for column in columns])
        matrix /= np.linalg.norm(matrix, axis=0) + 1e-12
        torques = matrix * np.linalg.lstsq(matrix, torque[rows], rcond=None)[0]
        return torques, torque[rows] - torques.sum(axis=1)

    def best(rows: np.ndarray) -> float:
        """Return the delay with the smallest residual over some rows [s], by a parabola through the grid."""
        cost = np.array([float(np.sum(fit(rows, delay_s)[1] ** 2)) for delay_s in delays_s])
        least = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
        before, here, after = cost[least - 1 : least + 2]
        bend = before - 2.0 * here + after
        return float(delays_s[least] + (0.5 * _GRID_S * (before - after) / bend if bend > 0.0 else 0.0))

    rows = np.flatnonzero(used)
    if not len(rows):
        return TimingFigure(NAME, "the answers have gaps in the whole motion")
    age_s = best(rows)
    for _ in range(_REJECTIONS):  # contact of a cable, a setpoint that came with a delay
        residual = np.abs(fit(rows, age_s)[1])
        rows = rows[residual <= _OUTLIER * np.median(residual)]
        age_s = best(rows)
    torques, residual = fit(rows, age_s)
    follows = float(np.std(torques[:, 0])) > _LEAST_SIGNAL * float(np.std(residual))
    if not follows or not delays_s[1] < age_s < delays_s[-2]:
        return TimingFigure(NAME, "the torque word does not follow the acceleration of this axis enough")
    parts = np.array_split(np.arange(len(time_s)), _PARTS)
    singles = np.array([best(np.setdiff1d(rows, part)) for part in parts])
    std_s = float(np.sqrt((_PARTS - 1) / _PARTS * np.sum((singles - singles.mean()) ** 2)))  # jackknife
    half = float(student.ppf((1.0 + CONFIDENCE) / 2.0, _PARTS - 1)) * std_s
    half += SYSTEMATIC_S + INTERPOLATION_PERIODS * period_s
    if age_s + half < 0.0:
        return TimingFigure(NAME, "the torque word leads the acceleration of this axis: it did not move as commanded")
    return TimingFigure(NAME, METHOD, max(0.0, age_s), (max(0.0, age_s - half), age_s + half), len(time_s))
