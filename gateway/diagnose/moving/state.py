"""Model with its fits to every split, the agreement of the fits, and the contribution of one of its effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_noise import noise_of, scaled_to
from gateway.diagnose.moving.penalised_fit import MovingFit, MovingProblem, fit
from gateway.diagnose.moving.splits import blocks
from gateway.diagnose.moving.trial import Trial, demand, held_out, judge
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.spread import jackknife, wider
from gateway.model.term import Label, Term
from gateway.result.interval import TWO_SIDED_95

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MovingState:
    """A model with its fits."""

    terms: tuple[Term, ...]
    fits: tuple[MovingFit, ...]
    full: MovingFit
    held: Held


def state_of(problem: MovingProblem, terms: Sequence[Term]) -> MovingState:
    """Fit a model to every split and to all rows that may be fitted."""
    full = fit(problem, terms, ~problem.motion.held_out, problem.motion.held_out)
    fits = tuple(fit(problem, terms, train, test, full) for train, test in problem.splits)
    return MovingState(tuple(terms), fits, full, held_out(problem, fits))


def with_noise_of(problem: MovingProblem, terms: Sequence[Term], full: MovingFit | None) -> MovingProblem:
    """Return the problem with the noise of the model with `terms`, from its fit `full`."""
    motion = problem.motion
    noise = noise_of(motion, problem.null.columns, terms, full.modelled if full is not None else None)
    problem = replace(problem, noise=noise)
    everything = ~motion.held_out
    full = fit(problem, terms, everything, motion.held_out)
    return replace(problem, noise=scaled_to(noise, full.residual_nm, motion.judged & everything[:, None]))


def lacking(problem: MovingProblem, state: MovingState, label: Label) -> MovingState:
    """Return the model without one effect; the nuisance parameter that it replaced is restored."""
    return state_of(problem, [term for term in state.terms if term.label != label])


def beyond_usual(problem: MovingProblem, term: Term, value: Floats, covariance: Floats) -> bool:
    """Return True if the interval of an effect is outside the nuisance prior; True for effects without one."""
    index = problem.null.columns.usual_of(term)
    if index is None:
        return True
    usual = problem.null.std_of(index)
    off = abs(float(value[0]) - float(problem.null.columns.prior.mean[index]))
    return off - TWO_SIDED_95 * float(np.sqrt(covariance[0, 0])) > NUISANCE_STD * usual


def compare(problem: MovingProblem, smaller: MovingState, larger: MovingState, term: Term) -> Trial:
    """Trial of `term` from two fitted models: `smaller` is `larger` without the term (or its whole family)."""
    axes = list(term.enters(problem.motion.axes))
    where = larger.full.part([term])
    value, covariance = larger.full.value[where], larger.full.inverse[np.ix_(where, where)]
    drop = smaller.full.cost - larger.full.cost
    log_p = demand(problem, smaller.full, axes, (covariance, drop, larger.full.residual_nm[:, axes]))
    return judge(problem, larger.fits, term, smaller.held, larger.held, (value, covariance, log_p))


def refitted(problem: MovingProblem, smaller: MovingState, term: Term) -> Trial:
    """Trial of one more effect, with a full fit."""
    return compare(problem, smaller, state_of(problem, (*smaller.terms, term)), term)


def spread_of(problem: MovingProblem, state: MovingState, where: NDArray[np.int_]) -> Floats:
    """Covariance of parameters (k,) from the noise, or from leaving out blocks where that is wider."""
    without = jackknife(np.array([fit.value[where] for fit in _without_blocks(problem, state)]))
    return wider(state.full.spread[np.ix_(where, where)], without)


def _without_blocks(problem: MovingProblem, state: MovingState) -> Sequence[MovingFit]:
    """Fits without one block of time of every run; without a whole run, what only it determines would be lost."""
    if len(np.unique(problem.motion.run[~problem.motion.held_out])) < MOVING.several_runs:
        return state.fits
    splits = blocks(problem.motion, MOVING.blocks)
    return [fit(problem, state.terms, train, test, state.full) for train, test in splits]
