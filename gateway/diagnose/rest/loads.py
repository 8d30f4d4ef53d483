"""Loads of a fit as the result file has them: mass, centre of gravity, what the data cannot give."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from gateway.diagnose.rest.linear import Fit, RestProblem
from gateway.diagnose.rest.thresholds import REST
from gateway.model.robot import Robot
from gateway.result.result import LoadResult

Floats = NDArray[np.float64]

NAMES = ("com_x", "com_y", "com_z")


def loads_of(problem: RestProblem, fit: Fit, robot: Robot) -> tuple[LoadResult, ...]:
    """Every load that was estimated, in the order of its label."""
    return tuple(_load(problem, fit, robot, k) for k in range(len(problem.labels)))


def _load(problem: RestProblem, fit: Fit, robot: Robot, index: int) -> LoadResult:
    label = problem.labels[index]
    phi = fit.loads[index]
    part = problem.load_part(index)
    covariance = fit.covariance[part, part] * _widening(problem, fit, part) ** 2
    mass, mass_std = float(phi[0]), float(np.sqrt(covariance[0, 0]))
    if mass + REST.against_mass * mass_std < 0:
        reason = f"the data ask for a mass of {mass:.3g} kg (standard deviation {mass_std:.2g} kg)"
        return LoadResult(label, refused=reason)
    if mass_std > REST.blind_mass * max(abs(mass), 1e-3) or mass <= 0:
        return LoadResult(label, unidentifiable=("mass", *NAMES))
    com = phi[1:] / mass
    slope = np.zeros((4, 4))
    slope[0, 0] = 1.0
    slope[1:, 0] = -com / mass
    slope[1:, 1:] = np.eye(3) / mass
    spread = slope @ covariance @ slope.T
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    blind = std[1:] > REST.blind_m
    known = np.where(blind, math.nan, com)
    scale = np.where(std > 0, std, 1.0)
    flange = None if robot.flange is None else _in_flange(known, robot.flange)
    return LoadResult(
        label=label,
        mass_kg=mass,
        mass_std_kg=mass_std,
        com_m=tuple(float(v) for v in known),
        com_std_m=tuple(float(v) for v in np.where(blind, math.nan, std[1:])),
        com_flange_m=flange,
        correlation=tuple(tuple(float(v) for v in row) for row in spread / np.outer(scale, scale)),
        unidentifiable=tuple(name for name, missing in zip(NAMES, blind, strict=True) if missing),
        per_pose_mass_kg=_per_pose(problem, fit, index),
    )


def _widening(problem: RestProblem, fit: Fit, part: slice) -> float:
    """Factor on the standard deviations, so that 1.96 of them hold 95 % although the noise itself is estimated.

    Student's t over the normal quantile, its degrees of freedom those of the noise of each axis, weighted by what the
    axis says about the load.
    """
    taken = problem.by_group((fit.orthogonal**2).sum(axis=1))
    freedom = np.maximum(problem.by_group() - taken, 0.0) + REST.noise_weight
    told = ((fit.design[:, part] / fit.noise.std[problem.group][:, None]) ** 2).sum(axis=1)
    if not told.any():
        return 1.0
    return float(t.ppf(0.975, np.average(freedom[problem.group], weights=told)) / norm.ppf(0.975))


def _in_flange(com_m: Floats, flange: Floats) -> tuple[float, ...]:
    return tuple(float(v) for v in flange[:3, :3].T @ (com_m - flange[:3, 3]))


def _per_pose(problem: RestProblem, fit: Fit, index: int) -> dict[str, float]:
    """Mass from each pose alone, the centre of gravity and everything else as in the whole fit."""
    part = problem.load_part(index)
    std = fit.noise.std[problem.group]
    phi = fit.loads[index]
    share = fit.design[:, part] @ phi / std
    visit = problem.visit
    out: dict[str, float] = {}
    mine = problem.member[:, index] > 0
    for pose in np.unique(problem.rows.pose[mine]):
        rows = np.isin(visit, np.flatnonzero(mine & (problem.rows.pose == pose)))
        weight = float(share[rows] @ share[rows])
        if weight > 1.0:
            out[str(int(pose))] = float(phi[0] * (1.0 + share[rows] @ (fit.residual / std)[rows] / weight))
    return out
