"""How sure a moving fit is: residuals hang together in time, and what the model lacks hangs on the motion.

Where periods were repeated, their scatter tells the noise without any model. What is left beyond it comes back in every
period and is no noise: then the residual of the fit itself says how far it may be off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.moving_ordinary import Settled
from gateway.estimate.moving_problem import MovingProblem, axis_columns
from gateway.identify.spread import by_blocks, wider

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_LONGEST: Final = 2000
#: Correlation times of a block that is one pull.
_LONG: Final = 3.0
#: Share of an axis's rows that a fit may take up before its residual tells nothing.
_MOST_TAKEN: Final = 0.5
#: Variance of the residual over that of the scatter between periods, up to which it is noise.
_NOISE_ALONE: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Noise of the rows as repeated periods show it: standard deviation (N,) [Nm] and correlation times (N,) in rows.

    NaN where an axis has no repeated rows.
    """

    std_nm: Floats
    times: Floats

    @staticmethod
    def none(axes: int) -> Scatter:
        """Nothing was repeated."""
        return Scatter(np.full(axes, np.nan), np.full(axes, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Covariance (p, p) of a fit; standard deviation (N,) [Nm] of its rows; whether the model lacks nothing (N,)."""

    covariance: Floats
    std_nm: Floats
    noise_alone: NDArray[np.bool_]


def spread_of(
    problem: MovingProblem, settled: Settled, sigma_nm: Floats, run: NDArray[Any], scatter: Scatter
) -> Spread:
    """Covariance under the residuals as they are: their own size, and hanging together in time.

    Each axis's residual by its correlation time; and where the model lacks something, stretches of all axes together by
    what they pull (a sandwich over blocks of several correlation times), because that hangs on the motion and on all
    axes at once. Of each parameter the wider of both.
    """
    left = problem.tau_nm - settled.here.model_nm
    axes, covariance = len(problem.axes), settled.free.covariance
    size, times, alone = np.zeros(axes), np.ones(axes), np.zeros(axes, dtype=bool)
    working, rows, pulls = np.zeros(covariance.shape), [], []
    real = np.zeros(covariance.shape)
    for axis, mine in enumerate(problem.axes):
        if not len(mine.rows):
            continue
        own = left[mine.rows, axis]
        rows_nm = axis_columns(problem, settled.here, axis) / sigma_nm[axis]
        through = rows_nm @ covariance
        taken = float(np.einsum("ij,ij->", through, rows_nm))
        times[axis] = correlation_time(own, run[mine.rows])
        kept = 1.0 - min(times[axis] * taken / len(own), _MOST_TAKEN)
        size[axis] = np.sqrt(float(own @ own) / len(own) / kept)
        if np.isfinite(scatter.std_nm[axis]) and size[axis] ** 2 < _NOISE_ALONE * scatter.std_nm[axis] ** 2:
            size[axis], times[axis], alone[axis] = scatter.std_nm[axis], scatter.times[axis], True
        square = through.T @ through
        working += square
        real += square * (size[axis] / sigma_nm[axis]) ** 2 * times[axis]
        rows.append(mine.rows)
        pulls.append(through * (own / sigma_nm[axis])[:, None])
    if problem.still is not None:  # rest rows have their own noise, and it is in their weight
        count = len(problem.columns.names)
        design, _ = problem.still.rows.about(settled.here.value)
        through = (design * problem.still.weight[:, None]) @ covariance.reshape(count, count)
        working += through.T @ through
        real += through.T @ through
    by_prior = covariance - working
    if not all(alone[axis] or not len(problem.axes[axis].rows) for axis in range(axes)):
        pulled = by_blocks(np.concatenate(pulls), np.concatenate(rows), run, _LONG * float(times.max()))
        real = wider(real, pulled)
    return Spread(real + by_prior, np.where(size > 0, size, np.nan), alone)


def correlation_times(problem: MovingProblem, left_nm: Floats, run: NDArray[Any]) -> Floats:
    """How many rows make one independent one on each axis (N,); 1 where there are none."""
    return np.array(
        [
            correlation_time(left_nm[mine.rows, axis], run[mine.rows]) if len(mine.rows) else 1.0
            for axis, mine in enumerate(problem.axes)
        ]
    )


def correlation_time(residual: Floats, run: NDArray[Any]) -> float:
    """How many rows make one independent one: 1 + 2 sum of the autocorrelation up to its first zero."""
    left = residual - residual.mean()
    energy = float(left @ left)
    if energy <= 0.0:
        return 1.0
    total, (_, number) = 1.0, np.unique(run, return_inverse=True)
    for lag in range(1, min(len(left) // 4, _LONGEST)):
        product = left[lag:] * left[:-lag]
        value = float(product[number[lag:] == number[:-lag]].sum()) / energy
        if value <= 0.0:
            break
        total += 2.0 * value
    return total
