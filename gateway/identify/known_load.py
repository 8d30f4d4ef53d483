"""Test stated masses of known loads against rest visits.

A known load is freed and gets a wide prior about the stated value. Its marginal likelihood over that of the stated load
is compared with those of wider constants and links. A mass that is wrong by 30 % and constants that are all wrong by 30
% give equal readings, but the constants have a datasheet's tolerance.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import load_directions
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import well_determined
from gateway.model.robot import Robot, reach_m
from gateway.result.finding import Finding
from gateway.result.interval import PLUS_MINUS, TWO_SIDED_95

Floats = NDArray[np.float64]

#: Prior of a wrong statement: standard deviation of the mass over the stated one, of the centre over the arm's reach.
_WRONG_MASS: Final = 0.5
_WRONG_CENTRE: Final = 0.1


def least_supported(
    robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge
) -> tuple[Knowledge | None, float]:
    """Return the knowledge without the least supported known load, and the log odds against its statement.

    None where no load is known.
    """
    tried = [
        (_free_odds(robot, problem, fit, knowledge, label), knowledge.without_load(label))
        for label in knowledge.stated_loads
    ]
    odds, freed = max(tried, key=lambda each: each[0], default=(-np.inf, None))
    return freed, float(odds)


def _free_odds(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge, label: str) -> float:
    """Log marginal likelihood of a free load over that of the stated one."""
    load = knowledge.stated_loads[label]
    if not load.mass_kg > 0.0:
        return -np.inf
    stated = load.mass_kg * np.array([1.0, *(load.com_m or (0.0,) * 3)])
    std = load.mass_kg * np.array([_WRONG_MASS, *[_WRONG_CENTRE * reach_m(robot)] * 3])
    held = 1 if load.com_m is None else 4
    freed = build_problem(robot, problem.rows, knowledge.without_load(label), problem.nuisance.changes)
    prior = np.zeros((held, freed.n_common))
    prior[:, freed.load_part(freed.labels.index(label))] = np.diag(1.0 / std)[:held]
    freed = replace(
        freed,
        prior_rows=np.vstack([freed.prior_rows, prior]),
        prior_target=np.append(freed.prior_target, (stated / std)[:held]),
    )
    before = fit.evidence
    if label in knowledge.weighed:  # the norm of its prior; a load that is known exactly has none
        rows, _ = load.rows()
        before += float(np.sum(np.log(np.diag(rows[:, :held]))))
    return fit_without_effects(freed).evidence - float(np.sum(np.log(std[:held]))) - before


def load_contradicted(
    robot: Robot, problem: RestProblem, fit: Fit, stated: Knowledge, label: str
) -> tuple[float, Finding]:
    """Report a stated load that the measurement contradicts, with the standard deviations by which it differs."""
    load = stated.stated_loads[label]
    mass_kg, centre = load.mass_kg, load.com_m or ()
    moment, part = fit.loads[problem.labels.index(label)], problem.load_part(problem.labels.index(label))
    turn = np.zeros((4, len(fit.scale)))
    turn[:, part] = load_directions(moment)
    std = np.sqrt(np.maximum(np.diag(turn @ fit.covariance @ turn.T), 1e-18))
    std = np.where(well_determined(problem, fit, np.eye(len(fit.scale))[part]), std, np.inf)
    found = np.array([moment[0], *(moment[1:] / moment[0])])
    away = np.abs(found - np.array([mass_kg, *centre, *found[1 + len(centre) :]]))
    away /= np.hypot(std, [load.mass_std_kg, *[load.com_std_m] * 3])
    longest_m = reach_m(robot)
    by_mass = bool(away[0] >= away[1:].max()) or not (std[1:] < longest_m).all()
    if by_mass:
        half = TWO_SIDED_95 * std[0]
        what = f"mass of {mass_kg:.4g} kg is contradicted by the measurement, which gives {found[0]:.4g}"
        what += f" {PLUS_MINUS} {half:.2g} kg (95 %) with the stated torque constants"
        advice = "weigh the load, check its unit (kg) and which load was mounted; if the mass is right, the torque"
        advice += f" constants of all axes are wrong by a factor of {mass_kg / found[0]:.3g} (rms or peak value)"
    else:
        each = [", ".join(f"{1e3 * x:.0f}" for x in values) for values in (centre, found[1:], TWO_SIDED_95 * std[1:])]
        what = f"centre of gravity ({each[0]}) mm is contradicted by the measurement, which gives ({each[1]})"
        what += f" {PLUS_MINUS} ({each[2]}) mm (95 %)"
        advice = "check the frame of the centre (last link or flange), its unit, and which load was mounted"
    what = f"the stated {what}; the statement is not used"
    return float(away.max()), Finding("warn", f"load {label}", what, advice, "known_load")
