"""Variance of an estimate by source: torque constants, links, friction, drift, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.solve import ByGroup, Prior

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Names = NDArray[np.str_]

CONSTANTS: Final = "constants"
LINKS: Final = "links"
FRICTION: Final = "friction"
#: Source: gains that change between runs and while the arm warms up.
DRIFT: Final = "drift"
#: Sources: zero errors of the joints; a hose or cable that comes with the load.
ZEROS: Final = "zeros"
CABLE: Final = "cable"
#: Source: measured rows, and everything without a prior.
NOISE: Final = "noise"
#: Keys of a budget.
SOURCES: Final = (CONSTANTS, LINKS, FRICTION, DRIFT, NOISE)


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Source of the uncertainty of each row and each prior of a weighted problem.

    Attributes
    ----------
    row : str array of shape (n,)
        Source of each row.
    parameter : source -> array of shape (p,)
        Share of the prior's variance of each parameter that is of that source; of free ones it does not matter.
    further : str
        Source of the prior's further combinations.
    """

    row: Names
    parameter: Mapping[str, Floats]
    further: str = LINKS


def budget_of(
    design: ByGroup, prior: Prior, covariance: Floats, direction: Floats, sources: Sources
) -> Mapping[str, float]:
    """Return the share of the variance of `direction @ x` by source, with sum 1.

    The estimate is linear in the measured rows and in the prior's means, each of variance 1. The variance is the
    sum of the squares of its coefficients, `|direction C A^T|^2 + |direction C P^T|^2`, and every row and
    every prior belongs to one source.

    Parameters
    ----------
    design : columns (n, p)
        Of rows with unit variance.
    prior : Prior
    covariance : array of shape (p, p)
        Of the solution: the inverse of `A^T A + P^T P`.
    direction : array of shape (p,)
    sources : Sources

    Returns
    -------
    mapping
        Each of `SOURCES`; empty where nothing has a variance.
    """
    reach = covariance @ direction
    held = np.isfinite(prior.std)
    by_row = design.times(reach) ** 2
    by_prior = np.zeros(len(reach))
    by_prior[held] = (reach[held] / prior.std[held]) ** 2
    nothing = np.zeros(len(reach))
    total = {
        source: float(by_row[sources.row == source].sum() + by_prior @ sources.parameter.get(source, nothing))
        for source in SOURCES
    }
    total[sources.further] += float(((prior.rows @ reach) ** 2).sum())
    complete = sum(total.values())
    if not (np.isfinite(complete) and complete > 0.0):
        return {}
    return {source: value / complete for source, value in total.items()}


def budget_by_priors(lead: Floats, precision: Floats, sources: Mapping[str, Ints], variance: float) -> dict[str, float]:
    """Return the share of a variance by source, with sum 1, if all uncertainty except noise is in priors.

    `NOISE` is what the priors leave. With covariance `C` and prior precision `L` the variance `a C a` of `a x` is
    `a C A C a + a C L C a`, the first from the rows and the second from the priors, one term for each parameter.

    Parameters
    ----------
    lead : array of shape (p,)
        `C a`: covariance of the quantity with every parameter.
    precision : array of shape (p,) or (p, p)
        Of the prior of every parameter, 0 = free; a matrix where priors tie parameters together.
    sources : mapping of name to parameters (k,)
    variance : float
        Of the quantity, with what is beyond the model; nothing comes out where it is not above 0.
    """
    if not (np.isfinite(variance) and variance > 0.0):
        return {}
    part = lead * (precision * lead if precision.ndim == 1 else precision @ lead) / variance
    out = {name: float(part[index].sum()) for name, index in sources.items()}
    complete = max(sum(out.values()), 1e-300)
    known = min(complete, 1.0)
    return {name: share * known / complete for name, share in out.items()} | {NOISE: 1.0 - known}
