"""Errors of the torque readings: common to all axes, changing between runs, and drifting while the arm warms up.

The reading of axis i is `(1 + g_i + c + s_io + s_o + (d_i + d) w(t)) tau_i`: its own error `g_i` is a nuisance
parameter. This file models the common error `c` (a wrong voltage or rms convention, one batch of motors). It also
models the change `s` of occasion o (a run with one load) and the drift `d` with `w(t) = 1 - exp(-t / T)`. Every
occasion has a change of its own and none is the reference, so that a result does not depend on their order or number.
Magnets lose 0.04 % (SmCo) to 0.2 % (ferrite) of their flux per kelvin, so a motor that is 10 K warmer reads 0.4 to 2 %
more current for a torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, numbered
from gateway.identify.nuisance import CHANGE_AXIS, CHANGE_COMMON, COMMON_SHARE
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.model.motion import MovingRows
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Duration [s] of a table below which no drift is modelled.
_LONG_S: Final = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class GainChanges:
    """Prior of the common gain, the changes by occasion (of each axis, then of all), and the drift, in this order.

    Attributes
    ----------
    relative : (N,) share of the common error that an axis has: its constant's standard deviation over the largest
    common_std : standard deviation of the common error at the axis of the least certain constant
    occasions : run and load of each occasion, in their order
    start_s : time of the first visit; NaN = no drift is modelled
    factor : on the standard deviation of every change
    """

    relative: Floats
    common_std: float
    occasions: tuple[tuple[str, ...], ...] = ()
    start_s: float = np.nan
    factor: float = 1.0

    @staticmethod
    def none(gain_std: Floats) -> GainChanges:
        """Return the prior without changes and drift, for constants with these standard deviations (N,)."""
        largest = float(gain_std.max())
        return GainChanges(gain_std / largest, math.sqrt(COMMON_SHARE) * largest)

    @staticmethod
    def of(rows: Visits, gain_std: Floats, factor: float = 1.0) -> GainChanges:
        """Build the prior from visits and standard deviations (N,) of constants; `factor` scales the usual changes."""
        order = np.argsort(rows.time_s, kind="stable") if np.isfinite(rows.time_s).all() else np.arange(len(rows))
        occasions, _ = occasions_of(rows.take(order))
        long = np.ptp(rows.time_s) > _LONG_S
        start_s = float(rows.time_s.min()) if long else np.nan
        return replace(GainChanges.none(gain_std), occasions=occasions, start_s=start_s, factor=factor)

    @property
    def axes(self) -> int:
        """Number of axes N."""
        return len(self.relative)

    @property
    def count(self) -> int:
        """Number of parameters E."""
        return len(self.std)

    @property
    def std(self) -> Floats:
        """Prior standard deviation (E,) of each parameter; the mean is 0."""
        drift = self._change(REST_MODEL.drift_axis) if np.isfinite(self.start_s) else []
        changes = np.array([*(self._change(CHANGE_AXIS) * len(self.occasions)), *drift])
        return np.append(self.common_std, self.factor * changes)

    def patterns(self, rows: Visits) -> Floats:
        """Contribution (n, N, E) of a unit of each parameter to the gain; an unknown occasion contributes nothing."""
        n, axes = len(rows), self.axes
        every = np.hstack([np.eye(axes), np.ones((axes, 1))])
        number, (present, at) = {name: k for k, name in enumerate(self.occasions)}, occasions_of(rows)
        own = np.array([number.get(name, -1) for name in present], dtype=int)[at]
        here = own[:, None] == np.arange(len(number))
        changes = (here[:, None, :, None] * every[:, None]).reshape(n, axes, -1)
        parts = [np.broadcast_to(self.relative[:, None], (n, axes, 1)), changes]
        if np.isfinite(self.start_s):
            warm = 1.0 - np.exp(-np.maximum(rows.time_s - self.start_s, 0.0) / REST_MODEL.drift_s)
            parts.append(warm[:, None, None] * every[None])
        return np.concatenate(parts, axis=2)

    def _change(self, own: float) -> list[float]:
        return [own] * self.axes + [CHANGE_COMMON]


def occasions_of(rows: Visits | Table | MovingRows) -> tuple[tuple[tuple[str, ...], ...], NDArray[np.int_]]:
    """Return run and load of each occasion in the order of the rows, and the occasion (n,) of each row."""
    return numbered(rows.run, rows.load)
