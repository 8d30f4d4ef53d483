"""Build the least-squares problem at rest (rows, priors, noise) that all hypotheses share, from a table and a robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.identify.knowledge import EXACT, Knowledge
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.nuisance import LOAD_FRICTION, LOAD_FRICTION_STD, bias_std_nm, gain_stds, losses
from gateway.identify.prior_loads import bare_rows, load_vector, refuse_absent, stored_errors, unknown_labels
from gateway.identify.rest.linear import RestProblem
from gateway.identify.rest.rest_nuisance import GainChanges, RestNuisance
from gateway.model.rest import Model
from gateway.model.robot import Robot
from gateway.model.visits import Visits, column_medians

Floats = NDArray[np.float64]

#: Prior standard deviation [kg] and [kg m] of an unknown link: a hundred times that of any arm.
OPEN_MASS_KG = 1e3
OPEN_MOMENT_KG_M = 1e3
#: Standard deviation of a mass over that of an unknown link, above which the mass is not determined.
OPEN_SHARE = 0.1
#: Friction band of an axis that was approached from one side only, as a share of its torque.
BAND_UNSEEN = 0.05
#: The same where no approach direction is known: any part of the friction may be in the half-sum.
SIDE_UNSEEN = 0.20
#: Least standard deviation of a link without mass [kg, kg m].
LEAST_STD = 1e-10


def build_problem(robot: Robot, rows: Visits, knowledge: Knowledge, changes: GainChanges | None = None) -> RestProblem:
    """Build rows, priors and noise groups of the visits.

    `changes` are those of other visits, whose fit predicts these; of these visits where none are given.

    Raises
    ------
    InputError : a known load that is not in the data
    DataUnusable : no torque was measured
    """
    labels = tuple(sorted(unknown_labels(rows.load, knowledge.known)))
    refuse_absent(rows.load, knowledge.weighed)
    fixed = np.zeros((len(rows), 4))
    for name, known in knowledge.known.items():
        fixed[rows.load == name] = load_vector(known)
    use_sum = np.isfinite(rows.sum_nm)
    if not use_sum.any():
        raise DataUnusable(
            "no axis torque was measured at rest; a pose number and a torque or current column are needed"
        )
    use_difference = use_sum & np.isfinite(rows.difference_nm)
    axis = np.broadcast_to(np.arange(rows.axes), use_sum.shape)
    kind = np.where(use_difference, 0, 2 * rows.axes)
    links, std = open_link_prior(robot, knowledge.trust)
    nuisance = nuisance_of(rows, knowledge, changes)
    count = 4 * (rows.axes + len(labels)) + rows.axes + len(nuisance.mean)
    prior_rows, prior_target = np.zeros((0, count)), np.zeros(0)
    if knowledge.bare is not None:
        both, prior_target = bare_rows(knowledge.bare, knowledge.change)
        prior_rows = np.zeros((len(both), count))
        gains = count - len(nuisance.mean)
        prior_rows[:, : 4 * rows.axes] = both[:, : 4 * rows.axes]
        prior_rows[:, gains : gains + 2 * rows.axes] = both[:, 4 * rows.axes :]
        prior_rows[:, gains + nuisance.common] = both[:, 4 * rows.axes :][:, : rows.axes] @ nuisance.changes.relative
    for label, load in knowledge.weighed.items():
        first, (own, right) = 4 * (rows.axes + labels.index(label)), load.rows()
        prior_rows = np.vstack([prior_rows, np.pad(own, ((0, 0), (first, count - first - 4)))])
        prior_target = np.append(prior_target, right)
    return RestProblem(
        model=Model(robot, rows, np.asarray(knowledge.gravity_m_s2, dtype=float)),
        links=links,
        link_std=std,
        labels=labels,
        member=np.array([[float(load == name) for name in labels] for load in rows.load]).reshape(len(rows), -1),
        fixed_load=fixed,
        use_sum=use_sum,
        use_difference=use_difference,
        target=np.concatenate([rows.sum_nm[use_sum], rows.difference_nm[use_difference]]),
        group=np.concatenate([(axis + kind)[use_sum], axis[use_difference] + rows.axes]),
        prior_rows=prior_rows,
        prior_target=prior_target,
        nuisance=nuisance,
        parts=knowledge.parts,
    )


def open_link_prior(robot: Robot, trust: float) -> tuple[Floats, Floats]:
    """CAD value and standard deviation (4 N,) of [m, hx, hy, hz] per link; unknown links have a very wide prior."""
    mean, std = link_prior(robot, max(trust, EXACT), PER_LINK_AT_REST)
    nearly_open = np.tile([OPEN_MASS_KG, *[OPEN_MOMENT_KG_M] * 3], len(mean) // PER_LINK_AT_REST)
    return mean, np.where(np.isinf(std), nearly_open, np.maximum(std, LEAST_STD))


def sides_unknown(rows: Visits) -> NDArray[np.bool_]:
    """Return the measured axes (N,) of which no visit has an approach direction."""
    known = np.isfinite(rows.difference_nm) | (rows.side != 0)
    measured = np.isfinite(rows.sum_nm)
    return np.asarray(measured.any(axis=0) & ~(measured & known).any(axis=0))


def nuisance_of(rows: Visits, knowledge: Knowledge, changes: GainChanges | None = None) -> RestNuisance:
    """Prior of the nuisance parameters; the approach directions determine the size of bands and losses."""
    halves = np.where(np.isfinite(rows.sum_nm), rows.difference_nm, np.nan)
    count = np.maximum(np.isfinite(rows.sum_nm).sum(axis=0), 1)
    size = np.sqrt(np.nansum(rows.sum_nm**2, axis=0) / count)
    seen = column_medians(halves)
    band = np.where(np.isfinite(seen), seen, BAND_UNSEEN * size)
    lost, _ = losses(halves, rows.sum_nm)
    gain_std = gain_stds(knowledge.gain_std, rows.axes)
    lost = np.clip(np.where(np.isfinite(lost), lost, LOAD_FRICTION), 0.0, 1.0)
    if changes is None:
        changes = GainChanges.of(rows, gain_std, knowledge.change)
    # without approach directions friction is a constant and a share of the torque, of unknown sign
    unknown = sides_unknown(rows)
    bias = np.where(unknown, SIDE_UNSEEN * size, bias_std_nm(band, lost))
    friction = np.where(unknown, LOAD_FRICTION + LOAD_FRICTION_STD, 0.0)
    prior = RestNuisance.of(gain_std, bias, lost, changes, knowledge.measured_gain, friction)
    return prior if knowledge.bare is None else prior.held_elsewhere(stored_errors(knowledge.bare))
