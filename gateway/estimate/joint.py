"""Joint solution: all rest rows of all loads at once, weighted by what their noise really is.

Unknown are the links as far as the priors leave them open, four numbers per load, and a torque offset per axis whose
size is a fraction of the friction band that the data choose. The noise of each axis is the sampled one and what the
friction leaves after both approaches, estimated from the residuals and from the scatter of the half differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.consistency import CONTRADICTS, describe_masses, disagree
from gateway.estimate.describe import axis_sigma, describe, per_pose_mass
from gateway.estimate.estimate import Estimate
from gateway.estimate.fitting import Fitted, fit_problem
from gateway.estimate.noise import NoiseFit
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import Problem, build_problem
from gateway.identify.load_estimate import LoadEstimate, refused_load
from gateway.identify.loads import require_postures
from gateway.model.robot import Robot
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

MOST_LINK_ROWS = 30


def estimate_joint(visits: Visits, robot: Robot, options: EstimateOptions) -> Estimate:
    """Estimate all unknown loads together.

    A load whose data contradict each other is refused; the others are then estimated without its rows.

    Parameters
    ----------
    visits : Visits
    robot : Robot
    options : EstimateOptions

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        Nothing measured, or a load in one posture only (rank 3).
    """
    problem = build_problem(visits, robot, options)
    for label in problem.loads:
        require_postures(visits.q_rad[visits.load == label], label)
    fitted = fit_problem(problem, options)
    refused = refused_loads(fitted, robot, options)
    if not refused:
        return describe(fitted, robot, options)
    kept = visits.take(~np.isin(visits.load, list(refused)))
    others = tuple(refused.values())
    if not len(kept):
        unknown = np.full(visits.axes, np.nan)
        return Estimate(method="joint", loads=others, sigma_nm=unknown, band_nm=unknown)
    known = {label: value for label, value in options.known.items() if label in kept.load}
    rest = estimate_joint(kept, robot, replace(options, known=known))
    return replace(rest, loads=(*rest.loads, *others))


def refused_loads(fitted: Fitted, robot: Robot, options: EstimateOptions) -> dict[str, LoadEstimate]:
    """Loads by label whose data contradict each other, each with why."""
    problem, fit = fitted.problem, fitted.fit
    reasons = {label: contradiction(problem, fit, robot, options, label) for label in problem.loads}
    return {
        label: refused_load(label, reason, per_pose_mass(problem, fit, robot, options, label))
        for label, reason in reasons.items()
        if reason is not None
    }


def contradiction(problem: Problem, fit: NoiseFit, robot: Robot, options: EstimateOptions, label: str) -> str | None:
    """Why the rows of a load cannot belong to one rigid body, judged by the noise that the other rows show."""
    masses = per_pose_mass(problem, fit, robot, options, label)
    if not disagree(list(masses.values())):
        return None
    kept = problem.visits.take(problem.visits.load != label)
    if not len(kept):
        return None
    known = {name: value for name, value in options.known.items() if name in kept.load}
    without = replace(options, known=known)
    others = build_problem(kept, robot, without)
    if len(others.target) < MOST_LINK_ROWS:
        return None
    sigma = axis_sigma(others, fit_problem(others, without).fit)
    here = (problem.visits.load[problem.visit] == label) & np.isfinite(sigma[problem.axis])
    excess = float(np.sqrt(np.mean((fit.solution.residual[here] / sigma[problem.axis[here]]) ** 2)))
    if excess < CONTRADICTS:
        return None
    return (
        f"its rows contradict each other: the poses alone would give {describe_masses(masses)}, and the residual is"
        f" {excess:.0f} times the noise of the other rows"
    )
