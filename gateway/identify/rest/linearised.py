"""Fit without effects, linearised at its solution, to evaluate other priors at little cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.rest.hypothesis_fit import log_density, noise_std
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.solve import NOTHING

Floats = NDArray[np.float64]

#: Relative size of an undetermined direction: it contributes equally to every alternative.
_SINGULAR: Final = 1e-14
#: Relative size up to which a direction counts as undetermined and is left out of step and covariance.
_OPEN: Final = 1e-12
#: Iterations of the noise of an alternative.
_NOISE_STEPS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class TriedPrior:
    """Result of an alternative prior: marginal likelihood, step (p,) from the solution of the fit, covariance (p, p).

    `log_evidence` is the logarithm of the marginal likelihood, up to what all priors share.
    """

    log_evidence: float
    step: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedFit:
    """Products of the columns of a fit by noise group; the cost of a prior does not depend on the number of rows.

    Rows are whitened by the noise of the fit, which alternatives scale by a factor for each group.

    Attributes
    ----------
    gram : (groups, p + e, p + e), right : (groups, p + e), square : (groups,) products of columns and residual
    count : (groups,) rows
    start, least : (groups,) start value of the noise, and what it does not fall below, over the noise of the fit
    """

    problem: RestProblem
    fit: Fit
    gram: Floats
    right: Floats
    square: Floats
    count: Floats
    start: Floats
    least: Floats

    @staticmethod
    def of(problem: RestProblem, fit: Fit, further: Floats | None = None) -> LinearisedFit:
        """Linearise a fit; `further` (rows, e) are columns of parameters that are 0 in it."""
        noise, groups = fit.noise, 3 * problem.axes
        columns = fit.columns if further is None else fit.columns.beside(further)
        gram, right = np.zeros((groups, columns.width, columns.width)), np.zeros((groups, columns.width))
        residual = noise.whitened(problem, fit.residual)
        for rows, own, values in noise.whitened_columns(problem, columns).parts:
            group = int(problem.group[rows[0]])
            gram[group][np.ix_(own, own)] += values.T @ values
            right[group][own] += values.T @ residual[rows]
        square, count = problem.by_group(residual**2), problem.by_group(noise.independent(problem))
        used = np.flatnonzero(count > 0)
        # what places add to the noise is estimated with the fit: its own value is where the noise begins
        start, least = (each[used] / noise.std[used] for each in (noise.start, noise.least))
        start = np.ones_like(start) if noise.effects else start
        return LinearisedFit(problem, fit, gram[used], right[used], square[used], count[used], start, least)

    def tried(self, std: Floats, link_scale: float = 0.0, further_std: Floats | None = None) -> TriedPrior:
        """Solve with prior standard deviations (p,).

        `link_scale` is the standard deviation of a factor on all link masses: CAD without motors, or of another alloy.
        `further_std` (e,) is that of the further parameters; 0 = they are left out, as they all are where it is None.
        """
        problem, fit = self.problem, self.fit
        width = len(std)
        more = np.zeros(self.gram.shape[1] - width) if further_std is None else further_std
        kept = np.append(np.arange(width), width + np.flatnonzero(more > 0))
        gram, right = self.gram[:, kept][:, :, kept], self.right[:, kept]
        std = np.append(std, more[more > 0])
        held = np.isfinite(std)
        pull = np.append(problem.common_mean - fit.common, np.zeros(len(kept) - width))
        precision = np.diag(np.where(held, std, np.inf) ** -2.0)
        shared = np.zeros(len(std))
        shared[problem.link_part] = link_scale * problem.links
        log_spread = float(np.sum(np.log(std[held]))) + 0.5 * float(np.log1p(shared @ precision @ shared))
        tied = precision @ shared
        precision -= np.outer(tied, tied) / (1.0 + shared @ tied)
        rows = np.pad(problem.prior_rows, ((0, 0), (0, len(kept) - width)))
        known = problem.prior_target - problem.prior_rows @ fit.common
        noise, steps = np.ones(len(self.count)), 0
        while True:
            weight = noise**-2.0
            matrix = np.tensordot(weight, gram, 1) + precision + rows.T @ rows
            scale = np.sqrt(np.diag(matrix))
            scale[scale <= NOTHING * scale.max()] = 1.0
            size, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
            determined = vectors[:, size > _OPEN] / np.sqrt(size[size > _OPEN])
            inverse = determined @ determined.T / np.outer(scale, scale)
            size = np.maximum(size, _SINGULAR)
            step = inverse @ (weight @ right + precision @ np.where(held, pull, 0.0) + rows.T @ known)
            left = self.square - 2.0 * right @ step + np.einsum("i,gij,j->g", step, gram, step)
            taken = np.einsum("gij,ij->g", gram, inverse) * weight
            left = np.maximum(left, 0.0)
            noise = noise_std(self.count, taken, left, self.start, self.least)
            steps += 1
            if steps == _NOISE_STEPS:
                break
        away = np.where(held, pull - step, 0.0)
        short = known - rows @ step
        penalty = float(away @ precision @ away) + float(short @ short)
        log_det = float(np.sum(np.log(size)) + 2.0 * np.sum(np.log(scale)))
        density = log_density(self.count, left, noise, self.start, penalty)
        return TriedPrior(density - 0.5 * log_det - log_spread, step[:width], inverse[:width, :width])

    def evidence(self, std: Floats, link_scale: float = 0.0) -> float:
        """Log marginal likelihood with these priors; arguments as of `tried`."""
        return self.tried(std, link_scale).log_evidence
