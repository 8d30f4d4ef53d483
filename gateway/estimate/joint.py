"""Joint solution: all rest rows of all loads at once, weighted by what their noise really is.

Unknown are the links as far as the priors leave them open, four numbers per load, and a torque offset per axis whose
size is a fraction of the friction band that the data choose. The noise of each axis is the sampled one and what the
friction leaves after both approaches, estimated from the residuals and from the scatter of the half differences.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.estimate import Estimate, FittedRows, LoadEstimate, load_directions, load_from_moment
from gateway.estimate.friction import friction_bands, noise_groups
from gateway.estimate.linear import Prior, determined, solve
from gateway.estimate.noise import Groups, NoiseFit, fit_noise, noise_levels
from gateway.estimate.options import Options
from gateway.estimate.problem import Problem, build_problem
from gateway.model.base import rest_base
from gateway.model.kinematics import gravity_in_link_6, largest_angle_rad
from gateway.model.regressor import load_regressor
from gateway.model.robot import AXES, Robot
from gateway.model.visits import Visits
from gateway.result import Bare

Floats = NDArray[np.float64]

OFFSET_SHARES = (0.0, 0.03, 0.1, 0.3, 1.0)
_SAME_POSE_RAD = 0.05
_CLEARLY = 1.0


def estimate_joint(visits: Visits, robot: Robot, options: Options) -> Estimate:
    """Estimate all unknown loads together.

    Parameters
    ----------
    visits : Visits
    robot : Robot
    options : Options

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        Nothing measured, or a load in one posture only (rank 3).
    """
    problem = build_problem(visits, robot, options)
    for label in problem.loads:
        require_postures(visits, label)
    fit, prior = fit_problem(problem)
    return describe(problem, fit, prior, robot, options)


def require_postures(visits: Visits, label: str) -> None:
    """Refuse a load that was measured in a single posture.

    Raises
    ------
    DataUnusable
    """
    q = visits.q_rad[visits.load == label]
    if len(q) and np.ptp(q, axis=0).max() < _SAME_POSE_RAD:
        raise DataUnusable(
            f"load '{label}' was measured in one posture: its rows have rank 3, because the part of the centre of mass"
            " along gravity turns no axis; add at least one posture in which gravity comes from another side of the"
            " flange (more than 30 degrees apart), ten are better"
        )


def fit_problem(problem: Problem) -> tuple[NoiseFit, Prior]:
    """Solve with noise and offset size chosen by the data; the prior holds the offsets as chosen."""
    groups = noise_groups(problem.visits, problem.visit, problem.axis)
    bands = friction_bands(problem.visits)
    scale = offset_scale(problem, groups, bands)
    prior = problem.prior.with_std(problem.offsets, 0.1 * scale)
    levels = noise_levels(problem.design, problem.target, prior, groups)
    share = _offset_share(problem, levels.weight, scale)
    prior = problem.prior.with_std(problem.offsets, np.maximum(share, 1e-7) * scale)
    return fit_noise(problem.design, problem.target, prior, groups), prior


def offset_scale(problem: Problem, groups: Groups, bands: Floats) -> Floats:
    """Size (k,) [Nm] an offset may have: the friction band, or where none was seen the level of the torque's noise."""
    del groups
    own = bands[problem.offset_axis]
    rms = np.array([np.sqrt(np.mean(problem.target[problem.axis == k] ** 2)) for k in problem.offset_axis])
    share = np.nanmedian(own / rms) if np.isfinite(own).any() else 0.05
    return np.maximum(np.where(np.isfinite(own), own, share * rms), 1e-9)


def _offset_share(problem: Problem, weight: Floats, scale: Floats) -> float:
    """Standard deviation of the offsets as a share of their scale: the one with the greatest marginal likelihood."""
    best, best_value = OFFSET_SHARES[0], -np.inf
    for share in OFFSET_SHARES:
        std = max(share, 1e-7) * scale
        solution = solve(problem.design, problem.target, weight, problem.prior.with_std(problem.offsets, std))
        value = -0.5 * (solution.misfit + solution.log_determinant) - float(np.sum(np.log(std)))
        if value > best_value + (_CLEARLY if best == 0.0 and share > 0.0 and np.isfinite(best_value) else 0.0):
            best, best_value = share, value
    return best


def describe(problem: Problem, fit: NoiseFit, prior: Prior, robot: Robot, options: Options) -> Estimate:
    """The estimate that a fitted problem stands for."""
    solution = fit.solution
    count = len(problem.names)
    found = determined(solution, np.eye(count))
    std = np.where(found, fit.std(np.eye(count)), np.nan)
    loads = tuple(_load(problem, fit, robot, options, label) for label in problem.loads)
    lumped = tuple(name for name, good in zip(problem.names, found, strict=True) if not good)
    return Estimate(
        method="joint",
        loads=loads,
        names=problem.names,
        units=problem.units,
        value=np.where(found, solution.value, np.nan),
        std=std,
        covariance=fit.covariance,
        rows=fitted_rows(problem, fit),
        sigma_nm=axis_sigma(problem, fit),
        band_nm=friction_bands(problem.visits),
        rank=solution.rank,
        condition=solution.condition,
        lumped=lumped,
        bare=bare_of(problem, fit, robot, options),
        quality={"rows": len(problem.target), "parameters": count, "offset_std_nm": prior.std[problem.offsets]},
    )


