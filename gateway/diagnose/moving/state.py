"""A model with its fits to every split, how far they agree, and what one of its effects is worth."""

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
    """The problem with noise figures that belong to the model with `terms`, as `full` fitted it."""
    motion = problem.motion
    noise = noise_of(motion, problem.null.columns, terms, full.modelled if full is not None else None)
    problem = replace(problem, noise=noise)
    everything = ~motion.held_out
    full = fit(problem, terms, everything, motion.held_out)
    return replace(problem, noise=scaled_to(noise, full.residual_nm, motion.judged & everything[:, None]))


def lacking(problem: MovingProblem, state: MovingState, label: Label) -> MovingState:
    """The model without one effect; what is ordinary of it comes back."""
    return state_of(problem, [term for term in state.terms if term.label != label])


def beyond_usual(problem: MovingProblem, term: Term, value: Floats, covariance: Floats) -> bool:
    """Whether the interval of an effect that every arm has a share of lies outside what is ordinary; others do."""
    index = problem.null.columns.usual_of(term)
    if index is None:
        return True
    usual = problem.null.std_of(index)
    off = abs(float(value[0]) - float(problem.null.columns.prior.mean[index]))
    return off - TWO_SIDED_95 * float(np.sqrt(covariance[0, 0])) > NUISANCE_STD * usual


def compare(problem: MovingProblem, smaller: MovingState, larger: MovingState, term: Term) -> Trial:
    """Trial of `term` from two fitted models: `smaller` has all of `larger` but the term (or its whole family)."""
    axes = list(term.enters(problem.motion.axes))
    where = larger.full.part([term])
    value, covariance = larger.full.value[where], larger.full.inverse[np.ix_(where, where)]
    drop = smaller.full.cost - larger.full.cost
    log_p = demand(problem, smaller.full, axes, (covariance, drop, larger.full.residual_nm[:, axes]))
    return judge(problem, larger.fits, term, smaller.held, larger.held, (value, covariance, log_p))


def refitted(problem: MovingProblem, smaller: MovingState, term: Term) -> Trial:
    """Trial of one more effect, fitted to the end."""
    return compare(problem, smaller, state_of(problem, (*smaller.terms, term)), term)


def spread_of(problem: MovingProblem, state: MovingState, where: NDArray[np.int_]) -> Floats:
    """Covariance of parameters (k,): what the noise allows, or where it is wider, what leaving out blocks shows."""
    without = jackknife(np.array([fit.value[where] for fit in _without_blocks(problem, state)]))
    return wider(state.full.spread[np.ix_(where, where)], without)


def _without_blocks(problem: MovingProblem, state: MovingState) -> Sequence[MovingFit]:
    """Fits that leave out a block of time of every run: to leave out a whole run is to lose what only it shows."""
    if len(np.unique(problem.motion.run[~problem.motion.held_out])) < MOVING.several_runs:
        return state.fits
    splits = blocks(problem.motion, MOVING.blocks)
    return [fit(problem, state.terms, train, test, state.full) for train, test in splits]
