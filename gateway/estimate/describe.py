"""A fitted problem in words of the arm: loads, torque by axis, noise floor, base parameters of the bare arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.friction import friction_bands
from gateway.estimate.noise import NoiseFit
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import Problem
from gateway.identify.load_estimate import LoadEstimate, load_directions, load_from_moment, without_guesses
from gateway.identify.solve import Prior, determined
from gateway.model.base import rest_base
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot, reach_m
from gateway.result.result import Bare

Floats = NDArray[np.float64]

_INFORMATIVE = 0.05


def describe(problem: Problem, fit: NoiseFit, prior: Prior, robot: Robot, options: EstimateOptions) -> Estimate:
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


def _load(problem: Problem, fit: NoiseFit, robot: Robot, options: EstimateOptions, label: str) -> LoadEstimate:
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
    load = load_from_moment(label, moment, fit.covariance[part, part], widening, sure, per_pose)
    return without_guesses(load, reach_m(robot))


def per_pose_mass(
    problem: Problem, fit: NoiseFit, robot: Robot, options: EstimateOptions, label: str
) -> dict[str, float]:
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
    least = _INFORMATIVE * max(strength.values(), default=0.0)
    return {
        str(pose): float(np.sum((weight * lever * own)[poses == pose]) / value)
        for pose, value in strength.items()
        if value > least
    }


def fitted_rows(problem: Problem, fit: NoiseFit) -> FittedRows:
    """Measured and modelled torque of every visit."""
    visits = problem.visits

    def spread(values: Floats) -> Floats:
        out = np.full((len(visits), visits.axes), np.nan)
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
    """Typical standard deviation (N,) [Nm] of the rows of each axis; NaN where not measured."""
    return np.array(
        [
            float(np.sqrt(np.median(fit.weight[problem.axis == k] ** -2.0))) if (problem.axis == k).any() else np.nan
            for k in range(problem.visits.axes)
        ]
    )


def bare_of(problem: Problem, fit: NoiseFit, robot: Robot, options: EstimateOptions) -> Bare | None:
    """Base gravity parameters of the bare arm, if rows and priors determine all of them."""
    links, solution = problem.links, fit.solution
    base = rest_base(robot, options.gravity_m_s2)
    directions = np.zeros((base.rank, len(solution.value)))
    directions[:, : len(links.columns)] = base.combination[:, links.columns]
    if not determined(solution, directions).all():
        return None
    widening = fit.widening(directions)
    covariance = directions @ fit.covariance @ directions.T * np.outer(widening, widening)
    offsets = np.full(robot.axes, np.nan)
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