def _load(problem: Problem, fit: NoiseFit, robot: Robot, options: Options, label: str) -> LoadEstimate:
    first = problem.loads[label]
    part = slice(first, first + 4)
    solution = fit.solution
    moment = solution.value[part]
    turn = load_directions(moment)
    directions = np.zeros((4, len(solution.value)))
    directions[:, part] = turn
    pure = np.zeros_like(directions)
    pure[:, part] = np.eye(4)
    sure = determined(solution, pure)
    sure[1:] &= sure[0]
    widening = fit.widening(directions)
    per_pose = per_pose_mass(problem, fit, robot, options, label) if sure.all() else {}
    return load_from_moment(label, moment, fit.covariance[part, part], widening, sure, per_pose)


def per_pose_mass(problem: Problem, fit: NoiseFit, robot: Robot, options: Options, label: str) -> dict[str, float]:
    """Mass [kg] that each pose alone would give, its centre of mass taken as estimated; informative poses only."""
    first = problem.loads[label]
    moment = fit.solution.value[first : first + 4]
    if abs(moment[0]) < 1e-9:
        return {}
    here = problem.visits.load[problem.visit] == label
    columns = load_regressor(robot, problem.visits.q_rad, options.gravity_m_s2)[problem.visit, problem.axis]
    lever = columns @ (moment / moment[0])
    own = fit.solution.residual + lever * moment[0]
    weight = np.where(here, fit.weight**2, 0.0)
    poses = problem.visits.pose[problem.visit]
    strength = {int(pose): float(np.sum((weight * lever**2)[poses == pose])) for pose in np.unique(poses[here])}
    least = 0.05 * max(strength.values(), default=0.0)
    return {
        str(pose): float(np.sum((weight * lever * own)[poses == pose]) / value)
        for pose, value in strength.items()
        if value > least
    }


def fitted_rows(problem: Problem, fit: NoiseFit) -> FittedRows:
    """Measured and modelled torque of every visit."""
    visits = problem.visits

    def spread(values: Floats) -> Floats:
        out = np.full((len(visits), AXES), np.nan)
        out[problem.visit, problem.axis] = values
        return out

    return FittedRows(
        run=visits.run,
        load=visits.load,
        pose=visits.pose,
        time_s=visits.time_s,
        q_rad=visits.q_rad,
        direction=visits.direction,
        tau_nm=visits.tau_nm,
        model_nm=spread(problem.target - fit.solution.residual + problem.known_nm),
        band_nm=visits.band_nm,
        std_nm=spread(1.0 / fit.weight),
        leverage=spread(fit.solution.leverage),
    )


def axis_sigma(problem: Problem, fit: NoiseFit) -> Floats:
    """Typical standard deviation (6,) [Nm] of the rows of each axis; NaN where not measured."""
    return np.array(
        [
            float(np.sqrt(np.median(fit.weight[problem.axis == k] ** -2.0))) if (problem.axis == k).any() else np.nan
            for k in range(AXES)
        ]
    )


def bare_of(problem: Problem, fit: NoiseFit, robot: Robot, options: Options) -> Bare | None:
    """Base gravity parameters of the bare arm, if rows and priors determine all of them."""
    links, solution = problem.links, fit.solution
    base = rest_base(robot, options.gravity_m_s2)
    directions = np.zeros((base.rank, len(solution.value)))
    directions[:, : len(links.columns)] = base.combination[:, links.columns]
    if not determined(solution, directions).all():
        return None
    widening = fit.widening(directions)
    covariance = directions @ fit.covariance @ directions.T * np.outer(widening, widening)
    offsets = np.full(AXES, np.nan)
    offsets[problem.offset_axis] = solution.value[problem.offsets]
    return Bare(
        robot=robot.name,
        gravity_m_s2=tuple(float(g) for g in options.gravity_m_s2),
        columns=tuple(base.indices.tolist()),
        names=base.names,
        value=tuple((directions @ solution.value + base.combination @ links.fixed).tolist()),
        covariance=tuple(tuple(row) for row in covariance.tolist()),
        combination=tuple(tuple(row) for row in base.combination.tolist()),
        offset_nm=tuple(offsets.tolist()),
    )


def gravity_angle_rad(visits: Visits, labels: Sequence[str], robot: Robot, options: Options) -> float:
    """Largest angle [rad] between the directions of gravity in link 6 over the visits of these loads."""
    here = np.isin(visits.load, list(labels))
    return largest_angle_rad(gravity_in_link_6(robot, visits.q_rad[here], options.gravity_m_s2))
