"""Test whether later measured poses agree with the fit, and which deviation the test would have detected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc, fdtri

from gateway.diagnose.rest.holdout import Unseen
from gateway.diagnose.rest.residual_structure import detectable_sizes, pooled
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.linear import Fit, RestProblem

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Tests that share one probability: half sums and half differences, either on the worst axis and over all.
_TESTS = 4


def spare_rows(problem: RestProblem, fit: Fit) -> Floats:
    """Degrees of freedom (N,) of each axis's noise estimate: rows minus parameters absorbed by the fit."""
    return np.sum((problem.by_group() - fit.taken).reshape(3, -1), axis=0)


def fresh_misfit(residual: Floats, covariance: Floats, group: Ints, axes: int, spare: Floats | None = None) -> float:
    """P-value of the residuals of fresh rows, corrected for the number of tests.

    Half-sums (or single approaches) and half-differences are tested on the axis where they are largest, and over all
    axes.

    Parameters
    ----------
    residual : array of shape (k,)
    covariance : array of shape (k, k)
        Of the residuals: noise of the rows, and uncertainty of the prediction.
    group : array of shape (k,)
        Noise group: axis + `axes` * (0 half sum, 1 half difference, 2 one-sided).
    axes : number of axes N
    spare : array of shape (N,), optional
        Degrees of freedom of the noise estimate of each axis; None = the noise is known.
    """
    tests = []
    for kind in (group // axes != 1, group // axes == 1):
        numbers = np.unique(group[kind] % axes)
        if not len(numbers):
            continue
        chances, counts = [], []
        for number in numbers:
            rows = np.flatnonzero(kind & (group % axes == number))
            chances.append(_fresh_axis(residual[rows], covariance[np.ix_(rows, rows)], spare, int(number)))
            counts.append(float(len(rows)))
        together = pooled(np.array(chances)[:, None], np.sqrt(counts))
        tests += [len(numbers) * min(chances), float(together[0])]
    return min(1.0, len(tests) * min(tests)) if tests else 1.0


def _fresh_axis(residual: Floats, covariance: Floats, spare: Floats | None, axis: int) -> float:
    mean = float(residual @ np.linalg.solve(covariance, residual)) / len(residual) / REST.fresh_slack
    if spare is None:
        return float(chdtrc(len(residual), mean * len(residual)))
    return float(fdtrc(len(residual), max(float(spare[axis]), 1.0), mean))


def fresh_seen_nm(problem: RestProblem, held: Unseen | None, fit: Fit) -> dict[str, list[float | None]]:
    """RMS (N,) [Nm] of the smallest structure on one axis that fresh half-sums can detect; empty without such rows."""
    if held is None:
        return {}
    group = held.problem.group[held.mask]
    axis = group[group // problem.axes != 1] % problem.axes
    sizes = fresh_seen(np.bincount(axis, minlength=problem.axes), spare_rows(problem, fit))
    return {"fresh_seen_nm": detectable_sizes(sizes * fit.noise.std[: problem.axes])}


def fresh_seen(rows: Ints, spare: Floats | None = None) -> Floats:
    """RMS (N,), in noise floors, of a structure that fresh half-sums (N,) of one axis detect with probability `power`.

    For the test of the worst axis, with exactly known noise; inf on an axis without rows.
    """
    measured = np.flatnonzero(rows)
    out = np.full(len(rows), np.inf)
    level = REST.fresh_p / _TESTS / max(len(measured), 1)
    for axis in measured:
        count = int(rows[axis])
        freedom = np.inf if spare is None else max(float(spare[axis]), 1.0)
        limit = chdtri(count, level) / count if np.isinf(freedom) else fdtri(count, freedom, 1.0 - level)
        lower = chdtri(count, REST.power) / count
        out[axis] = np.sqrt(max(limit * REST.fresh_slack / lower - 1.0, 0.0))
    return out
