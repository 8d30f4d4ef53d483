"""Contribution of possibly wrong statements to the uncertainty of a load, although no measurement contradicts them.

Each alternative is a wider prior, or a further disturbance: zero errors of the joints, a hose or cable that comes with
the load, friction that a load makes lopsided. The answer is averaged over the alternatives by their posterior
probabilities (Hoeting et al. 1999): one that is as likely as what is stated, and gives another mass, widens it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.budget import CABLE, CONSTANTS, DRIFT, LINKS, ZEROS
from gateway.identify.knowledge import Knowledge
from gateway.identify.nuisance import gain_stds
from gateway.identify.rest.linear import Fit, RestProblem, term_columns
from gateway.identify.rest.linearised import LinearisedFit
from gateway.identify.rest.problem import nuisance_of, open_link_prior
from gateway.model.effects.joint_zero_offset import JointZeroOffset
from gateway.model.robot import Robot, link_lengths_m

Floats = NDArray[np.float64]

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
    stated = line.tried(std)
    tried = [(LINKS, line.tried(std, LINK_SCALE))] if np.isfinite(knowledge.trust) else []
    for other in wider_statements(robot, knowledge):
        source = LINKS if other.trust != knowledge.trust else DRIFT if other.change != knowledge.change else CONSTANTS
        tried.append((source, line.tried(wider_std(problem, robot, other))))
    own = np.arange(len(none)) < zeros.shape[1]
    tried += [(ZEROS, line.tried(std, 0.0, np.where(own, size, 0.0))) for size in _ZEROS_RAD]
    tried += [(CABLE, line.tried(std, 0.0, np.where(own, 0.0, size))) for size in _CABLES if cable.shape[1]]
    odds = np.array([other.log_evidence - stated.log_evidence for _, other in tried])
    weight = PRIOR_ODDS * np.exp(np.minimum(odds, 50.0))
    weight /= 1.0 + weight.sum()
    functions = [function for function, _ in problem.load_functions.values()]
    out: dict[str, Floats] = {}
    for (source, other), share in zip(tried, weight, strict=True):
        away = other.step - stated.step
        more = np.array(
            [load @ (other.covariance - stated.covariance + np.outer(away, away)) @ load.T for load in functions]
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
