"""Rest visits beside moving rows: one solution, with links, loads and gains in common.

The rest rows come with the noise that they were found to have alone; what is theirs alone, the torque offset of each
axis and the friction of a one-sided approach, is folded into it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, concatenate
from gateway.estimate.describe import fitted_rows
from gateway.estimate.estimate import FittedRows
from gateway.estimate.fitting import Fitted, fit_problem
from gateway.estimate.gains import GainRows
from gateway.estimate.moving_columns import Columns, MovingSetup, moving_columns
from gateway.estimate.moving_problem import Still
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import build_problem
from gateway.identify.solve import Prior
from gateway.model.robot import Robot
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


def fitted_rest(visits: Visits, robot: Robot, options: EstimateOptions) -> Fitted:
    """The rest visits alone, for their noise.

    Raises
    ------
    DataUnusable
        Nothing was measured at rest.
    """
    present = set(np.asarray(visits.load).tolist())
    known = {label: value for label, value in options.known.items() if label in present}
    here = replace(options, known=known)
    return fit_problem(build_problem(visits, robot, here), here)


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Columns of the moving rows, and the rest rows in the same columns."""

    columns: Columns
    still: Still | None


def columns_beside(
    moving: Table, robot: Robot, options: EstimateOptions, motion: MovingSetup, rest: Fitted | None
) -> Beside:
    """Columns of moving rows, with those of rest rows where there are some.

    Raises
    ------
    InputError
        A known load that is not in the data.
    """
    if rest is None or "gain" not in motion.ordinary:
        return Beside(moving_columns(moving, robot, options, motion), None)
    whole = moving_columns(concatenate([moving, _as_rows(moving, rest.problem.visits)]), robot, options, motion)
    count = len(moving)
    columns = replace(whole, design=whole.design[:count], known_nm=whole.known_nm[:count], sign=whole.sign[:count])
    columns = replace(columns, prior=_seen_at_rest(columns, rest))
    visit, axis = rest.problem.visit, rest.problem.axis
    design = whole.design[count + visit, axis]
    design[:, whole.bodies :] = 0.0  # friction of motion, and its bias, are not those of a standstill
    rows = GainRows(
        design,
        rest.problem.visits.tau_nm[visit, axis] - _mean_loss(rest),
        whole.known_nm[count + visit, axis],
        whole.bodies,
        whole.ordinary["gain"][axis],
    )
    return Beside(columns, Still(rows, _whitening(rest)))


def _mean_loss(rest: Fitted) -> Floats:
    """Torque (r,) that one-sided rows lose to load friction as expected; what it differs by is in their noise."""
    columns = rest.problem.losses
    return rest.problem.design[:, columns] @ rest.prior.mean[columns]


def _seen_at_rest(columns: Columns, rest: Fitted) -> Prior:
    """The prior with what both sides of the rest poses say of the losses, and of the gains through them."""
    mean, std = columns.prior.mean.copy(), columns.prior.std.copy()
    gain = columns.ordinary["gain"][rest.problem.offset_axis]
    mean[gain], std[gain] = rest.prior.mean[rest.problem.gains], rest.prior.std[rest.problem.gains]
    if "load_friction" in columns.ordinary:
        seen = np.isfinite(rest.loss)
        at = columns.ordinary["load_friction"][seen]
        mean[at], std[at] = rest.loss[seen], rest.loss_std[seen]
    return replace(columns.prior, mean=mean, std=std)


def _as_rows(moving: Table, visits: Visits) -> Table:
    """Visits as rows of an arm that does not move."""
    still = np.zeros_like(visits.q_rad)
    return replace(
        moving.take(np.zeros(len(visits), dtype=int)),
        load=np.asarray(visits.load), q_rad=visits.q_rad, qd_rad_s=still, qdd_rad_s2=still, tau_nm=visits.tau_nm,
    )  # fmt: skip


def _whitening(rest: Fitted) -> Floats:
    """Rows (r, r) that make the noise of the rest rows white, their own parameters in it."""
    scattered = _own(rest)
    covariance = np.diag(rest.fit.weight**-2.0) + scattered @ scattered.T
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=float)


def _own(rest: Fitted) -> Floats:
    """Columns (r, k) of what the rest rows have alone, one standard deviation each."""
    problem = rest.problem
    own = np.setdiff1d(np.arange(problem.offsets[0], len(problem.names)), problem.gains)
    return problem.design[:, own] * rest.prior.std[own]


def rest_rows(rest: Fitted, still: Still, value: Floats) -> FittedRows:
    """The rest rows with what the common solution (p,) says of them, and the offsets that they have alone."""
    design, target = still.rows.about(value)
    left = target - design @ value
    problem, rows = rest.problem, fitted_rows(rest.problem, rest.fit)
    scattered = _own(rest)
    left = left - scattered @ (scattered.T @ (still.whiten.T @ (still.whiten @ left)))
    model = np.full(rows.tau_nm.shape, np.nan)
    model[problem.visit, problem.axis] = rows.tau_nm[problem.visit, problem.axis] - left
    return replace(rows, model_nm=model)
