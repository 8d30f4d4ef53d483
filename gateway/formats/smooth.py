"""Clock of a log, and speeds and accelerations from its positions.

A logger samples at a constant rate, but its time stamps have jitter, and samples are lost. Differences over such
stamps have relative errors of jitter over step, and a digital filter requires even steps. Therefore a straight clock
t = start + step * k is fitted to the stamps. The positions are filtered and differentiated on its grid. If the data
are smoother over the stamps than over the clock, the arm was sampled at the stamped times, and the positions are
interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

Floats = NDArray[np.float64]
#: How much of the difference between a stamp and the expected one is taken over into the expectation of the next.
_FOLLOWS = 0.1
#: The stamps are of the samples themselves where the positions are so much smoother over them than over the clock.
_SMOOTHER = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """Straight clock fitted to time stamps.

    Attributes
    ----------
    index : int array of shape (n,)
        Number of each sample, from 0; missing numbers are lost samples.
    start_s, step_s : float
    jitter_s : array of shape (n,)
        Stamp minus clock.
    """

    index: NDArray[np.int64]
    start_s: float
    step_s: float
    jitter_s: Floats

    @property
    def time_s(self) -> Floats:
        """Return the time of each sample (n,)."""
        return self.start_s + self.step_s * self.index.astype(float)

    @property
    def lost(self) -> int:
        """Number of samples lost between the first and the last."""
        return int(self.index[-1]) + 1 - len(self.index)


def clock_of(stamp_s: Floats) -> Clock:
    """Fit a straight clock to increasing time stamps (n,), n >= 3."""
    step_s = float(np.median(np.diff(stamp_s)))
    index, expected_s = [0], float(stamp_s[0])
    for at_s in stamp_s[1:].tolist():
        steps = max(1, round((at_s - expected_s) / step_s))
        index.append(index[-1] + steps)
        expected_s += steps * step_s
        expected_s += _FOLLOWS * (at_s - expected_s)
    number = np.array(index)
    step_s, start_s = np.polyfit(number, stamp_s, 1).tolist()
    return Clock(number, start_s, step_s, stamp_s - start_s - step_s * number)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedMotion:
    """Time (n,), speeds and accelerations (n, N) of logged positions, and the fitted clock.

    `is_at_stamps`: the positions agree with the stamps, so that these are the times; else those of the clock are.
    """

    time_s: Floats
    qd_rad_s: Floats
    qdd_rad_s2: Floats
    clock: Clock
    is_at_stamps: bool


def motion_of(stamp_s: Floats, q_rad: Floats, cutoff_hz: float) -> SmoothedMotion:
    """Compute speeds and accelerations of positions (n, N) logged at nearly even steps.

    Parameters
    ----------
    stamp_s : array of shape (n,)
        Increasing.
    q_rad : array of shape (n, N)
    cutoff_hz : float
        As `rates`.
    """
    clock = clock_of(stamp_s)
    grid_s = clock.start_s + clock.step_s * np.arange(clock.index[-1] + 1)
    at_clock, at_stamps = (_at(time_s, q_rad, grid_s) for time_s in (clock.time_s, stamp_s))
    if _roughness(at_stamps) < _SMOOTHER * _roughness(at_clock):
        qd, qdd = (_at(grid_s, each, stamp_s) for each in rates(grid_s, at_stamps, cutoff_hz))
        return SmoothedMotion(stamp_s, qd, qdd, clock, True)
    qd, qdd = rates(grid_s, at_clock, cutoff_hz)
    return SmoothedMotion(clock.time_s, qd[clock.index], qdd[clock.index], clock, False)


def _at(time_s: Floats, values: Floats, wanted_s: Floats) -> Floats:
    """Interpolate values (n, N) at other times by a cubic spline."""
    return np.asarray(make_interp_spline(time_s, values, k=3)(wanted_s), dtype=float)


def _roughness(values: Floats) -> float:
    """Return the residual size of evenly spaced values (n, N) after a cubic through four neighbours."""
    return float(np.sqrt((np.diff(values, 4, axis=0) ** 2).sum()))


def rates(time_s: Floats, q_rad: Floats, cutoff_hz: float) -> tuple[Floats, Floats]:
    """Compute speeds and accelerations (n, N) of positions (n, N) at even steps.

    Uses a second-order low pass forwards and backwards (zero phase), half power at the cutoff.

    Parameters
    ----------
    time_s : array of shape (n,)
    q_rad : array of shape (n, N)
    cutoff_hz : float
        At or above half the sampling rate the positions are not filtered.
    """
    nyquist_hz = 0.5 / float(np.median(np.diff(time_s)))
    # power behind both runs, with x the cutoff over the corner: 1 / (1 + x^4)^2 = 1/2
    corner_hz = cutoff_hz / (2.0**0.5 - 1.0) ** 0.25
    smooth = q_rad
    if corner_hz < nyquist_hz:
        smooth = sosfiltfilt(butter(2, corner_hz / nyquist_hz, output="sos"), q_rad, axis=0)
    qd = np.gradient(smooth, time_s, axis=0, edge_order=2)
    return qd, np.gradient(qd, time_s, axis=0, edge_order=2)
