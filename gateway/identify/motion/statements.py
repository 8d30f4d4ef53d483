"""Test of the link masses of a robot model against moving rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.alternatives import LINK_SCALE, wider_links
from gateway.identify.conflict import dropped, links_finding
from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.columns import Columns
from gateway.identify.rest.rest_thresholds import CONFLICT
from gateway.identify.solve import Solution
from gateway.result.result import Finding

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Prior of link masses that are stated as exact, for their test.
NEARLY_EXACT: Final = 0.005


def contradicted_links(columns: Columns, solution: Solution, knowledge: Knowledge, unloaded: bool) -> Knowledge | None:
    """Return the knowledge with the link prior that the rows support; None if that is the stated one.

    They are dropped only where the arm was measured `unloaded`: else load and last link could not be separated.

    Another prior has a marginal likelihood over that of the stated one. It is the mean of the ratio of both densities
    over the posterior of the fit, Gaussian and so in closed form.
    """
    links = columns.links
    rows = columns.prior.rows[:, links]
    precision = rows.T @ rows
    held = np.diag(precision) > 0.0
    if not held.any():
        return None
    precision, mean = precision[np.ix_(held, held)], columns.prior.mean[links][held]
    covariance = solution.covariance[np.ix_(links[held], links[held])]
    step = solution.value[links][held] - mean

    def odds(change: Floats, log_density: float) -> float:
        """Log odds of a prior whose precision differs by `change`, with the change of its normalisation."""
        mixed = np.eye(len(step)) + covariance @ change
        pull = float(step @ change @ np.linalg.solve(mixed, step))
        return log_density - 0.5 * (float(np.linalg.slogdet(mixed)[1]) + pull)

    trust, best, found = knowledge.trust, CONFLICT.log_odds, None
    for wider in wider_links(trust):
        ratio = trust / wider
        value = odds((ratio**2 - 1.0) * precision, len(step) * float(np.log(ratio)))
        if value > best:
            best, found = value, replace(knowledge, link_std=wider)
    tied = precision @ mean
    size = LINK_SCALE**2 * float(mean @ tied)
    if odds(-np.outer(tied, tied) * LINK_SCALE**2 / (1.0 + size), -0.5 * float(np.log1p(size))) > best:
        return replace(knowledge, link_std=np.inf if unloaded else LINK_SCALE)
    return dropped(knowledge, found) if found is not None and unloaded else found


def contradiction(
    stated: Columns, measured: tuple[Columns, Floats, Floats], rows: Mask, trust: float
) -> Finding | None:
    """Report the axis on which the measured torque of the bodies differs most from the robot model.

    Parameters
    ----------
    stated : Columns
        With the prior that is contradicted.
    measured : Columns, array of shape (p,), array of shape (p, p)
        With the wider prior: parameters and their covariance.
    rows : bool array of shape (n, N)
        Of the unloaded arm, where an axis is used.
    trust : float
        Relative standard deviation of the link masses now.

    Returns
    -------
    Finding or None
        None where both agree within the uncertainty.
    """
    columns, value, covariance = measured
    own, links = columns.links, stated.links
    expected_nm = stated.design[:, :, links] @ stated.prior.mean[links]
    found_nm = columns.design[:, :, own] @ value[own]
    part = covariance[np.ix_(own, own)]
    spread = np.einsum("nak,kl,nal->na", columns.design[:, :, own], part, columns.design[:, :, own], optimize=True)

    def rms(values: Floats) -> Floats:
        return np.sqrt((values * rows).sum(axis=0) / np.maximum(rows.sum(axis=0), 1))

    std = np.maximum(rms(spread), 1e-9)
    away = rms((found_nm - expected_nm) ** 2) / std
    axis = int(np.argmax(away))
    if away[axis] <= CONFLICT.shown:
        return None
    torque = float(rms(expected_nm**2)[axis]), float(rms(found_nm**2)[axis]), float(std[axis])
    return links_finding(axis, torque, "in motion (rms)", trust)
