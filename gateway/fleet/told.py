"""When a drift is told: one threshold for every look at every quantity of a robot, and what a look says.

Reading a line again every week is many tests. The score of a drift grows with independent increments whatever the
wander is, so that the drift over its standard deviation runs as Brownian motion over the root of its time, the time
being the information. The chance that it ever leaves a constant threshold b while the information grows by a factor m
is 2 ((b - 1/b) ln(m) / 2 + 2 / b) phi(b) (Siegmund, Sequential Analysis, 1985, 4.2), both signs together.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri, ndtri_exp, stdtr

from gateway.fleet.wander import FittedLines

Floats = NDArray[np.float64]

#: False alarms of a robot in a year, all axes and quantities together.
FALSE_PER_YEAR: Final = 0.01
#: A drift is told where it would be missed in 5 %.
POWER: Final = 0.95
POWER_SIGMAS: Final = float(ndtri(POWER))
#: No line is told from less: days from the first to the last check, and checks.
FEWEST_DAYS: Final = 28.0
FEWEST_CHECKS: Final = 14
_DAYS_OF_A_YEAR: Final = 365.25
#: Information of a drift grows with the cube of the time where nothing wanders, and slower where something does.
_GROWTH: Final = 3.0
#: Column of the drift.
DRIFT: Final = 1


def needed_sigmas(series: int) -> float:
    """Standard deviations from which on a drift is told, where so many series of a robot are looked at.

    Most false alarms come in the first year, in which the information grows most.
    """
    growth = _GROWTH * math.log(_DAYS_OF_A_YEAR / FEWEST_DAYS)
    wanted = FALSE_PER_YEAR / max(series, 1)
    low, high = 1.5, 12.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        density = math.exp(-0.5 * middle**2) / math.sqrt(2.0 * math.pi)
        chance = 2.0 * ((middle - 1.0 / middle) * growth / 2.0 + 2.0 / middle) * density
        low, high = (middle, high) if chance > wanted else (low, middle)
    return high


def weights(of: FittedLines, log_prior: Floats) -> Floats:
    """How likely every shape is (G, M), given the checks and how often it is seen (G, M) as logarithm."""
    log = of.log_likelihood + log_prior
    raw = np.exp(log - log.max(axis=0))
    return raw / raw.sum(axis=0)


def sigmas(of: FittedLines, weight: Floats) -> Floats:
    """Drift over its standard deviation (M,) as that of a normal distribution; NaN where there are too few checks.

    The noise is read from the series itself (Student), the wander is one of several shapes (their mixture).
    """
    std = np.sqrt(np.maximum(of.covariance[:, :, DRIFT, DRIFT], 1e-300))
    over = of.value[:, :, DRIFT] / std
    freedom = np.maximum(of.freedom, 1.0)
    tail = (weight * stdtr(freedom, -np.abs(over))).sum(axis=0)
    size = -ndtri_exp(np.maximum(np.log(np.maximum(tail, 1e-290)), float(log_ndtr(-36.0))))
    sign = np.sign((weight * over).sum(axis=0))
    return np.where(of.freedom >= FEWEST_CHECKS - 4, sign * np.maximum(size, 0.0), np.nan)


def mixed(of: FittedLines, weight: Floats) -> tuple[Floats, Floats]:
    """Mean (M, p) and covariance (M, p, p) over the shapes."""
    mean = (weight[..., None] * of.value).sum(axis=0)
    away = of.value - mean
    widened = of.covariance * (np.maximum(of.freedom, 3.0) / (np.maximum(of.freedom, 3.0) - 2.0))[:, None, None]
    covariance = (weight[..., None, None] * (widened + away[..., :, None] * away[..., None, :])).sum(axis=0)
    return mean, covariance
