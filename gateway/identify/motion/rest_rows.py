"""Rest visits together with moving rows: one solution with common links, loads, gains and load friction.

The information of the rest rows on the common parameters is one set of rows with unit noise. Parameters of the rest
rows alone, such as friction bands, are eliminated by an orthogonal reduction (square-root information; Bierman,
Factorization methods, 1977, chapter 5).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, concatenate
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_AT_REST, PER_LINK_MOVING
from gateway.identify.motion.columns import Columns, MovingSetup, moving_columns
from gateway.identify.motion.prior import CHANGE
from gateway.identify.motion.problem import Still
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.rest_nuisance import KINDS
from gateway.model.robot import Robot
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
#: Nuisance parameters that rest and moving rows share.
SHARED = ("gain", "load_friction")


def columns_beside(
    moving: Table, robot: Robot, knowledge: Knowledge, motion: MovingSetup, rest: Fit | None
) -> tuple[Columns, Still | None]:
    """Columns of moving rows, and the information of rest visits on the same parameters, if there are any.

    Raises
    ------
    InputError
        A known load that is not in the data.
    """
    if rest is None or "gain" not in motion.nuisances:
        return moving_columns(moving, robot, knowledge, motion), None
    # loads that are in the rest rows alone have columns too
    complete = moving_columns(concatenate([moving, _as_rows(moving, rest.problem.rows)]), robot, knowledge, motion)
    count = len(moving)
    columns = replace(
        complete,
        design=complete.design[:count],
        known_nm=complete.known_nm[:count],
        occasion=complete.occasion[:count],
        sign=complete.sign[:count],
    )
    return columns, _still(columns, rest)


def _as_rows(moving: Table, visits: Visits) -> Table:
    """Convert visits to rows of an arm that does not move."""
    still = np.zeros_like(visits.q_rad)
    return replace(
        moving.take(np.zeros(len(visits), dtype=int)),
        run=np.asarray(visits.run), load=np.asarray(visits.load),
        q_rad=visits.q_rad, qd_rad_s=still, qdd_rad_s2=still, tau_nm=visits.sum_nm,
    )  # fmt: skip


def _still(columns: Columns, fit: Fit) -> Still:
    """Information of the rest rows on the parameters that they share with the moving ones."""
    problem = fit.problem
    reduced, right = _eliminated(problem, fit, _shared(problem))
    rows = np.zeros((len(reduced), len(columns.names)))
    fixed = columns.fixed_links.reshape(-1, PER_LINK_MOVING)[:, :PER_LINK_AT_REST].ravel()
    right = right - reduced[:, : len(fixed)] @ fixed
    for k, column in enumerate(columns.link_columns):
        link, part = divmod(int(column), PER_LINK_MOVING)
        if part < PER_LINK_AT_REST:
            rows[:, k] = reduced[:, PER_LINK_AT_REST * link + part]
    for index, label in enumerate(problem.labels):
        own = problem.load_part(index)
        rows[:, columns.loads[label] : columns.loads[label] + PER_LINK_AT_REST] = reduced[:, own]
    changes = [columns.nuisances.get(f"{CHANGE}_{columns.occasions.index(name) + 1}") for name in _occasions(problem)]
    places = [*(columns.nuisances.get(kind) for kind in SHARED), *changes]
    for place, own in zip(places, np.split(reduced[:, problem.band_part.start :], len(places), axis=1), strict=True):
        if place is not None:
            rows[:, place] = own
    return Still(rows, right)


def _shared(problem: RestProblem) -> Ints:
    """Columns of links and loads, then of the shared nuisance parameters, then of the change on each occasion."""
    own = [problem.nuisance_part.start + KINDS.index(kind) * problem.axes + np.arange(problem.axes) for kind in SHARED]
    first = problem.nuisance_part.start + problem.nuisance.common + 1
    changes = first + np.arange(len(_occasions(problem)) * (problem.axes + 1)).reshape(-1, problem.axes + 1)
    return np.concatenate([np.arange(problem.band_part.start), *own, *changes[:, :-1]])


def _common(problem: RestProblem) -> Ints:
    """Columns of what the gains of all axes share, and of what their changes on each occasion share."""
    first = problem.nuisance_part.start + problem.nuisance.common
    return first + np.arange(len(_occasions(problem)) + 1) * (problem.axes + 1)


def _occasions(problem: RestProblem) -> tuple[tuple[str, ...], ...]:
    """Run and load of each occasion of the rest rows."""
    return problem.nuisance.changes.occasions


def _eliminated(problem: RestProblem, fit: Fit, shared: Ints) -> tuple[Floats, Floats]:
    """Rows (k, len(shared)) and right side (k,) with unit noise, after eliminating all other parameters of the rest
    rows.

    The gains and their changes are those with what all axes share: their prior is that of the moving rows.
    """
    design = fit.noise.whitened_columns(problem, fit.columns).dense
    right = fit.noise.whitened(problem, fit.residual) + design @ fit.common
    others = np.setdiff1d(np.arange(problem.n_common), [*shared, *_common(problem)])
    held = np.isfinite(fit.prior_std[others])
    others = others[held | design[:, others].any(axis=0)]
    held = np.isfinite(fit.prior_std[others])
    prior = np.diag(1.0 / fit.prior_std[others])[held]
    known = np.concatenate([prior, np.zeros((len(prior), len(shared)))], axis=1)
    stack = np.vstack([np.hstack([design[:, others], design[:, shared]]), known])
    side = np.concatenate([right, prior @ problem.common_mean[others]])
    triangle = np.asarray(np.linalg.qr(np.column_stack([stack, side]), mode="r"))
    below = triangle[len(others) :, len(others) :]
    return below[:, :-1], below[:, -1]
