"""Effects are added one at a time while the error on held-out rows drops; each has to earn its place again at the end.

An effect is believed when three things agree: the fitted rows demand it (F test, Bonferroni over all that was tried),
the held-out error of its axes drops by more than a trifle, and the drop is spread over the held-out time. Effects that
are ordinary in any gear need less than those that mean a fault or an extra part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.diagnose.moving.candidates import candidates, possible, suggested
from gateway.diagnose.moving.fit import MovingProblem
from gateway.diagnose.moving.refine import refine, reshaped
from gateway.diagnose.moving.state import MovingState, compare, refitted, state_of, with_noise_of
from gateway.diagnose.moving.thresholds import MOVING, Demands
from gateway.diagnose.moving.trial import Trial, put_on_trial
from gateway.model.effects import DRAWN, FRICTION
from gateway.model.term import Term


def demands(term: Term, axes: int) -> Demands:
    """What this effect must show on an arm of so many axes."""
    if term.ordinary:
        return MOVING.ordinary
    return MOVING.special_all_axes if len(term.enters(axes)) > 2 else MOVING.special


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """An effect in the final model: all its terms, its trial against the model without it, and the runner-up's.

    `contested`: the runner-up meets its own demands, and the odds against it are below `sure_odds`.
    """

    terms: tuple[Term, ...]
    trial: Trial
    runner_up: Trial | None
    odds: float
    contested: bool


def believed(problem: MovingProblem, trial: Trial, tried: int) -> bool:
    """Whether a trial meets its demands."""
    need = demands(trial.term, problem.motion.axes)
    return (
        trial.ratio <= need.ratio
        and trial.gain > 0
        and trial.p_demand * tried * trial.term.tries <= need.p_demand
        and trial.p_held <= need.p_held
        and trial.blocks_better >= need.blocks_better
    )


def select(
    problem: MovingProblem, allowed: frozenset[str], start: Sequence[Term] = ()
) -> tuple[MovingProblem, MovingState, list[Trial]]:
    """Add effects while they are believed, then drop those that are not needed any more.

    Returns
    -------
    MovingProblem
        With the noise figures of the final model.
    MovingState
        The final model.
    list of Trial
        The best trial of every effect that was tried on the final model and did not earn its place.
    """
    state = state_of(problem, start)
    pool = candidates(problem, state.full, allowed)
    stale: dict[Term, float] = {}
    while len(state.terms) < MOVING.largest_model:
        tried = len(pool)
        best = _best(problem, state, pool, stale, tried)
        if best is None:
            best = _best(problem, state, suggested(problem, state.full, allowed), {}, tried)
        added = (
            (refine(problem, state, best.term, pool),) if best is not None else _best_pair(problem, state, pool, tried)
        )
        if not added:
            break
        state = state_of(problem, (*state.terms, *added))
        problem = with_noise_of(problem, state.terms, state.full)
        state = state_of(problem, state.terms)
        stale = {}
    state = reshaped(problem, _without_idle(problem, state, len(pool)), pool)
    left = _trials(problem, state, pool)
    left += _trials(problem, state, suggested(problem, state.full, allowed))
    return problem, state, left


def _open(state: MovingState, pool: Sequence[Term]) -> list[Term]:
    """Candidates that are not in the model: one member per family, two shapes of velocity friction per axis."""
    keys = [term.label for term in state.terms]
    return [
        term for term in pool if keys.count(term.label) < (2 if term.with_friction else 1) and term not in state.terms
    ]


def _trials(problem: MovingProblem, state: MovingState, pool: Sequence[Term]) -> list[Trial]:
    trials = (put_on_trial(problem, state.fits, state.full, term) for term in _open(state, pool))
    return [trial for trial in trials if trial is not None]


def _best(
    problem: MovingProblem, state: MovingState, pool: Sequence[Term], stale: dict[Term, float], tried: int
) -> Trial | None:
    """The believed trial that gains most; gains of an earlier round bound those of this one loosely."""
    best: Trial | None = None
    for term in sorted(_open(state, pool), key=lambda term: -stale.get(term, np.inf)):
        if best is not None and stale.get(term, np.inf) < 0.3 * best.gain - 5.0:
            continue
        hopeless = demands(term, problem.motion.axes).p_demand / tried
        trial = put_on_trial(problem, state.fits, state.full, term, hopeless=hopeless)
        stale[term] = trial.gain if trial is not None else -np.inf
        if trial is None or not believed(problem, trial, tried):
            continue
        if (best is None or trial.gain > best.gain) and possible(
            problem, state.full, term, trial.value, trial.covariance
        ):
            best = trial
    return best


def _best_pair(problem: MovingProblem, state: MovingState, pool: Sequence[Term], tried: int) -> tuple[Term, ...]:
    """Two parts of one axis's friction that are believed together though neither is alone."""
    friction = [term for term in _open(state, pool) if term.name in FRICTION]
    hopeless = MOVING.ordinary.p_demand / tried
    best, found = 0.0, ()
    for position, first in enumerate(friction):
        for second in friction[position + 1 :]:
            if first.joints != second.joints or first.name == second.name:
                continue
            trial = put_on_trial(problem, state.fits, state.full, first, second, hopeless=hopeless)
            if trial is None or trial.gain <= best or not believed(problem, trial, tried):
                continue
            if all(_possible_part(problem, state, trial, term, part) for term, part in ((first, 0), (second, 1))):
                best, found = trial.gain, (first, second)
    return found


