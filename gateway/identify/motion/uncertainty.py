"""Uncertainty of a fit in motion: autocorrelated residuals, and model errors that depend on the motion.

Where periods were repeated, their scatter gives the noise without any model. The remaining residual repeats in every
period and is a model error; the uncertainty then follows from the residual of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from gateway.identify.motion.problem import MotionProblem, Settled, in_basis, part_columns
from gateway.identify.spread import by_blocks, correlation_time, wider

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Length of a block in correlation times.
_LONG: Final = 3.0
#: Largest share of an axis's rows that a fit may use as degrees of freedom.
_MOST_TAKEN: Final = 0.5
#: Residual variance over that of the scatter between periods, up to which the residual counts as noise.
_NOISE_ALONE: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Noise of the rows from repeated periods: standard deviation (N,) [Nm] and correlation times (N,) in rows.

    NaN where an axis has no repeated rows.
    """

    std_nm: Floats
    times: Floats

    @staticmethod
    def none(axes: int) -> Scatter:
        """Scatter of a run without repeated periods."""
        return Scatter(np.full(axes, np.nan), np.full(axes, np.nan))

    def filtered(self, low_pass: csr_array) -> Scatter:
        """Return the noise behind a low pass (n, n): of the same power at low frequencies."""
        length = 1.0 / float(low_pass.power(2).sum(axis=1).min())
        times = np.maximum(self.times, length)
        return Scatter(self.std_nm * np.sqrt(self.times / times), times)


@dataclass(frozen=True, slots=True, eq=False)
class MovingSpread:
    """Covariance (p, p) of a fit, and the noise of its rows: per axis (N,) [Nm], per part as if independent.

    The noise of an axis is that of unfiltered rows.
    """

    covariance: Floats
    std_nm: Floats
    scale_nm: Floats


def spread_of(
    problem: MotionProblem, settled: Settled, sigma_nm: Floats, run: NDArray[Any], scatter: Scatter
) -> MovingSpread:
    """Covariance for the actual residuals: their size and their autocorrelation.

    Without model errors the residual of each axis is widened by its correlation time. With model errors, stretches of
    all axes are combined (sandwich estimator over blocks of several correlation times), because these errors depend on
    the motion and on all axes at once. Each parameter gets the larger of both.
    """
    left = problem.tau_nm - settled.here.model_nm
    count, covariance = len(problem.parts), settled.free.covariance
    size, times, alone = np.zeros(count), np.ones(count), np.zeros(count, dtype=bool)
    working, real = np.zeros(covariance.shape), np.zeros(covariance.shape)
    owns = [part.turn @ left[:, part.axis] for part in problem.parts]
    for k, (part, own) in enumerate(zip(problem.parts, owns, strict=True)):
        stated = float(scatter.std_nm[part.axis])
        short = in_basis(problem, part, settled.here)[0] / sigma_nm[k]  # fewer rows than the part's, of the same square
        through = short @ covariance
        taken = float(np.einsum("ij,ij->", through, short))
        times[k] = correlation_time(own, run[part.rows])
        size[k] = np.sqrt(float(own @ own) / len(own) / (1.0 - min(times[k] * taken / len(own), _MOST_TAKEN)))
        if np.isfinite(stated) and size[k] ** 2 < _NOISE_ALONE * stated**2:
            size[k], times[k], alone[k] = stated, scatter.times[part.axis], True
        square = through.T @ through
        working = working + square
        real = real + square * (size[k] / sigma_nm[k]) ** 2 * times[k]
    if problem.still is not None:  # rest rows have their own noise, and it is in their weight
        through = problem.still.rows @ covariance
        working, real = working + through.T @ through, real + through.T @ through
    by_prior = covariance - working
    if not alone.all():
        rows = np.concatenate([part.rows for part in problem.parts])
        pulls = [
            part_columns(problem, settled.here, part) * (own / sigma**2)[:, None]
            for part, own, sigma in zip(problem.parts, owns, sigma_nm, strict=True)
        ]
        blocks = by_blocks(np.concatenate(pulls), rows, run, _LONG * float(times.max()))
        for sums in (_by_strokes(problem, pulls), blocks):
            real = wider(real, covariance @ sums @ covariance)
    raw = [np.sqrt(np.mean(left[problem.used[:, part.axis], part.axis] ** 2)) for part in problem.parts]
    return MovingSpread(real + by_prior, by_axis(problem, np.maximum(size, raw)), size * np.sqrt(times))


def _by_strokes(problem: MotionProblem, pulls: list[Floats]) -> Floats:
    """Squared contributions (p, p) of each part's rows (k, p) to the estimate, summed by stroke.

    Friction differs between strokes, and its error has one sign during a stroke.
    """
    out = np.zeros((pulls[0].shape[1],) * 2)
    for part, pull in zip(problem.parts, pulls, strict=True):
        sign = np.sign(problem.qd_rad_s[part.rows, part.axis])
        begins = np.flatnonzero((np.diff(sign, prepend=0.0) != 0) | (np.diff(part.rows, prepend=-1) != 1))
        sums = np.add.reduceat(pull, begins, axis=0)
        out += sums.T @ sums * (len(begins) / max(len(begins) - 1, 1))
    return out


def by_axis(problem: MotionProblem, values: Floats) -> Floats:
    """Largest value (N,) among the parts of each axis; NaN for an axis without parts."""
    out = np.full(problem.tau_nm.shape[1], np.nan)
    for part, value in zip(problem.parts, values, strict=True):
        out[part.axis] = np.fmax(out[part.axis], value)
    return out


def correlation_times(problem: MotionProblem, left_nm: Floats, run: NDArray[Any]) -> Floats:
    """Number of rows per independent row in each part."""
    return np.array([correlation_time(part.turn @ left_nm[:, part.axis], run[part.rows]) for part in problem.parts])
