"""Stepwise selection: effects are added while the held-out error drops, then each is tested again.

An effect is accepted if three criteria agree. The fitted rows require it (F test, Bonferroni over all tried effects).
The held-out error of its axes drops by more than a minimum. The drop is spread over the held-out time. Effects that are
common in gears have lower thresholds than faults or extra parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING, Demands
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.ratio import NOT_HELD, HeldRatio
from gateway.diagnose.moving.refine import refine, reshaped
from gateway.diagnose.moving.state import MovingState, beyond_usual, compare, lacking, refitted, state_of, with_noise_of
from gateway.diagnose.moving.trial import Trial, candidates, demanded_most, possible, suggested, trials_of
from gateway.model.effects import DRAWN, FRICTION
from gateway.model.term import Label, Term


def demands(term: Term, axes: int) -> Demands:
    """Return the acceptance thresholds of this effect on an arm with this number of axes."""
    if term.is_common:
        return MOVING.ordinary
    return MOVING.special_all_axes if len(term.enters(axes)) > 2 else MOVING.special


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Effect in the final model: its terms, its trial against the model without it, and the runner-up's trial.

    `contested`: the odds against the runner-up or against no effect are below `naming_odds`. `rival`: the runner-up
    meets its own thresholds; then neither of the two is reported. `held`: improvement on held-out rows.
    """

    terms: tuple[Term, ...]
    trial: Trial
    runner_up: Trial | None
    odds: float
    contested: bool
    rival: bool
    held: HeldRatio = NOT_HELD

    @property
    def label(self) -> Label:
        """Name and joints."""
        return self.terms[0].label

    def axes(self, count: int) -> list[int]:
        """Axes (from 0) that the effect acts on, for an arm with this number of axes."""
        return sorted({axis for term in self.terms for axis in term.enters(count)})


def is_significant(problem: MovingProblem, trial: Trial, tried: int) -> bool:
    """Return True if a trial meets its thresholds."""
    need = demands(trial.term, problem.motion.axes)
    return (
        trial.ratio <= need.ratio
        and trial.gain > 0
        and trial.p_demand * tried * trial.term.tries <= need.p_demand
        and trial.p_held <= need.p_held
        and trial.blocks_better >= need.blocks_better
    )


def select(problem: MovingProblem, allowed: frozenset[str]) -> tuple[MovingProblem, MovingState]:
    """Add effects while they are accepted, then drop those that are no longer needed.

    Returns
    -------
    MovingProblem
        With the noise figures of the final model.
    MovingState
        The final model.
    """
    state = state_of(problem, ())
    pool = candidates(problem, state.full, allowed)
    newest: Term | None = None
    while len(state.terms) < MOVING.largest_model:
        tried = len(pool)
        best = _best(problem, state, pool, tried)
        if best is None:
            best = _best(problem, state, suggested(problem, state.full, allowed), tried)
        if best is None:
            break
        newest = refine(problem, state, best.term, pool)
        state = state_of(problem, (*state.terms, newest))
        problem = with_noise_of(problem, state.terms, state.full)
        state = state_of(problem, state.terms)
    kept = without_idle(problem, state)
    # the newest has its shape beside all the others already, unless one of them has gone since
    return problem, reshaped(problem, kept, pool, newest if len(kept.terms) == len(state.terms) else None)


def left_over(problem: MovingProblem, state: MovingState, allowed: frozenset[str]) -> list[Term]:
    """Return every further effect that could be tried, in the shape that the fitted rows support most."""
    pool = [*candidates(problem, state.full, allowed), *suggested(problem, state.full, allowed)]
    return demanded_most(problem, state.full, _open(state, pool))


def _open(state: MovingState, pool: Sequence[Term]) -> list[Term]:
    """Candidates that are not in the model: one member per family, two shapes of velocity friction per axis."""
    keys = [term.label for term in state.terms]
    return [
        term for term in pool if keys.count(term.label) < (2 if term.with_friction else 1) and term not in state.terms
    ]


