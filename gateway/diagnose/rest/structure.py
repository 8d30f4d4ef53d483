"""Is what a hypothesis leaves over noise? Tests that need no idea of what else there might be.

Noise differs from visit to visit; what depends on the pose comes back when the pose does. So residuals of one pose
under several loads must not resemble each other, half sums must not scatter more than half differences do, and poses
measured afterwards must be met as well as the fit says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from gateway.diagnose.rest.linear import Fit, RestProblem
from gateway.diagnose.rest.thresholds import REST

Floats = NDArray[np.float64]
DRAWS = 400


def misfit(problem: RestProblem, fit: Fit) -> float:
    """Probability that noise alone leaves residuals as structured as these; small = structure remains.

    The smaller of two tests, doubled: likeness of residuals of one pose under different loads, and half sums against
    half differences. 1 where the visits allow neither.
    """
    tests = [_likeness(problem, fit), _scatter(problem, fit)]
    return float(min(1.0, len(tests) * min(tests)))


def _likeness(problem: RestProblem, fit: Fit) -> float:
    pairs = _same_pose_pairs(problem)
    if len(pairs) < 4:
        return 1.0
    std = fit.noise.std[problem.group]
    first, second = pairs[:, 0], pairs[:, 1]
    axis = problem.group[first]
    products = (fit.residual / std)[first] * (fit.residual / std)[second]
    rng = np.random.default_rng(20)
    noise = rng.standard_normal((len(std), DRAWS))
    # what the prior rows add to the fitted part is left out: it makes the residuals a little smaller, not more alike
    left = noise - fit.orthogonal @ (fit.orthogonal.T @ noise)
    simulated = left[first] * left[second]
    smallest = 1.0
    groups = np.unique(axis)
    for number in groups:
        mine = axis == number
        draws = simulated[mine].sum(axis=0)
        spread = max(float(draws.std()), 1e-12)
        score = (float(products[mine].sum()) - float(draws.mean())) / spread
        smallest = min(smallest, _product_tail(score, int(mine.sum())))
    return min(1.0, smallest * len(groups))


def _product_tail(score: float, count: int) -> float:
    """Upper tail of a standardised sum of `count` products of normals: half the difference of two chi-squares."""
    levels = chi2.ppf((np.arange(400) + 0.5) / 400.0, count)
    return float(np.mean(chi2.sf(2.0 * score * np.sqrt(count) + levels, count)))


def _same_pose_pairs(problem: RestProblem) -> NDArray[np.int_]:
    """Rows (pairs, 2) of half sums of one axis and pose in different visits."""
    visit = np.broadcast_to(np.arange(len(problem.rows))[:, None], problem.use_sum.shape)[problem.use_sum]
    sums = np.arange(len(visit))
    pose = problem.rows.pose[visit]
    pairs = []
    for number in np.unique(pose):
        for axis in range(problem.axes):
            rows = sums[(pose == number) & (problem.axis[: len(visit)] == axis)]
            pairs += [(a, b) for k, a in enumerate(rows) for b in rows[k + 1 :]]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _scatter(problem: RestProblem, fit: Fit) -> float:
    """Half sums scatter as half differences do; a small ratio of probabilities says that they hold structure."""
    leverage = (fit.orthogonal**2).sum(axis=1)
    smallest, tests = 1.0, 0
    for axis in range(problem.axes):
        sums, differences = problem.group == axis, problem.group == axis + problem.axes
        freedom = [float(np.sum(1.0 - leverage[rows])) for rows in (sums, differences)]
        if min(freedom) < 3.0:
            continue
        tests += 1
        variance = [
            max(float(np.sum(fit.residual[rows] ** 2)) / n, fit.noise.least[axis] ** 2)
            for rows, n in zip((sums, differences), freedom, strict=True)
        ]
        # friction left after settling is not quite normal: half the freedom, so that the test does not overstate
        smallest = min(smallest, float(f.sf(variance[0] / variance[1], 0.5 * freedom[0], 0.5 * freedom[1])))
    return min(1.0, smallest * max(tests, 1))


def spare_rows(problem: RestProblem, fit: Fit) -> Floats:
    """Rows (N,) of each axis beyond what the fit has taken up: how well its noise is known."""
    leverage = (fit.orthogonal**2).sum(axis=1)
    return np.asarray(np.bincount(problem.axis, weights=1.0 - leverage, minlength=problem.axes), dtype=float)


def fresh_misfit(residual: Floats, covariance: Floats, axis: NDArray[np.int_], spare: Floats | None = None) -> float:
    """Probability of residuals this large on fresh rows (per axis, over all tests).

    Parameters
    ----------
    residual : array of shape (k,)
    covariance : array of shape (k, k)
        Of the residuals: their own noise, and what the fit does not know of the rows it foretells.
    axis : array of shape (k,)
    spare : array of shape (N,), optional
        How many rows the noise of each axis was estimated from: few rows know their own noise badly. None = known.
    """
    smallest = 1.0
    axes = np.unique(axis)
    for number in axes:
        rows = np.flatnonzero(axis == number)
        scaled = residual[rows] @ np.linalg.solve(covariance[np.ix_(rows, rows)], residual[rows])
        mean = float(scaled) / len(rows) / REST.fresh_slack
        if spare is None:
            chance = float(chi2.sf(mean * len(rows), len(rows)))
        else:
            chance = float(f.sf(mean, len(rows), max(float(spare[number]), 1.0)))
        smallest = min(smallest, chance)
    return min(1.0, smallest * len(axes))
