"""Moving rows as functions of time, to evaluate delayed readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_array, csr_array

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Length of a gap in usual time steps of the run.
_GAP: Final = 5.0
#: Least number of rows of a stretch.
_FEWEST: Final = 8
#: Frequency that half the power of a low pass passes, over the one above which it removes nearly all.
_PASS: Final = 0.5
#: Length of its kernel to either side, in standard deviations of the Gaussian.
_REACH: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Stretches of rows without a gap: indices in time order, and times."""

    parts: tuple[tuple[Ints, Floats], ...]

    @staticmethod
    def of(part: Ints, time_s: Floats) -> Stretches:
        """Divide rows (n,) into stretches by part of a recording and time.

        Rows without a time or in too short a stretch belong to none.
        """
        time = np.asarray(time_s, dtype=float)
        parts: list[tuple[Ints, Floats]] = []
        for number in np.unique(part):
            mine = np.flatnonzero((part == number) & np.isfinite(time))
            mine = mine[np.argsort(time[mine], kind="stable")]
            step = np.diff(time[mine])
            usual = float(np.median(step)) if len(step) else 0.0
            cut = np.flatnonzero((step > _GAP * usual) | (step <= 0.0)) + 1
            parts += [(rows, time[rows]) for rows in np.split(mine, cut) if len(rows) >= _FEWEST]
        return Stretches(tuple(parts))

    def mismatch(self, q_rad: Floats, qd_rad_s: Floats) -> Floats:
        """Difference between position change and integrated speed over the travel, per axis (N,)."""
        square, way = np.zeros((2, q_rad.shape[1]))
        for rows, time in self.parts:
            step = np.diff(q_rad[rows], axis=0)
            said = (qd_rad_s[rows][1:] + qd_rad_s[rows][:-1]) / 2.0 * np.diff(time)[:, None]
            square += ((step - said) ** 2).sum(axis=0)
            way += (step**2).sum(axis=0)
        return np.sqrt(square / np.where(way > 0, way, np.inf))

    def low_pass(self, count: int, cutoff_hz: float) -> csr_array:
        """Gaussian low pass of rows (count,) as a matrix (count, count); rows that are in no stretch stay as they are.

        Torque has frequencies that a filtered motion lacks. Least squares is unbiased if one filter acts on the torque
        and on every column (parallel filtering; Gautier, IEEE ICRA 1997).
        """
        std_s = np.sqrt(np.log(2.0)) / (2.0 * np.pi * _PASS * cutoff_hz)
        alone = np.ones(count, dtype=bool)
        into, of, weight = [], [], []
        for rows, time in self.parts:
            alone[rows] = False
            first, last = (np.searchsorted(time, time + side * _REACH * std_s) for side in (-1.0, 1.0))
            length = last - first
            row = np.repeat(np.arange(len(rows)), length)
            other = np.arange(len(row)) - np.repeat(np.cumsum(length) - length - first, length)
            kernel = np.exp(-0.5 * ((time[other] - time[row]) / std_s) ** 2)
            into.append(rows[row])
            of.append(rows[other])
            weight.append(kernel / np.bincount(row, kernel)[row])
        single = np.flatnonzero(alone)
        row, column = np.concatenate([*into, single]), np.concatenate([*of, single])
        values = np.concatenate([*weight, np.ones(len(single))])
        return coo_array((values, (row, column)), shape=(count, count)).tocsr()

    def earlier(self, values: Floats, delay_s: ArrayLike) -> tuple[Floats, Floats]:
        """Values (n, N) at `delay_s` (N,) earlier, and their rate of change there [1/s].

        Before the first row of a stretch its first value and no change; rows that are in no stretch likewise.
        """
        out, change = values.copy(), np.zeros_like(values)
        delays = np.broadcast_to(np.asarray(delay_s, dtype=float), values.shape[1:])
        for rows, time in self.parts:
            power = CubicSpline(time, values[rows]).c  # (4, pieces, N), highest first
            for axis, delay in enumerate(delays):
                when = np.clip(time - delay, time[0], time[-1])
                piece = np.clip(np.searchsorted(time, when, side="right") - 1, 0, len(time) - 2)
                cubic, square, line, start = power[:, piece, axis]
                past = when - time[piece]
                out[rows, axis] = ((cubic * past + square) * past + line) * past + start
                change[rows, axis] = (3.0 * cubic * past + 2.0 * square) * past + line
        return out, change