def _best(problem: MovingProblem, state: MovingState, pool: Sequence[Term], tried: int) -> Trial | None:
    """Accepted trial with the largest gain, first among the best supported candidates, then among all."""
    terms = _open(state, pool)
    if not terms:
        return None
    hopeless = max(need.p_demand for need in (MOVING.ordinary, MOVING.special)) / tried
    for most in (MOVING.runners, None):
        trials = trials_of(problem, state.fits, state.full, terms, hopeless, most)
        good = [trial for trial in trials if trial is not None and _proven(problem, state, trial, tried)]
        if good:
            return max(good, key=lambda trial: trial.gain)
    return None


def _proven(problem: MovingProblem, state: MovingState, trial: Trial, tried: int) -> bool:
    """Return True if a trial meets its thresholds, exceeds the nuisance prior and is physically possible."""
    return (
        is_significant(problem, trial, tried)
        and beyond_usual(problem, trial.term, trial.value, trial.covariance)
        and possible(problem, state.full, trial.term, trial.value, trial.covariance)
    )


def without_idle(problem: MovingProblem, state: MovingState) -> MovingState:
    """Drop effects one at a time, the least useful on held-out rows first, while they are not accepted."""
    while state.terms:
        rated = []
        for term in state.terms:
            smaller = state_of(problem, [other for other in state.terms if other != term])
            rated.append(compare(problem, smaller, state, term))
        idle = [trial for trial in rated if not _needed(problem, trial)]
        if not idle:
            return state
        gone = min(idle, key=lambda trial: trial.gain).term
        state = state_of(problem, [term for term in state.terms if term != gone])
    return state


def _needed(problem: MovingProblem, trial: Trial) -> bool:
    need = demands(trial.term, problem.motion.axes)
    if not beyond_usual(problem, trial.term, trial.value, trial.covariance):
        return False
    return trial.ratio <= 0.5 * (1.0 + need.ratio) and trial.gain > 0 and trial.p_held <= 2.0 * need.p_held


def penalty(term: Term) -> float:
    """Log odds that an effect must overcome: for its number of coefficients, and its rarity."""
    return len(term.linear) + (0.0 if term.name in FRICTION else float(np.log(MOVING.rare)))


def weigh(problem: MovingProblem, state: MovingState, allowed: frozenset[str]) -> list[Chosen]:
    """Compare each effect with the model without it, and with the best other effect in its place."""
    pool, axes = candidates(problem, state.full, allowed), problem.motion.axes
    out = []
    for key in dict.fromkeys(term.label for term in state.terms):
        mine = tuple(term for term in state.terms if term.label == key)
        smaller = lacking(problem, state, key)
        own = compare(problem, smaller, state, mine[0])
        touched = {axis for term in mine for axis in term.enters(axes)}
        others = [
            term
            for term in pool
            if term.label != key and (touched & set(term.enters(axes)) or {term.name, key[0]} <= DRAWN)
        ]
        trials = trials_of(problem, smaller.fits, smaller.full, _open(smaller, others))
        rivals = [trial for trial in trials if trial is not None]
        rivals = [
            trial
            for trial in sorted(rivals, key=lambda trial: penalty(trial.term) - trial.gain)[: MOVING.runners]
            if possible(problem, smaller.full, trial.term, trial.value, trial.covariance)
        ]
        runner = rivals[0] if rivals else None
        if runner is not None and runner.term.name == key[0]:
            runner = refitted(problem, smaller, runner.term)
        lead = (
            own.gain - penalty(mine[0]) - (max(runner.gain - penalty(runner.term), 0.0) if runner is not None else 0.0)
        )
        odds = float(np.exp(np.clip(lead, -27.0, 27.0)))
        rival = runner is not None and is_significant(problem, runner, len(pool))
        out.append(Chosen(mine, own, runner, odds, odds < MOVING.naming_odds, rival))
    return out
