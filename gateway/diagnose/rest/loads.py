"""Loads of a fit as the result file has them: mass, centre of gravity, what the data cannot give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from gateway.diagnose.rest.linear import Fit, RestProblem
from gateway.diagnose.rest.ordinary import KINDS
from gateway.diagnose.rest.thresholds import REST
from gateway.identify.budget import CONSTANTS, FRICTION, LINKS, NOISE, Sources, budget_of
from gateway.identify.load_estimate import (
    load_directions,
    load_from_moment,
    load_result,
    negative_mass,
    next_to_nothing,
    refused_load,
    unknown_load,
)
from gateway.identify.solve import Prior, determined
from gateway.model.robot import Robot
from gateway.result.result import LoadResult, NuisanceResult
from gateway.result.values import numbers

Floats = NDArray[np.float64]


def loads_of(problem: RestProblem, fit: Fit, robot: Robot, by_shape: Floats | None = None) -> tuple[LoadResult, ...]:
    """Every load that was estimated, in the order of its label.

    `by_shape` (labels, 4, 4) is what the choice of the effects' shapes leaves open about [m, h], none if not given.
    """
    further = np.zeros((len(problem.labels), 4, 4)) if by_shape is None else by_shape
    return tuple(_load(problem, fit, robot, k, further[k]) for k in range(len(problem.labels)))


def spread_by_shape(fit: Fit, alike: Sequence[tuple[float, Fit]]) -> Floats:
    """Covariance (labels, 4, 4) of [m, h] about a fit over other shapes of its effects, by their probabilities."""
    out = np.zeros((len(fit.loads), 4, 4))
    for weight, other in alike:
        away = other.loads - fit.loads
        out += weight * away[:, :, None] * away[:, None, :]
    return out


def _load(problem: RestProblem, fit: Fit, robot: Robot, index: int, by_shape: Floats) -> LoadResult:
    label, moment, part = problem.labels[index], fit.loads[index], problem.load_part(index)
    covariance = fit.covariance[part, part] + by_shape
    widening = _widening(problem, fit, part)
    turn = load_directions(moment)
    std = widening * np.sqrt(np.maximum(np.diag(turn @ covariance @ turn.T), 0.0))
    mass = float(moment[0])
    if (reason := negative_mass(mass, float(std[0]))) is not None:
        return load_result(refused_load(label, reason), robot)
    nothing = next_to_nothing(mass, float(std[0]), robot, problem.rows.sum_nm, REST.next_to_nothing)
    sure = _determined(fit, part)
    if not sure[0]:
        return load_result(unknown_load(label), robot)
    if not nothing and (std[0] > REST.blind_mass * max(abs(mass), 1e-3) or mass <= 0):
        return load_result(unknown_load(label), robot)
    found = np.concatenate([[True], sure[1:] & (not nothing) & (std[1:] <= REST.blind_m)])
    per_pose = {} if nothing or not sure.all() else _per_pose(problem, fit, index)
    load = load_from_moment(label, moment, covariance, np.full(4, widening), found, per_pose)
    return replace(load_result(load, robot), budget=_budget(problem, fit, part.start))


def _determined(fit: Fit, part: slice) -> NDArray[np.bool_]:
    """Which of a load's [m, hx, hy, hz] (4,) rows and priors determine; beside an open mass there is no centre."""
    pure = np.zeros((4, len(fit.scale)))
    pure[:, part] = np.eye(4)
    sure = determined(fit, pure)
    sure[1:] &= sure[0]
    return sure


def _budget(problem: RestProblem, fit: Fit, mass: int) -> Mapping[str, float]:
    """Share of the variance of a mass by source; one-sided rows are friction, other rows and effects are noise."""
    count, axes = len(fit.prior_std), problem.axes
    constants, links, friction = np.zeros(count), np.zeros(count), np.zeros(count)
    links[problem.link_part] = 1.0
    friction[problem.nuisance_part] = 1.0
    gains = slice(problem.nuisance_part.start, problem.nuisance_part.start + axes)
    constants[gains] = problem.nuisance.constants
    noise = np.zeros(count)
    noise[problem.n_common :] = 1.0
    further = np.zeros((len(problem.prior_rows), count))
    further[:, problem.link_part] = problem.prior_rows
    direction = np.zeros(count)
    direction[mass] = 1.0
    return budget_of(
        fit.design,
        1.0 / fit.noise.std[problem.group],
        Prior(np.zeros(count), fit.prior_std, further, np.zeros(len(further))),
        fit.covariance,
        direction,
        Sources(
            np.where(problem.group >= 2 * axes, FRICTION, NOISE),
            {CONSTANTS: constants, LINKS: links, FRICTION: friction - constants, NOISE: noise},
        ),
    )


def ordinary_of(problem: RestProblem, fit: Fit) -> dict[str, NuisanceResult]:
    """What every arm has, as fitted: of an axis that an effect takes over, the effect says it."""
    at = problem.nuisance_part
    value = fit.nuisance.reshape(len(KINDS), -1).copy()
    std = np.sqrt(np.maximum(np.diag(fit.covariance)[at], 0.0)).reshape(len(KINDS), -1)
    gone = problem.nuisance.taken_over(fit.terms)
    measured = problem.use_sum.any(axis=0)
    out = {}
    for row, kind in enumerate(KINDS):
        known = measured & ~np.isin(row * problem.axes + np.arange(problem.axes), gone)
        key = "bias_nm" if kind == "bias" else kind
        out[key] = NuisanceResult(
            numbers(np.where(known, value[row], np.nan)), numbers(np.where(known, std[row], np.nan))
        )
    return out


def _widening(problem: RestProblem, fit: Fit, part: slice) -> float:
    """Factor on the standard deviations, so that 1.96 of them hold 95 % although the noise itself is estimated.

    Student's t over the normal quantile, its degrees of freedom those of the noise of each axis, weighted by what the
    axis says about the load.
    """
    taken = problem.by_group(fit.basis.leverage)
    freedom = np.maximum(problem.by_group() - taken, 0.0) + REST.noise_weight
    told = ((fit.design[:, part] / fit.noise.std[problem.group][:, None]) ** 2).sum(axis=1)
    if not told.any():
        return 1.0
    return float(stdtrit(np.average(freedom[problem.group], weights=told), 0.975) / ndtri(0.975))


def _per_pose(problem: RestProblem, fit: Fit, index: int) -> dict[str, float]:
    """Mass from each pose alone, the centre of gravity and everything else as in the whole fit."""
    part = problem.load_part(index)
    std = fit.noise.std[problem.group]
    phi = fit.loads[index]
    mine = problem.member[problem.visit, index] > 0
    poses, place = np.unique(problem.rows.pose[problem.visit[mine]], return_inverse=True)
    share = (fit.design[:, part] @ phi / std)[mine]
    weight = np.bincount(place, weights=share**2, minlength=len(poses))
    away = np.bincount(place, weights=share * (fit.residual / std)[mine], minlength=len(poses))
    told = weight > 1.0
    mass = phi[0] * (1.0 + away[told] / weight[told])
    return dict(zip([str(int(pose)) for pose in poses[told]], mass.tolist(), strict=True))
