"""A model with its fits to every split, and what one of its effects is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gateway.diagnose.held import Held
from gateway.diagnose.moving.fit import MovingFit, MovingProblem, fit, noise_of, scaled_to
from gateway.diagnose.moving.trial import Trial, held_out, judge
from gateway.model.term import Term


@dataclass(frozen=True, slots=True, eq=False)
class MovingState:
    """A model with its fits."""

    terms: tuple[Term, ...]
    fits: tuple[MovingFit, ...]
    full: MovingFit
    held: Held


def state_of(problem: MovingProblem, terms: Sequence[Term]) -> MovingState:
    """Fit a model to every split and to all rows that may be fitted."""
    fits = tuple(fit(problem, terms, train, test) for train, test in problem.splits)
    if problem.motion.given.any():
        full = fits[0]
    else:
        everything = ~problem.motion.given
        full = fit(problem, terms, everything, problem.motion.given)
    return MovingState(tuple(terms), fits, full, held_out(problem, fits))


def with_noise_of(problem: MovingProblem, terms: Sequence[Term], full: MovingFit | None) -> MovingProblem:
    """The problem with noise figures that belong to the model with `terms`, as `full` fitted it."""
    motion = problem.motion
    noise = noise_of(motion, terms, full.modelled if full is not None else None)
    problem = replace(problem, noise=noise)
    everything = ~motion.given
    full = fit(problem, terms, everything, motion.given)
    return replace(problem, noise=scaled_to(noise, full.residual_nm, motion.judged & everything[:, None]))


def compare(problem: MovingProblem, smaller: MovingState, larger: MovingState, term: Term) -> Trial:
    """Trial of `term` from two fitted models: `smaller` has all of `larger` but the term (or its whole family)."""
    drop = smaller.full.cost - larger.full.cost
    where = larger.full.part([term])
    rest = larger.full.residual_nm[:, list(term.enters(problem.motion.axes))]
    value, covariance = larger.full.value[where], larger.full.inverse[np.ix_(where, where)]
    return judge(problem, larger.fits, term, smaller.held, larger.held, (value, covariance, drop, rest, smaller.full))


def refitted(problem: MovingProblem, smaller: MovingState, term: Term) -> Trial:
    """Trial of one more effect, fitted to the end."""
    return compare(problem, smaller, state_of(problem, (*smaller.terms, term)), term)
