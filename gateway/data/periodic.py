"""Position, speed and acceleration over one period of a motion, from its measured positions.

A period ends at its start position, so the positions are a Fourier series. Evenly spaced samples make its harmonics
orthogonal, and least squares over the period is one Fourier transform (Swevers et al., IEEE Trans. Robotics and
Automation 13, 1997). The servo lag differs between start and end.
Therefore the line between the ends is subtracted first and added again afterwards; otherwise its jump causes ringing.
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
    """Joint motion, arrays (n, N): position [rad], speed [rad/s], acceleration [rad/s2]."""

    q_rad: Floats
    qd_rad_s: Floats
    qdd_rad_s2: Floats


def by_harmonics(q_rad: Floats, period_s: float, least: int = 0, delay_s: float = 0.0) -> Kinematics:
    """Fit a Fourier series to one period of positions by least squares and return its motion.

    Parameters
    ----------
    q_rad : array of shape (n, N)
        Measured, evenly spaced over the period, its end left out.
    period_s : float
    least : int
        Minimum number of harmonics: that of the commanded motion.
    delay_s : float
        The returned motion is earlier by this time.
    """
    n = len(q_rad)
    last = max(least, min(int(CUTOFF_HZ * period_s), int(MOST_SHARE * n)))
    kept = np.zeros(n // 2 + 1)
    kept[: min(last, (n - 1) // 2) + 1] = 1.0
    return _filtered(q_rad, period_s, kept, delay_s)


def by_low_pass(q_rad: Floats, period_s: float, delay_s: float = 0.0) -> Kinematics:
    """Filter one period of positions by a zero-phase Gaussian low pass and return its motion.

    Half the power passes at `CUTOFF_HZ`. A Gaussian does not ring at corners. Parameters are those of `by_harmonics`.
    """
    rate = np.arange(len(q_rad) // 2 + 1) / period_s
    return _filtered(q_rad, period_s, np.exp(-0.5 * np.log(2.0) * (rate / CUTOFF_HZ) ** 2), delay_s)


def _filtered(q_rad: Floats, period_s: float, gain: Floats, delay_s: float) -> Kinematics:
    """Return the series with each harmonic multiplied by its gain (n // 2 + 1,), plus the line between the ends."""
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
    """Return the least-squares estimate of the jump (N,) [rad] between the end of a period and its beginning."""
    n = len(q_rad)
    reach = min(max(round(SEAM_S * n / period_s), SMOOTH + 1), n // 2)
    around = np.concatenate([q_rad[-reach:], q_rad[:reach]])
    place = np.arange(-reach, reach) / reach
    columns = np.column_stack([place >= 0, *(place**k for k in range(SMOOTH + 1))])
    return np.linalg.lstsq(columns, around - around[0], rcond=None)[0][0]
