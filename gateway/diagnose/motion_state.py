"""A model with its fits to every split, and what one of its effects is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gateway.diagnose.motion_fit import Fit, Problem, fit, noise_of, scaled_to
from gateway.diagnose.motion_trial import Held, Trial, held_out, judge
from gateway.model.motion_terms import Term


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A model with its fits."""

    terms: tuple[Term, ...]
    fits: tuple[Fit, ...]
    full: Fit
    held: Held


def state_of(problem: Problem, terms: Sequence[Term]) -> State:
    """Fit a model to every split and to all rows that may be fitted."""
    fits = tuple(fit(problem, terms, train, test) for train, test in problem.splits)
    if problem.motion.given.any():
        full = fits[0]
    else:
        everything = ~problem.motion.given
        full = fit(problem, terms, everything, problem.motion.given)
    return State(tuple(terms), fits, full, held_out(problem, fits))


def with_noise_of(problem: Problem, terms: Sequence[Term], full: Fit | None) -> Problem:
    """The problem with noise figures that belong to the model with `terms`, as `full` fitted it."""
    motion = problem.motion
    noise = noise_of(motion, terms, full.modelled if full is not None else None)
    problem = replace(problem, noise=noise)
    everything = ~motion.given
    full = fit(problem, terms, everything, motion.given)
    return replace(problem, noise=scaled_to(noise, full.residual_nm, motion.judged & everything[:, None]))


def compare(problem: Problem, smaller: State, larger: State, term: Term) -> Trial:
    """Trial of `term` from two fitted models: `smaller` has all of `larger` but the term (or its whole family)."""
    drop = smaller.full.cost - larger.full.cost
    start = problem.base.columns.shape[2]
    where = []
    for other in larger.terms:
        if other == term:
            where = list(range(start, start + len(other.symbols)))
        start += len(other.symbols)
    rest = larger.full.residual_nm[:, list(term.axes)]
    value, covariance = larger.full.value[where], larger.full.inverse[np.ix_(where, where)]
    return judge(problem, larger.fits, term, smaller.held, larger.held, (value, covariance, drop, rest, smaller.full))


def refitted(problem: Problem, smaller: State, term: Term) -> Trial:
    """Trial of one more effect, fitted to the end."""
    return compare(problem, smaller, state_of(problem, (*smaller.terms, term)), term)
