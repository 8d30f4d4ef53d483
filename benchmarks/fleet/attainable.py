"""Earliest possible detection: drift is tested against none with the true law of the random walks.

The earliest day uses the random walk of every robot. From the checks alone at best the law of the walks is known: their
correlation, and the spread of their sizes over the robots. The size itself has to be estimated from the robot.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import norm

from benchmarks.fleet.bound import LOOKS_DAY
from benchmarks.fleet.plant import LIKE, WEAR, Robot, likeness
from gateway.fleet.correlated_noise import Sums, lines, needed_sigmas, sigmas

#: Sizes of the random walk that represent all.
SIZES = 12


def detected_on(robot: Robot, lag_differences: float, series: int) -> float:
    """Return the day on which the wear of a robot is detected; infinite = not in the year."""
    axis = robot.worn
    value = np.asarray(robot.columns[f"gain{axis + 1}"])
    warm = robot.temperature_c[:, axis]
    design = [np.ones(len(value)), robot.day / 365.25, warm - warm.mean(), robot.load_kg - robot.load_kg.mean(), value]
    columns = np.column_stack(design)
    quantiles = (np.arange(SIZES) + 0.5) / SIZES
    products, log_spread = [], []
    for size in LIKE * np.exp(lag_differences * norm.ppf(quantiles)):
        factor = cholesky(size**2 * likeness(robot.day) + np.eye(len(value)), lower=True)
        white = solve_triangular(factor, columns, lower=True)
        products.append(np.cumsum(white[:, :, None] * white[:, None, :], axis=0))
        log_spread.append(2.0 * np.cumsum(np.log(np.diag(factor))))
    known = np.full((SIZES, 1), -np.log(SIZES))
    for day in LOOKS_DAY:
        row = int(np.searchsorted(robot.day, day, side="right")) - 1
        seen = Sums(
            np.array([each[row] for each in products])[:, None],
            np.array([each[row] for each in log_spread])[:, None],
            np.array([row + 1.0]),
        )
        std = sigmas(lines(seen, np.ones((1, 4), dtype=bool)), known, np.array([WEAR]))
        if abs(std[0]) >= needed_sigmas(series):
            return float(day)
    return float("inf")
