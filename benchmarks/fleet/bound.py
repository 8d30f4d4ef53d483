"""Earliest day on which a drift can be detected: Cramer-Rao bound, and the least threshold for the alarms."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import norm

from benchmarks.fleet.plant import WEAR, Robot, covariance

#: A drift counts as detectable where it would be missed in 5 %.
POWER_SIGMAS = 1.645
FALSE_PER_YEAR = 0.01
LOOKS_DAY = np.arange(28.0, 366.0, 7.0)


def threshold(series: int) -> float:
    """Least constant threshold of weekly looks at so many drifts for 1 false alarm in 100 robot years, by numbers.

    Drift over its standard deviation from look to look is a Gauss-Markov chain. Its density is carried over a grid,
    and what is outside the threshold is taken away at every look. White noise: information goes with the cube of
    the time.
    """
    wanted = FALSE_PER_YEAR / series
    low, high = 2.0, 8.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _leaves(middle) > wanted else (low, middle)
    return high


def _leaves(bound: float) -> float:
    grid = np.linspace(-bound, bound, 401)
    step = grid[1] - grid[0]
    density = norm.pdf(grid) * step
    left = 2.0 * norm.sf(bound)
    for before, after in zip(LOOKS_DAY, LOOKS_DAY[1:], strict=False):
        kept = (before / after) ** 1.5
        width = np.sqrt(1.0 - kept**2)
        out = norm.sf((bound - kept * grid) / width) + norm.cdf((-bound - kept * grid) / width)
        left += float(density @ out)
        density = density @ (norm.pdf((grid - kept * grid[:, None]) / width) / width) * step
    return left


def earliest_day(robot: Robot, sigmas: float) -> float:
    """First day on which (1.645 + z) times the Cramer-Rao deviation of the drift is below the wear; NaN = not yet.

    Level, temperature and load are not known, the covariance of the checks is.
    """
    axis = robot.worn
    design = np.column_stack([robot.day / 365.25, np.ones(len(robot.day)), robot.temperature_c[:, axis], robot.load_kg])
    white = solve_triangular(cholesky(covariance(robot, axis), lower=True), design, lower=True)
    information = np.cumsum(white[:, :, None] * white[:, None, :], axis=0)
    for row in range(20, len(robot.day)):
        deviation = np.sqrt(np.linalg.inv(information[row])[0, 0])
        if (POWER_SIGMAS + sigmas) * deviation < WEAR:
            return float(robot.day[row])
    return float("nan")
