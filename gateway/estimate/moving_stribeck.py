"""Whether friction falls with speed before it rises: seen in what a fit without it leaves, axis by axis."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.moving_noise import MovingSpread
from gateway.estimate.moving_ordinary import Settled
from gateway.estimate.moving_problem import AxisRows, MotionProblem

Floats = NDArray[np.float64]

#: Speeds over which friction may fall, of the fastest that the axis was driven at.
_SHARES: Final = (0.02, 0.04, 0.08, 0.16, 0.3)
#: Standard deviations of a fall that shows.
_SHOWS: Final = 4.0
#: Share of the column that the others must leave of it, to be told from them.
_OWN: Final = 0.05


def stribeck_speeds(problem: MotionProblem, settled: Settled, spread: MovingSpread) -> tuple[float, ...]:
    """Speed [rad/s] over which the friction of each axis falls; NaN where none shows."""
    out = np.full(problem.tau_nm.shape[1], np.nan)
    left = problem.tau_nm - settled.here.model_nm
    for k, part in enumerate(problem.parts):
        if np.isnan(out[part.axis]):
            out[part.axis] = _speed(problem, part, left[:, part.axis], float(spread.scale_nm[k]))
    return tuple(out.tolist())


def _speed(problem: MotionProblem, part: AxisRows, left_nm: Floats, scale_nm: float) -> float:
    axis = part.axis
    qd, own = problem.qd_rad_s[:, axis], problem.turned(left_nm, part)
    fastest = float(np.abs(qd[part.rows]).max(initial=0.0))
    best, best_size = np.nan, _SHOWS
    for share in _SHARES:
        column = problem.columns.sign[:, axis] * np.exp(-((qd / max(share * fastest, 1e-9)) ** 2))
        rows = problem.turned(column, part)
        alone = rows - part.basis @ (part.basis.T @ rows)
        length = float(np.linalg.norm(alone))
        if length <= _OWN * float(np.linalg.norm(rows)):
            continue
        size = float(alone @ own) / length / scale_nm  # more friction at low speed: positive
        if size > best_size:
            best, best_size = share * fastest, size
    return best
