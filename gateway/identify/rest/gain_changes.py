"""Errors of the torque readings: common to all axes, changing between runs, and drifting while the arm warms up.

The reading of axis i is `(1 + g_i + c + s_ib + s_b + (d_i + d) w(t)) tau_i`: its own error `g_i` is a nuisance
parameter. This file models the common error `c` (a wrong voltage or rms convention, one batch of motors). It also
models the change `s` of block b against the first (a block is a run with one load), and the drift `d` with `w(t) = 1 -
exp(-t / T)`. Magnets lose 0.04 % (SmCo) to 0.2 % (ferrite) of their flux per kelvin, so a motor that is 10 K warmer
reads 0.4 to
2 % more current for a torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.nuisance import CHANGE_AXIS, CHANGE_COMMON, COMMON_SHARE
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Number of blocks above which a block has one common change: changes of single axes average out, and their number
#: would
#: determine the computing time.
MOST_BLOCKS: Final = 6
#: Duration [s] of a table below which no drift is modelled.
_LONG_S: Final = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class GainChanges:
    """Prior of the common gain, its changes by block, and its drift, in this order.

    Attributes
    ----------
    relative : (N,) share of the common error that an axis has: its constant's standard deviation over the largest
    common_std : standard deviation of the common error at the axis of the least certain constant
    blocks : blocks in their order; the first is the reference
    start_s : time of the first visit; NaN = no drift is modelled
    factor : on the standard deviation of every change
    """

    relative: Floats
    common_std: float
    blocks: tuple[str, ...] = ()
    start_s: float = np.nan
    factor: float = 1.0

    @staticmethod
    def none(gain_std: Floats) -> GainChanges:
        """Return the prior without blocks and drift, for constants with these standard deviations (N,)."""
        largest = float(gain_std.max())
        return GainChanges(gain_std / largest, math.sqrt(COMMON_SHARE) * largest)

    @staticmethod
    def of(rows: Visits, gain_std: Floats, factor: float = 1.0) -> GainChanges:
        """Build the prior from visits and standard deviations (N,) of constants; `factor` scales the usual changes."""
        order = np.argsort(rows.time_s, kind="stable") if np.isfinite(rows.time_s).all() else np.arange(len(rows))
        blocks = tuple(dict.fromkeys(blocks_of(rows)[order].tolist()))
        long = np.ptp(rows.time_s) > _LONG_S
        start_s = float(rows.time_s.min()) if long else np.nan
        return replace(GainChanges.none(gain_std), blocks=blocks, start_s=start_s, factor=factor)

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
        change = [CHANGE_COMMON] if self._by_block_alone else self._change(CHANGE_AXIS)
        drift = self._change(REST_MODEL.drift_axis) if np.isfinite(self.start_s) else []
        changes = np.array([*(change * max(len(self.blocks) - 1, 0)), *drift])
        return np.append(self.common_std, self.factor * changes)

    def patterns(self, rows: Visits) -> Floats:
        """Contribution (n, N, E) of a unit of each parameter to the gain; an unknown block contributes nothing."""
        n, axes = len(rows), self.axes
        parts = [np.broadcast_to(self.relative[:, None], (n, axes, 1))]
        every = np.ones((axes, 1)) if self._by_block_alone else np.hstack([np.eye(axes), np.ones((axes, 1))])
        block = blocks_of(rows)
        parts += [(block == name)[:, None, None] * every[None] for name in self.blocks[1:]]
        if np.isfinite(self.start_s):
            warm = 1.0 - np.exp(-np.maximum(rows.time_s - self.start_s, 0.0) / REST_MODEL.drift_s)
            parts.append(warm[:, None, None] * np.hstack([np.eye(axes), np.ones((axes, 1))])[None])
        return np.concatenate(parts, axis=2)

    @property
    def _by_block_alone(self) -> bool:
        return len(self.blocks) > MOST_BLOCKS

    def _change(self, own: float) -> list[float]:
        return [own] * self.axes + [CHANGE_COMMON]


def blocks_of(rows: Visits) -> NDArray[np.str_]:
    """Block (n,) of each visit: its run combined with its load."""
    return np.char.add(np.char.add(rows.run.astype(str), "/"), rows.load.astype(str))
