"""A fitted problem in words of the arm: loads, torque by axis, noise floor, base parameters of the bare arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.fitting import Fitted
from gateway.estimate.friction import friction_bands
from gateway.estimate.noise import NoiseFit
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import Problem
from gateway.identify.budget import CONSTANTS, FRICTION, LINKS, NOISE, Sources, budget_of
from gateway.identify.load_estimate import (
    LoadEstimate,
    load_directions,
    load_from_moment,
    negative_mass,
    refused_load,
    without_guesses,
)
from gateway.identify.solve import determined
from gateway.model.base import rest_base
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot, reach_m
from gateway.result.result import Bare, NuisanceResult

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_INFORMATIVE = 0.05


def describe(fitted: Fitted, robot: Robot, options: EstimateOptions) -> Estimate:
    """The estimate that a fitted problem stands for."""
    problem, fit, prior = fitted.problem, fitted.fit, fitted.prior
    solution = fit.solution
    count = len(problem.names)
    found = determined(solution, np.eye(count))
    std = np.where(found, fit.std(np.eye(count)), np.nan)
    loads = tuple(_load(fitted, robot, options, label) for label in problem.loads)
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
        nuisance=nuisances(fitted, std),
        quality={"rows": len(problem.target), "parameters": count, "offset_std_nm": prior.std[problem.offsets]},
    )


def nuisances(fitted: Fitted, std: Floats) -> dict[str, NuisanceResult]:
    """Gain, bias and loss of every axis as fitted, with standard deviations; NaN where the axis was not measured."""
    problem, value, axes = fitted.problem, fitted.fit.solution.value, fitted.problem.visits.axes

    def of(columns: Ints) -> NuisanceResult:
        out = np.full((2, axes), np.nan)
        out[:, problem.offset_axis] = value[columns], std[columns]
        return NuisanceResult(*(tuple(row) for row in out.tolist()))

    # half differences give the load friction of two-sided visits, a column that of one-sided ones
    losses = np.stack([fitted.loss, fitted.loss_std])
    alone = np.isnan(losses[0, problem.sided])
    losses[:, problem.sided[alone]] = value[problem.losses[alone]], std[problem.losses[alone]]
    loss = NuisanceResult(*(tuple(row) for row in losses.tolist()))
    return {"gain": of(problem.gains), "bias_nm": of(problem.offsets), "load_friction": loss}


def mass_budget(fitted: Fitted, label: str) -> Mapping[str, float]:
    """Share of the variance of a load's mass by source: one-sided rows are friction, all other rows noise."""
    problem, fit = fitted.problem, fitted.fit
    count = len(problem.names)
    direction = np.zeros(count)
    direction[problem.loads[label]] = 1.0
    links, friction = np.zeros(count), np.ones(count)
    links[: len(problem.links.columns)] = 1.0
    friction[: problem.offsets[0]] = 0.0
    one_sided = ~problem.visits.two_sided[problem.visit]
    return budget_of(
        problem.design,
        fit.weight,
        fitted.prior,
        fit.solution.covariance,
        direction,
        Sources(
            np.where(one_sided, FRICTION, NOISE),
            {CONSTANTS: fitted.constants, LINKS: links, FRICTION: friction - fitted.constants},
        ),
    )


def _load(fitted: Fitted, robot: Robot, options: EstimateOptions, label: str) -> LoadEstimate:
    problem, fit = fitted.problem, fitted.fit
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
    if sure[0] and (reason := negative_mass(load.mass_kg, load.mass_std_kg)) is not None:
        return refused_load(label, reason, per_pose)
    return replace(without_guesses(load, reach_m(robot)), budget=mass_budget(fitted, label) if sure[0] else {})


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
    lever = columns @ (moment / moment[0]) * (1.0 + fit.solution.value[problem.rows.gain])
    own = fit.solution.residual + lever * moment[0]
    weight = np.where(here, fit.weight**2, 0.0)
    poses, place = np.unique(problem.visits.pose[problem.visit[here]], return_inverse=True)
    strength = np.bincount(place, weights=(weight * lever**2)[here], minlength=len(poses))
    share = np.bincount(place, weights=(weight * lever * own)[here], minlength=len(poses))
    told = strength > _INFORMATIVE * strength.max(initial=0.0)
    mass = share[told] / strength[told]
    return dict(zip([str(int(pose)) for pose in poses[told]], mass.tolist(), strict=True))


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
        model_nm=spread(visits.tau_nm[problem.visit, problem.axis] - fit.solution.residual),
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
    rank, gains = base.rank, base.rank + problem.offset_axis
    directions = np.zeros((rank + robot.axes, len(solution.value)))
    directions[:rank, : len(links.columns)] = base.combination[:, links.columns]
    if not determined(solution, directions[:rank]).all():
        return None
    directions[gains, problem.gains] = 1.0
    widening = fit.widening(directions)
    covariance = directions @ fit.covariance @ directions.T * np.outer(widening, widening)
    value = directions @ solution.value
    value[:rank] += base.combination @ links.fixed
    untold = ~np.isin(np.arange(robot.axes), problem.offset_axis)
    value[rank:][untold] = np.nan
    offsets = np.full(robot.axes, np.nan)
    offsets[problem.offset_axis] = solution.value[problem.offsets]
    return Bare(
        robot=robot.name,
        gravity_m_s2=tuple(float(g) for g in options.gravity_m_s2),
        columns=tuple(base.indices.tolist()),
        names=base.names,
        value=tuple(value[:rank].tolist()),
        covariance=tuple(tuple(row) for row in covariance[:rank, :rank].tolist()),
        combination=tuple(tuple(row) for row in base.combination.tolist()),
        offset_nm=tuple(offsets.tolist()),
        gain=tuple(value[rank:].tolist()),
        gain_covariance=tuple(tuple(row) for row in covariance.tolist()),
    )
