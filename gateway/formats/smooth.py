"""Speeds and accelerations of logged positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

Floats = NDArray[np.float64]


def rates(time_s: Floats, q_rad: Floats, cutoff_hz: float) -> tuple[Floats, Floats]:
    """Speeds and accelerations (n, N) of positions (n, N) at even steps.

    A low pass of second order, run forwards and backwards so that nothing is late; half the power at the cutoff.

    Parameters
    ----------
    time_s : array of shape (n,)
    q_rad : array of shape (n, N)
    cutoff_hz : float
        At or beyond half the sampling rate the positions are taken as they are.
    """
    nyquist_hz = 0.5 / float(np.median(np.diff(time_s)))
    # power behind both runs, with x the cutoff over the corner: 1 / (1 + x^4)^2 = 1/2
    corner_hz = cutoff_hz / (2.0**0.5 - 1.0) ** 0.25
    smooth = q_rad
    if corner_hz < nyquist_hz:
        smooth = sosfiltfilt(butter(2, corner_hz / nyquist_hz, output="sos"), q_rad, axis=0)
    qd = np.gradient(smooth, time_s, axis=0, edge_order=2)
    return qd, np.gradient(qd, time_s, axis=0, edge_order=2)
