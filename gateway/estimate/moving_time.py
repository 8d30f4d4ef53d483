"""Moving rows as functions of time: what an axis would have reported a little earlier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Steps of a run's usual length that make a gap.
_GAP: Final = 5.0
#: Rows that a stretch needs to be a function of time.
_FEWEST: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Rows without a gap: for each, where its rows stand in the order of time, and their times."""

    parts: tuple[tuple[Ints, Floats], ...]

    @staticmethod
    def of(run: Sequence[str] | NDArray[np.str_], time_s: Floats) -> Stretches:
        """Stretches of rows (n,) by run and time; rows without a time, or of too short a stretch, are in none."""
        names, time = np.asarray(run), np.asarray(time_s, dtype=float)
        parts: list[tuple[Ints, Floats]] = []
        for name in np.unique(names):
            mine = np.flatnonzero((names == name) & np.isfinite(time))
            mine = mine[np.argsort(time[mine], kind="stable")]
            step = np.diff(time[mine])
            usual = float(np.median(step)) if len(step) else 0.0
            cut = np.flatnonzero((step > _GAP * usual) | (step <= 0.0)) + 1
            parts += [(rows, time[rows]) for rows in np.split(mine, cut) if len(rows) >= _FEWEST]
        return Stretches(tuple(parts))

    @property
    def step_s(self) -> float:
        """Usual time between two rows [s]; NaN where there is no stretch."""
        return float(np.median([np.median(np.diff(time)) for _, time in self.parts])) if self.parts else np.nan

    def earlier(self, values: Floats, delay_s: ArrayLike) -> tuple[Floats, Floats]:
        """Values (n, N) by `delay_s` (N,) earlier, and how they changed then [1/s].

        Before the first row of a stretch its first value and no change; rows that are in no stretch likewise.
        """
        out, change = values.copy(), np.zeros_like(values)
        delays = np.broadcast_to(np.asarray(delay_s, dtype=float), values.shape[1:])
        for rows, time in self.parts:
            for axis, delay in enumerate(delays):
                curve = CubicSpline(time, values[rows, axis])
                when = np.clip(time - delay, time[0], time[-1])
                out[rows, axis] = curve(when)
                change[rows, axis] = curve(when, 1)
        return out, change
