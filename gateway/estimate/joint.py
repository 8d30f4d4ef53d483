"""Joint estimate: one least-squares fit to the rest rows of all loads, with the rest model without effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.estimate import CONTRADICTS, Estimate, axis_sigma, describe, describe_masses, disagree
from gateway.identify.alternatives import spread_of_loads
from gateway.identify.conflict import SettledKnowledge, settle, two_bodies
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import LoadEstimate, refused_load
from gateway.identify.mass_change import mass_changes, reversed_gravity
from gateway.identify.prior_loads import require_postures, unknown_labels
from gateway.identify.rest.hypothesis_fit import fit_without_effects, with_place_effects
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import per_pose_mass
from gateway.model.robot import Robot
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Rows from which the other loads of a table show their own noise.
_LEAST_ROWS = 30


def estimate_joint(
    visits: Visits, robot: Robot, knowledge: Knowledge, settled: SettledKnowledge | None = None
) -> Estimate:
    """Estimate all unknown loads in one fit.

    A load whose data contradict each other is refused; the others are then estimated without its rows.

    Parameters
    ----------
    visits : Visits
    robot : Robot
    knowledge : Knowledge
    settled : SettledKnowledge, optional
        Knowledge as tested against these visits, if already computed.

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        Nothing measured, a load in one posture only (rank 3), or a mass that changes on the unloaded arm.
    """
    for label in unknown_labels(visits.load, knowledge.known):
        require_postures(visits.q_rad[visits.load == label], label)
    settled = settle(robot, visits, knowledge) if settled is None else settled
    problem, fit = settled.stated
    refused = {
        label: refused_load(label, reason, per_pose_mass(problem, fit, problem.labels.index(label)))
        for label, reason in two_bodies(robot, visits, settled.knowledge).items()
    }
    refused |= refused_loads(problem, fit, robot, knowledge)
    if not refused:
        gravity = reversed_gravity(robot, *settled.stated, knowledge)
        fitted, tested = with_place_effects(settled.fit), settled.knowledge
        # widened by statements that may be wrong unseen
        spread = spread_of_loads(robot, settled.problem, fitted, tested)
        found = describe(settled.problem, fitted, robot, tested, spread)
        findings = (*found.findings, *settled.findings)
        if settled.conflict is None or gravity:
            return replace(found, findings=(*findings, *gravity))
        loads = tuple(refused_load(load.label, settled.conflict.what) for load in found.loads)
        return replace(found, loads=loads, findings=(*findings, settled.conflict), bare=None)
    kept = visits.take(~np.isin(visits.load, list(refused)))
    others = tuple(refused[label] for label in problem.labels if label in refused)
    if not len(kept):
        unknown = np.full(visits.axes, np.nan)
        return Estimate(method="joint", loads=others, sigma_nm=unknown, band_nm=unknown)
    rest = estimate_joint(kept, robot, knowledge.of_loads(kept.load))
    return replace(rest, loads=(*rest.loads, *others))


def refused_loads(problem: RestProblem, fit: Fit, robot: Robot, knowledge: Knowledge) -> dict[str, LoadEstimate]:
    """Return the loads by label whose data contradict each other, each with the reason.

    Where the visits of the unloaded arm or of a known load contradict each other, these and all loads are listed: each
    load is a difference to them.

    Raises
    ------
    DataUnusable
        Such visits, and no load is to be estimated.
    """
    changed = mass_changes(problem, fit)
    base = [label for label in changed if label not in problem.labels]
    if base and not problem.labels:
        raise DataUnusable(f"load '{base[0]}': {changed[base[0]]}")
    out = {label: refused_load(label, changed[label]) for label in base}
    for index, label in enumerate(problem.labels):
        reason = changed[base[0]] if base else changed.get(label)
        reason = reason or _contradiction(problem, fit, robot, knowledge, label)
        if reason is not None:
            out[label] = refused_load(label, reason, per_pose_mass(problem, fit, index))
    return out


def _contradiction(problem: RestProblem, fit: Fit, robot: Robot, knowledge: Knowledge, label: str) -> str | None:
    """Return why the rows of a load do not fit one rigid body, judged by the noise of the other rows; else None."""
    masses = per_pose_mass(problem, fit, problem.labels.index(label))
    if not disagree(list(masses.values())):
        return None
    visits = problem.rows
    kept = visits.take(visits.load != label)
    if np.isfinite(kept.sum_nm).sum() < _LEAST_ROWS:
        return None
    others = build_problem(robot, kept, knowledge.of_loads(kept.load))
    sigma = axis_sigma(others, fit_without_effects(others))
    rows = int(problem.use_sum.sum())
    axis = problem.axis[:rows]
    here = (visits.load[problem.visit[:rows]] == label) & np.isfinite(sigma[axis])
    excess = float(np.sqrt(np.mean((fit.residual[:rows][here] / sigma[axis[here]]) ** 2)))
    if excess < CONTRADICTS:
        return None
    return (
        f"its rows contradict each other: the poses alone would give {describe_masses(masses)}, and the residual is"
        f" {excess:.0f} times the noise of the other rows"
    )