def _possible_part(problem: MovingProblem, state: MovingState, trial: Trial, term: Term, part: int) -> bool:
    """The load's share of a pair must be a loss; its shape over speed is free."""
    if term.with_friction:
        return True
    here = slice(part, part + 1)
    return possible(problem, state.full, term, trial.value[here], trial.covariance[here, here])


def _without_idle(problem: MovingProblem, state: MovingState, tried: int) -> MovingState:
    """Drop, one at a time, the effect that the held-out rows miss least, while it is not believed any more."""
    while state.terms:
        rated = []
        for term in state.terms:
            smaller = state_of(problem, [other for other in state.terms if other != term])
            rated.append((compare(problem, smaller, state, term), smaller))
        rated = [item for item in rated if not _needed(item[0], problem.motion.axes)]
        if not rated:
            return state
        state = min(rated, key=lambda item: item[0].gain)[1]
    return state


def _needed(trial: Trial, axes: int) -> bool:
    need = demands(trial.term, axes)
    return trial.ratio <= 0.5 * (1.0 + need.ratio) and trial.gain > 0 and trial.p_held <= 2.0 * need.p_held


def penalty(term: Term) -> float:
    """Log of what an effect has to make good before it is weighed: its coefficients, and being rare in arms."""
    return len(term.linear) + (0.0 if term.name in FRICTION else float(np.log(MOVING.rare)))


def weigh(problem: MovingProblem, state: MovingState, allowed: frozenset[str]) -> list[Chosen]:
    """Each effect of the model against the model without it, and against the best other effect in its place."""
    pool, axes = candidates(problem, state.full, allowed), problem.motion.axes
    out = []
    for key in dict.fromkeys(term.label for term in state.terms):
        mine = tuple(term for term in state.terms if term.label == key)
        smaller = state_of(problem, [term for term in state.terms if term.label != key])
        own = compare(problem, smaller, state, mine[0])
        touched = {axis for term in mine for axis in term.enters(axes)}
        others = [
            term
            for term in pool
            if term.label != key and (touched & set(term.enters(axes)) or {term.name, key[0]} <= DRAWN)
        ]
        rivals = _trials(problem, smaller, others)
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
        contested = runner is not None and odds < MOVING.sure_odds and believed(problem, runner, len(pool))
        out.append(Chosen(mine, own, runner, odds, contested))
    return out
