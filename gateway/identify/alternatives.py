"""Contribution of possibly wrong statements to the uncertainty of a load, although no measurement contradicts them.

Each alternative is a wider prior, or a further disturbance: zero errors of the joints, a hose or cable that comes with
the load, friction that a load makes lopsided. The answer is averaged over the alternatives by their posterior
probabilities (Hoeting et al. 1999): one that is as likely as what is stated, and gives another mass, widens it.
Other priors are evaluated at little cost by the fit without effects, linearised at its solution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import CABLE, CONSTANTS, DRIFT, LINKS, ZEROS
from gateway.identify.nuisance import gain_stds
from gateway.identify.rest.hypothesis_fit import log_density, noise_std
from gateway.identify.rest.linear import Fit, RestProblem, term_columns
from gateway.identify.rest.problem import nuisance_of, open_link_prior
from gateway.identify.solve import NOTHING
from gateway.model.effects.joint_zero_offset import JointZeroOffset
from gateway.model.robot import Robot, link_lengths_m

Floats = NDArray[np.float64]

#: Relative size of an undetermined direction: it contributes equally to every alternative.
_SINGULAR: Final = 1e-14
#: Relative size up to which a direction counts as undetermined and is left out of step and covariance.
_OPEN: Final = 1e-12
#: Iterations of the noise of an alternative.
_NOISE_STEPS: Final = 3
#: Alternatives that are tried: relative standard deviations of link masses, of torque constants, factors on gain
#: changes.
LINK_SPREADS: Final = (0.02, 0.05, 0.1, 0.2, 0.4)
_GAINS: Final = (0.01, 0.03, 0.06, 0.12)
_CHANGES: Final = (3.0, 8.0)
#: Standard deviation of a factor on all link masses.
LINK_SCALE: Final = 0.2
#: Standard deviations [rad] of joint zeros that are tried: a tenth of a degree is usual after a reference run.
_ZEROS_RAD: Final = (0.002, 0.01)
#: Standard deviations of a hose's weight on each link over that of the load, and of its torque over the axis's own.
_CABLES: Final = (0.01, 0.04)
#: Prior odds of each alternative against the statement.
PRIOR_ODDS: Final = 0.1


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

    def tried(
        self, std: Floats, link_scale: float = 0.0, further_std: Floats | None = None
    ) -> tuple[float, Floats, Floats]:
        """Solve with prior standard deviations (p,).

        Returns the logarithm of the marginal likelihood, up to what all priors share, the step (p,) from the solution
        of the fit, and the covariance (p, p).

        `link_scale` is the standard deviation of a factor on all link masses: CAD without motors, or of another alloy.
        `further_std` (e,) is that of the further parameters; 0 = they are left out, as they all are where it is None.
        """
        problem, fit, width = self.problem, self.fit, len(std)
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

        def solved(noise: Floats) -> tuple[Floats, Floats, Floats, Floats, float]:
            """Return the next noise, the squared residuals, step and covariance, and the determinant's logarithm."""
            weight = noise**-2.0
            matrix = np.tensordot(weight, gram, 1) + precision + rows.T @ rows
            scale = np.sqrt(np.diag(matrix))
            scale[scale <= NOTHING * scale.max()] = 1.0
            size, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
            determined = vectors[:, size > _OPEN] / np.sqrt(size[size > _OPEN])
            inverse = determined @ determined.T / np.outer(scale, scale)
            size = np.maximum(size, _SINGULAR)
            step = inverse @ (weight @ right + precision @ np.where(held, pull, 0.0) + rows.T @ known)
            left = np.maximum(self.square - 2.0 * right @ step + np.einsum("i,gij,j->g", step, gram, step), 0.0)
            taken = np.einsum("gij,ij->g", gram, inverse) * weight
            log_det = float(np.sum(np.log(size)) + 2.0 * np.sum(np.log(scale)))
            return noise_std(self.count, taken, left, self.start, self.least), left, step, inverse, log_det

        noise = np.ones(len(self.count))
        for _ in range(_NOISE_STEPS - 1):
            noise, *_ = solved(noise)
        noise, left, step, inverse, log_det = solved(noise)
        away = np.where(held, pull - step, 0.0)
        short = known - rows @ step
        penalty = float(away @ precision @ away) + float(short @ short)
        density = log_density(self.count, left, noise, self.start, penalty)
        return density - 0.5 * log_det - log_spread, step[:width], inverse[:width, :width]

    def evidence(self, std: Floats, link_scale: float = 0.0) -> float:
        """Log marginal likelihood with these priors; arguments as of `tried`."""
        return self.tried(std, link_scale)[0]


def wider_links(trust: float) -> list[float]:
    """Return the relative standard deviations of link masses that are tried beside the stated one."""
    return [wider for wider in LINK_SPREADS if wider > 1.5 * trust]


