"""Periodic motion: which samples repeat which, the noise between periods, and the motion from measured positions.

Two periods of one excitation under one load have the same motion, arm and model error; they differ by noise alone.

A period ends at its start position, so the positions are a Fourier series. Evenly spaced samples make its harmonics
orthogonal, and least squares over the period is one Fourier transform (Swevers et al., IEEE Trans. Robotics and
Automation 13, 1997). The servo lag differs between start and end.
Therefore the line between the ends is subtracted first and added again afterwards; otherwise its jump causes ringing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, numbered

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Columns of a table that say which excitation a row belongs to (a number), which period, and the time in it [s].
EXCITATION, PERIOD, PHASE_S = "x_excitation", "x_period", "x_phase_s"
#: Column with the frequency up to which the motion of a row was kept [Hz]; the torque has all frequencies.
MOTION_HZ = "x_motion_hz"
#: Minimum number of periods for a noise estimate.
FEWEST = 2
#: Up to here a joint's motion is kept [Hz]: friction at a reversal and the servo move it faster than what was sent.
CUTOFF_HZ: Final = 10.0
#: No harmonic beyond this share of the SYNC rate.
MOST_SHARE: Final = 0.25
#: To either side of where a period ends and begins, the motion is a polynomial of this order for so long [s].
SMOOTH: Final = 3
SEAM_S: Final = 0.06


def repeats(table: Table) -> Mask:
    """Return a mask (n,) of the samples that belong to a period of an excitation."""
    columns = [table.extra.get(name, np.full(len(table), np.nan)) for name in (EXCITATION, PERIOD, PHASE_S)]
    return np.asarray(table.moving & np.isfinite(columns).all(axis=0))


def excitation_runs(table: Table) -> Ints:
    """Return the number (n,) of the excitation and load of each sample, within one file; -1 without excitation."""
    out, rows = np.full(len(table), -1), np.flatnonzero(repeats(table))
    if len(rows):
        file = [table.file[row] for row in rows]
        out[rows] = numbered(file, table.load[rows], table.extra[EXCITATION][rows])[1]
    return out


def uninterrupted(table: Table) -> Ints:
    """Return the number (n,) of the part of a recording that each sample is of: a load, and a period of its excitation.

    A recording that was continued later begins its time again, so times are in order within such a part alone.
    """
    none = np.full(len(table), np.nan)
    marks = (np.nan_to_num(table.extra.get(name, none), nan=-1.0) for name in (EXCITATION, PERIOD))
    return numbered(table.file, table.run, table.load, *marks)[1]


def noise_between_periods(table: Table, turns: Mask) -> Floats:
    """Return the standard deviation (N,) [Nm] of one torque sample from differences between periods; NaN without
    repeats.

    Uses the mean square deviation of each period from the mean of all periods, then the median over the periods, so
    that a disturbed period has no influence; pooled over excitations and loads.

    Parameters
    ----------
    table : Table
    turns : bool array of shape (n, N)
        Where an axis moves. The torque of an axis at rest varies within its friction from period to period.
    """
    squares, counts = np.zeros((2, table.axes))
    for rows in _stacks(table):
        torque, there = table.tau_nm[rows], turns[rows].all(axis=0)
        spread = np.where(there, torque - torque.mean(axis=0), 0.0)
        instants = there.sum(axis=0)
        each = (spread**2).sum(axis=1) / np.maximum(instants, 1) * len(rows) / (len(rows) - 1)
        squares += np.nan_to_num(np.median(each, axis=0) * instants)
        counts += np.where(np.isfinite(each).all(axis=0), instants, 0)
    return np.sqrt(np.divide(squares, counts, out=np.full(table.axes, np.nan), where=counts > 0))


def _stacks(table: Table) -> Iterator[Ints]:
    """Yield the sample indices (periods, instants) of every excitation and load with at least two periods."""
    runs = excitation_runs(table)
    for number in range(runs.max(initial=-1) + 1):
        mine = np.flatnonzero(runs == number)
        period = table.extra[PERIOD][mine]
        parts = [mine[period == value] for value in np.unique(period)]
        parts = [part[np.argsort(table.extra[PHASE_S][part], kind="stable")] for part in parts]
        length = int(np.median([len(part) for part in parts]))
        complete = [part for part in parts if len(part) == length]
        if len(complete) >= FEWEST:
            yield np.array(complete)


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
