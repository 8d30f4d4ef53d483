"""Position, speed and acceleration of one period of a motion, from its measured positions; pure numerics.

A period ends where it began, so its positions are a Fourier series; evenly spaced samples make its harmonics
orthogonal, and least squares over the whole period is one transform (Swevers et al., IEEE Trans. Robotics and
Automation 13, 1997). The tail of what the servo lags is another one at the beginning than at the end: a straight line
between the ends is taken off first and put back afterwards, so that its jump does not ring through the derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Up to here a joint's motion is kept [Hz]: friction at a reversal and the servo move it faster than what was sent.
CUTOFF_HZ: Final = 10.0
#: No harmonic beyond this share of the SYNC rate.
MOST_SHARE: Final = 0.25
#: To either side of where a period ends and begins, the motion is a polynomial of this order for so long [s].
SMOOTH: Final = 3
SEAM_S: Final = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """Arrays of shape (n, N): position [rad], speed [rad/s], acceleration [rad/s2]."""

    q_rad: Floats
    qd_rad_s: Floats
    qdd_rad_s2: Floats


def by_harmonics(q_rad: Floats, period_s: float, least: int = 0, delay_s: float = 0.0) -> Kinematics:
    """Least squares of a Fourier series over one period.

    Parameters
    ----------
    q_rad : array of shape (n, N)
        Measured, evenly spaced over the period, its end left out.
    period_s : float
    least : int
        Harmonics that are kept at least: those that were sent.
    delay_s : float
        The result is that of so much earlier.
    """
    n = len(q_rad)
    last = max(least, min(int(CUTOFF_HZ * period_s), int(MOST_SHARE * n)))
    kept = np.zeros(n // 2 + 1)
    kept[: min(last, (n - 1) // 2) + 1] = 1.0
    return _filtered(q_rad, period_s, kept, delay_s)


def by_low_pass(q_rad: Floats, period_s: float, delay_s: float = 0.0) -> Kinematics:
    """Zero-phase low pass of one period, half the power at `CUTOFF_HZ`: a Gaussian, which does not ring at corners.

    Parameters are those of `by_harmonics`.
    """
    rate = np.arange(len(q_rad) // 2 + 1) / period_s
    return _filtered(q_rad, period_s, np.exp(-0.5 * np.log(2.0) * (rate / CUTOFF_HZ) ** 2), delay_s)


def _filtered(q_rad: Floats, period_s: float, gain: Floats, delay_s: float) -> Kinematics:
    """Series with each harmonic times its gain (n // 2 + 1,), and the straight line between the ends."""
    n = len(q_rad)
    ramp = (np.arange(n) - 0.5 * (n - 1)) / n
    slope = -_jump(q_rad, period_s)
    part = gain[:, None] * np.fft.rfft(q_rad - ramp[:, None] * slope, axis=0)
    rate = 2j * np.pi * np.arange(len(gain))[:, None] / period_s
    if n % 2 == 0:
        rate[-1] = 0.0
    part = part * np.exp(-rate * delay_s)
    along = ramp[:, None] - delay_s / period_s
    return Kinematics(
        np.fft.irfft(part, n, axis=0) + along * slope,
        np.fft.irfft(rate * part, n, axis=0) + slope / period_s,
        np.fft.irfft(rate**2 * part, n, axis=0),
    )


def _jump(q_rad: Floats, period_s: float) -> Floats:
    """How far each joint (N,) is farther at the beginning of a period than its end leads to, by least squares."""
    n = len(q_rad)
    reach = min(max(round(SEAM_S * n / period_s), SMOOTH + 1), n // 2)
    around = np.concatenate([q_rad[-reach:], q_rad[:reach]])
    place = np.arange(-reach, reach) / reach
    columns = np.column_stack([place >= 0, *(place**k for k in range(SMOOTH + 1))])
    return np.linalg.lstsq(columns, around - around[0], rcond=None)[0][0]