def wider_statements(robot: Robot, knowledge: Knowledge) -> Iterator[Knowledge]:
    """Return copies of the knowledge in which one group of statements has a wider prior."""
    for wider in wider_links(knowledge.trust):
        yield replace(knowledge, link_std=wider)
    std = gain_stds(knowledge.gain_std, robot.axes)
    for wider in _GAINS:
        if wider > 1.5 * float(np.median(std)):
            yield replace(knowledge, gain_std=tuple(np.hypot(std, wider).tolist()))
    for factor in _CHANGES:
        if factor > knowledge.change:
            yield replace(knowledge, change=factor)


def wider_std(problem: RestProblem, robot: Robot, knowledge: Knowledge) -> Floats:
    """Return the prior standard deviations (p,) that a problem would have with this knowledge."""
    nuisance = nuisance_of(problem.rows, knowledge, replace(problem.nuisance.changes, factor=knowledge.change))
    _, link_std = open_link_prior(robot, knowledge.trust)
    return replace(problem, link_std=link_std, nuisance=nuisance).common_std


def spread_of_loads(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge) -> dict[str, Floats]:
    """Return by source the covariance (loads and parts, 4, 4) of [m, h] that alternatives add to that of the fit."""
    zeros, cable = _zero_columns(problem, fit), _cable_columns(robot, problem, fit)
    line = LinearisedFit.of(problem, fit, np.hstack([zeros, cable]))
    std, none = problem.common_std, np.zeros(zeros.shape[1] + cable.shape[1])
    stated, stated_step, stated_covariance = line.tried(std)
    tried = [(LINKS, line.tried(std, LINK_SCALE))] if np.isfinite(knowledge.trust) else []
    for other in wider_statements(robot, knowledge):
        source = LINKS if other.trust != knowledge.trust else DRIFT if other.change != knowledge.change else CONSTANTS
        tried.append((source, line.tried(wider_std(problem, robot, other))))
    own = np.arange(len(none)) < zeros.shape[1]
    tried += [(ZEROS, line.tried(std, 0.0, np.where(own, size, 0.0))) for size in _ZEROS_RAD]
    tried += [(CABLE, line.tried(std, 0.0, np.where(own, 0.0, size))) for size in _CABLES if cable.shape[1]]
    odds = np.array([log_evidence - stated for _, (log_evidence, _, _) in tried])
    weight = PRIOR_ODDS * np.exp(np.minimum(odds, 50.0))
    weight /= 1.0 + weight.sum()
    functions = [function for function, _ in problem.load_functions.values()]
    out: dict[str, Floats] = {}
    for (source, (_, step, covariance)), share in zip(tried, weight, strict=True):
        away = step - stated_step
        more = np.array(
            [load @ (covariance - stated_covariance + np.outer(away, away)) @ load.T for load in functions]
        ).reshape(-1, 4, 4)
        out[source] = out.get(source, 0.0) + share * more
    return {source: _widening(more) for source, more in out.items()}


def _widening(covariance: Floats) -> Floats:
    """Return the positive part of differences of covariances (k, 4, 4): an alternative never narrows the answer."""
    size, vectors = np.linalg.eigh(covariance)
    return (vectors * np.maximum(size, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _zero_columns(problem: RestProblem, fit: Fit) -> Floats:
    """Derivatives (rows, N) of the readings by the zero position of each joint."""
    theta = np.zeros(1)
    terms = [JointZeroOffset(axis) for axis in range(problem.axes)]
    return np.hstack([term_columns(problem, fit, fit.noise, term, theta) for term in terms])


def _cable_columns(robot: Robot, problem: RestProblem, fit: Fit) -> Floats:
    """Readings (rows, k) of effects that may come with a load: its weight on each link, and a constant torque per axis.

    Per unit of the largest load's mass, and of each axis's torque.
    """
    loads = np.vstack([fit.loads, problem.fixed_load])
    mass_kg = float(np.abs(loads[:, 0]).max(initial=0.0))
    loaded = (np.any(problem.member, axis=1) | np.any(problem.fixed_load, axis=1))[problem.visit]
    size = np.repeat(link_lengths_m(robot)[:, None], 4, axis=1) ** [0, 1, 1, 1] * mass_kg
    weights = fit.columns.times(np.eye(len(fit.scale))[:, problem.link_part]) * size.ravel() * loaded[:, None]
    sums = int(problem.use_sum.sum())
    half_sum = np.arange(len(problem.target)) < sums
    torque = np.sqrt(problem.by_group(problem.target**2) / np.maximum(problem.by_group(), 1.0))[: problem.axes]
    constant = np.eye(problem.axes)[problem.axis] * torque[problem.axis][:, None] * (loaded & half_sum)[:, None]
    return np.hstack([weights[:, : 4 * (problem.axes - 1)], constant])
