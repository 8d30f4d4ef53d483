"""Relative standard deviation of the CAD link values, estimated if the user does not state it.

Two explanations are compared by evidence (marginal likelihood). Either the CAD data are right and an effect is missing,
or no effect is missing and the CAD data are wrong. CAD data are usually wrong by a few percent; the smallest standard
deviation that the data do not contradict is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_noise import MovingNoise
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit, prior_of
from gateway.identify.correlation import counting_share
from gateway.model.effects import DRAWN
from gateway.model.term import Term

Floats = NDArray[np.float64]

#: Relative errors of a drawing [-] that are weighed: a factor of two apart, from weighed links to none at all.
LEVELS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
#: Precision that stands for no opinion on an effect's parameter.
WIDE = 1e-8


def log_evidence(problem: MovingProblem, terms: Sequence[Term]) -> float:
    """Log marginal likelihood of the fitted rows, up to a constant common to all models."""
    everything = ~problem.motion.held_out
    solved = fit(problem, terms, everything, problem.motion.held_out)
    prior = problem.null.columns.prior.beside(prior_of(terms)).precision
    return 0.5 * (_log_det(prior + WIDE * np.eye(len(prior))) + _log_det(solved.inverse) - solved.cost)


def _log_det(matrix: Floats) -> float:
    """Log determinant of a matrix whose rows differ much in size."""
    size = np.sqrt(np.diag(matrix))
    return float(np.linalg.slogdet(matrix / size / size[:, None])[1] + 2.0 * np.log(size).sum())


def choose_trust(problem: MovingProblem, terms: Sequence[Term]) -> float | None:
    """Choose the relative standard deviation of the CAD values; None = CAD values are not usable."""
    # The problem with the noise scale and correlation of the model with the effects
    motion = problem.motion
    everything = ~motion.held_out
    left = fit(problem, terms, everything, motion.held_out).residual_nm
    sigma, share = problem.noise.sigma_nm.copy(), problem.noise.share.copy()
    for axis in np.flatnonzero(motion.measured):
        rest = left[motion.judged[:, axis] & everything, axis]
        if len(rest):
            sigma[axis] = max(sigma[axis], float(np.sqrt(np.mean(rest**2))))
            share[axis] = min(share[axis], counting_share(rest))
    problem = replace(problem, noise=MovingNoise(sigma, share))
    explanations = [list(terms)]
    without = [term for term in terms if term.name not in DRAWN]
    if len(without) < len(terms):
        explanations.append(without)
    scores = np.array([[_score(problem, explanation, level) for level in LEVELS] for explanation in explanations])
    best = scores[int(np.argmax(scores.max(axis=1)))]
    level = LEVELS[int(np.argmax(best >= best.max() - MOVING.contradicted))]
    return None if level >= MOVING.worthless else level


def _score(problem: MovingProblem, terms: Sequence[Term], level: float) -> float:
    worse = np.log(max(level / MOVING.usual_trust, 1.0)) / np.log(MOVING.usual_factor)
    trusting = replace(problem, null=problem.null.trusting(level))
    return log_evidence(trusting, terms) - 0.5 * float(worse) ** 2
