"""A problem of rest rows solved: noise, size of the torque offsets, losses and gains, each chosen by the data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.friction import friction_bands, noise_groups
from gateway.estimate.gains import settled
from gateway.estimate.noise import NoiseFit, fit_noise, noise_levels
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import Problem
from gateway.identify.nuisance import NuisancePrior, gain_stds, held_by_friction, losses, nuisance_prior
from gateway.identify.solve import Prior, solve

Floats = NDArray[np.float64]

OFFSET_SHARES = (0.0, 0.03, 0.1, 0.3, 1.0)
_CLEARLY = 1.0
#: Share of the scale of each noise group that the first weights take it for.
_FIRST_SHARE = 0.1
#: Times that losses, noise and offsets are chosen anew about the last solution.
_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A problem about its solution, the fit, and what was taken for granted.

    `prior` as chosen, `constants` (p,) the share of each prior's variance that the torque constants have, `loss` (N,)
    over transmitted torque with its standard deviation.
    """

    problem: Problem
    fit: NoiseFit
    prior: Prior
    constants: Floats
    loss: Floats
    loss_std: Floats


def fit_problem(problem: Problem, options: EstimateOptions) -> Fitted:
    """Solve with gains, and with noise and offset size chosen by the data."""
    visits, rows = problem.visits, problem.rows
    groups = noise_groups(visits, problem.visit, problem.axis)
    scale = groups.scale_nm[problem.offset_axis]
    bands = friction_bands(visits)
    stds = gain_stds(options.gain_std, visits.axes)
    nuisance = nuisance_prior(stds, bands, np.full(visits.axes, np.nan))
    bias = np.where(np.isfinite(bands), nuisance.bias_std_nm, 0.0)[problem.offset_axis]
    prior = _with_gains(problem, nuisance, options).with_std(problem.offsets, np.hypot(0.1 * scale, bias))
    weight = 1.0 / np.sqrt(groups.stated + (_FIRST_SHARE * groups.scale_nm[groups.index]) ** 2)
    value = settled(rows, weight, prior, np.zeros(len(problem.names)))
    loss, loss_std = np.full((2, visits.axes), np.nan)
    for _ in range(_ROUNDS):
        torque = np.full(visits.tau_nm.shape, np.nan)
        torque[problem.visit, problem.axis] = rows.torque(value)
        loss, loss_std = losses(visits.band_nm, torque)
        nuisance = nuisance_prior(stds, bands, loss, held_by_friction(torque, bands))
        bias = np.where(np.isfinite(bands), nuisance.bias_std_nm, 0.0)[problem.offset_axis]
        prior = _with_gains(problem, nuisance, options).with_std(problem.offsets, prior.std[problem.offsets])
        design, target = rows.about(value)
        levels = noise_levels(design, target, prior, groups)
        about = replace(problem, design=design, target=target, prior=prior)
        share = _offset_share(about, levels.weight, scale, bias)
        prior = prior.with_std(problem.offsets, np.maximum(np.hypot(share * scale, bias), 1e-7 * scale))
        value = settled(rows, levels.weight, prior, value)
    design, target = rows.about(value)
    about = replace(problem, design=design, target=target, prior=prior)
    constants = np.zeros(len(problem.names))
    constants[problem.gains] = np.minimum(stds[problem.offset_axis] / prior.std[problem.gains], 1.0) ** 2
    return Fitted(about, fit_noise(design, target, prior, groups), prior, constants, loss, loss_std)


def _with_gains(problem: Problem, nuisance: NuisancePrior, options: EstimateOptions) -> Prior:
    """The problem's prior with that of gains and load friction.

    Where a bare identification knows a gain, it is its own prior.
    """
    mean, std = problem.prior.mean.copy(), problem.prior.std.copy()
    mean[problem.gains], std[problem.gains] = nuisance.gain[problem.offset_axis], nuisance.gain_std[problem.offset_axis]
    mean[problem.losses] = nuisance.load_friction[problem.sided]
    std[problem.losses] = nuisance.load_friction_std[problem.sided]
    if options.bare is not None and options.bare.gain:
        told = np.isfinite(np.asarray(options.bare.gain))[problem.offset_axis]
        std[problem.gains[told]] = np.inf
    return Prior(mean, std, problem.prior.rows, problem.prior.right)


def _offset_share(problem: Problem, weight: Floats, scale: Floats, bias: Floats) -> float:
    """Size of the offsets as a share of their scale, beside the bias: the one with the greatest marginal likelihood."""
    best, best_value = OFFSET_SHARES[0], -np.inf
    for share in OFFSET_SHARES:
        std = np.maximum(np.hypot(share * scale, bias), 1e-7 * scale)
        solution = solve(problem.design, problem.target, weight, problem.prior.with_std(problem.offsets, std))
        value = -0.5 * (solution.misfit + solution.log_determinant) - float(np.sum(np.log(std)))
        if value > best_value + (_CLEARLY if best == 0.0 and share > 0.0 and np.isfinite(best_value) else 0.0):
            best, best_value = share, value
    return best
