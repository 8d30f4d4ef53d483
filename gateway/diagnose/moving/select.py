"""Stepwise selection: effects are added while the held-out error drops, then each is tested again.

An effect is accepted if two criteria agree. The fitted rows require it (F test, Bonferroni over all tried effects). The
held-out rows gain by it, also without the block of time that gains most; less where the held-out error drops visibly.
An effect that every gear has to some extent always has to lower that error. Families with nonlinear shape parameters
have their shape selected.

The remaining residual is tested for dependence on the motion. Columns without a physical cause (harmonics of the
angles, speeds, motion of the neighbours, another friction in the last run) are tried like effects. If they improve
held-out rows, the residual has structure that no effect of the library explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gateway.diagnose.held_out_residuals import NOT_HELD, HeldRatio
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit, prior_precision
from gateway.diagnose.moving.trial import (
    MovingState,
    Trial,
    beyond_usual,
    candidates,
    compare,
    demanded_most,
    extend,
    lacking,
    possible,
    put_on_trial,
    refitted,
    state_of,
    suggested,
    trials_of,
    with_noise_of,
)
from gateway.model.effects import DRAWN, FRICTION
from gateway.model.effects.axis_coupling import MotorCoupling
from gateway.model.motion import Modelled, MovingRows
from gateway.model.term import Label, OnAxis, Term
from gateway.model.unnamed import harmonics

Floats = NDArray[np.float64]

#: Factors [-] on the ratio of a train that are tried: 5 % about one to one, coarser where trains are rare.
COUPLING_STEPS = np.array([0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0])
#: Evaluations [-] of a law of three shape parameters: the simplex has shrunk a thousandfold by then.
EVALUATIONS = 150


def refine(problem: MovingProblem, state: MovingState, term: Term, pool: Sequence[Term]) -> Term:
    """Return the member of an effect's family that fits best, as far as the rows can separate the members."""
    if isinstance(term, MotorCoupling):
        # Coupling coefficient that the fitted rows prefer; one-to-one unless they contradict it
        centre = term.coefficient
        others = [other for other in state.terms if other.label != term.label]
        grid = np.unique(np.concatenate([centre * COUPLING_STEPS, [np.sign(centre)]]))
        costs = np.array([coupling_cost(problem, others, term, float(value)) for value in grid])
        complete = int(np.argmin(np.abs(grid - np.sign(centre))))
        chosen = complete if costs[complete] - costs.min() < MOVING.coupling_slack else int(np.argmin(costs))
        return replace(term, coefficient=float(grid[chosen]))
    if term.scales_reading:
        # Axis whose scale explains most after a full fit; neighbouring axes are equal to first order
        members = [term for term in pool if term.scales_reading and term not in state.terms]
        return max(members, key=lambda term: refitted(problem, state, term).gain)
    if not all(term.linear):
        return _best_law(problem, state, term, pool)
    return term


def reshaped(problem: MovingProblem, state: MovingState, pool: Sequence[Term], newest: Term | None) -> MovingState:
    """Return the model with the shape of every friction law but the newest refitted."""
    for term in state.terms:
        if all(term.linear) or term == newest:
            continue
        others = [other for other in state.terms if other != term]
        state = state_of(problem, (*others, _best_law(problem, state_of(problem, others), term, pool)))
    return state


def _best_law(problem: MovingProblem, state: MovingState, found: Term, pool: Sequence[Term]) -> Term:
    """Simplest law of the effect in its best shape, or another that held-out rows clearly prefer."""
    chosen, best, lead = found, -np.inf, 0.0
    members = [term for term in pool if term.label == found.label]
    trials = [trial for trial in trials_of(problem, state.fits, state.full, members) if trial is not None]
    trials = [trial for trial in trials if possible(problem, state.full, trial.term, trial.value, trial.covariance)]
    for law in dict.fromkeys(type(term) for term in members):
        own = [trial for trial in trials if type(trial.term) is law]
        if not own:
            continue
        member = _best_shape(problem, state, min(own, key=lambda trial: trial.p_demand).term)
        trial = put_on_trial(problem, state.fits, state.full, member)
        if trial is None or not possible(problem, state.full, member, trial.value, trial.covariance):
            continue
        if trial.gain - lead > best:
            chosen, best = member, trial.gain - lead
        lead = MOVING.lead
    return chosen


def _best_shape(problem: MovingProblem, state: MovingState, term: Term) -> Term:
    """Shape with the lowest cost of fitted rows and prior."""
    start, spread = (np.array(values[term.count :]) for values in (term.start, term.spread))

    def cost(steps: Floats) -> float:
        return _cost(problem, state, term, start + spread * steps) + float(steps @ steps)

    answer = minimize(cost, np.zeros(len(start)), method="Nelder-Mead", options={"maxfev": EVALUATIONS, "xatol": 1e-3})
    return term.shaped(start + spread * np.asarray(answer.x))


def _cost(problem: MovingProblem, state: MovingState, term: Term, shape: Floats) -> float:
    """Cost of the fitted rows with one more effect minus the cost without it."""
    axes = list(term.enters(problem.motion.axes))
    columns = term.shaped(shape).columns(problem.motion, state.full.modelled)
    solved = extend(state.full, axes, columns, prior_precision(term))
    return 0.0 if solved is None else -solved[3]


def coupling_cost(problem: MovingProblem, others: Sequence[Term], term: MotorCoupling, coefficient: float) -> float:
    """Cost of the fitted rows if all friction and rotor inertia of the outer axis act on its motor.

    Only then can the coefficient be identified: friction on the joint depends on the joint's own speed.
    """
    axis = term.outer
    columns, own = problem.null.columns, problem.null.friction[axis, :3]
    seen = (columns.design[:, axis, own] ** 2).sum(axis=0) * problem.noise.weight[axis] ** 2
    prior = columns.prior.with_std(own, (1e8 * seen) ** -0.5)
    clamped = replace(problem, null=replace(problem.null, columns=replace(columns, prior=prior)))
    member = replace(term, coefficient=coefficient)
    return fit(clamped, (*others, member), ~problem.motion.held_out, problem.motion.held_out).cost


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


def least_gain(trial: Trial, visible: float) -> float:
    """Return the gain that an effect needs: little if it lowers the residual visibly and links cannot imitate it."""
    return MOVING.sure_if_visible if trial.ratio <= visible and trial.term.name not in DRAWN else MOVING.sure


def is_significant(trial: Trial, tried: int) -> bool:
    """Return True if a trial meets its thresholds."""
    return (
        trial.sure >= least_gain(trial, MOVING.visible_ratio)
        and trial.p_demand * tried * trial.term.tries <= MOVING.demanded
        and (trial.ratio <= MOVING.common_ratio or not trial.term.is_common)
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
    for most in (MOVING.runners, None):
        trials = trials_of(problem, state.fits, state.full, terms, MOVING.demanded / tried, most)
        good = [trial for trial in trials if trial is not None and _proven(problem, state, trial, tried)]
        if good:
            return max(good, key=lambda trial: trial.gain)
    return None


def _proven(problem: MovingProblem, state: MovingState, trial: Trial, tried: int) -> bool:
    """Return True if a trial meets its thresholds, exceeds the nuisance prior and is physically possible."""
    return (
        is_significant(trial, tried)
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
    """Return True if an effect of a model still does half of what it was accepted for."""
    if not beyond_usual(problem, trial.term, trial.value, trial.covariance):
        return False
    visible, common = (0.5 * (1.0 + ratio) for ratio in (MOVING.visible_ratio, MOVING.common_ratio))
    return trial.sure >= 0.5 * least_gain(trial, visible) and (trial.ratio <= common or not trial.term.is_common)


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
        rival = runner is not None and is_significant(runner, len(pool))
        out.append(Chosen(mine, own, runner, odds, odds < MOVING.naming_odds, rival))
    return out


def structured_axes(problem: MovingProblem, state: MovingState) -> dict[int, float]:
    """Axes (from 0) whose residual depends on the motion, with the held-out ratio that proves it."""
    found = {}
    for axis in np.flatnonzero(problem.motion.measured):
        trials = (put_on_trial(problem, state.fits, state.full, Shapeless(int(axis), of)) for of in SHAPES)
        ratios = [trial.ratio for trial in trials if trial is not None and _convinces(trial)]
        if min(ratios, default=1.0) < 1.0:
            found[int(axis)] = min(ratios)
    return found


def _convinces(trial: Trial) -> bool:
    return trial.ratio <= MOVING.structure_ratio and trial.sure >= MOVING.sure and trial.p_demand <= MOVING.demanded


@dataclass(frozen=True, slots=True)
class Shapeless(OnAxis):
    """Torque on one axis as a smooth function of the quantity `of`, without a physical cause."""

    of: str
    name: ClassVar[str] = "structure"
    modelled: ClassVar[bool] = True

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return SHAPES[self.of](motion, modelled, self.axis)[:, None, :]


def _speed(motion: MovingRows, _: Modelled, axis: int) -> Floats:
    part, sign = np.abs(motion.qd_rad_s[:, axis]) / float(motion.speed_rad_s[axis]), motion.sign[:, axis]
    return np.stack([sign * np.exp(-part / 0.1), sign * part**2, part], axis=1)


def _neighbours(motion: MovingRows, _: Modelled, axis: int) -> Floats:
    others = [other for other in range(motion.axes) if other != axis]
    return np.concatenate([motion.sign[:, others], motion.qd_rad_s[:, others]], axis=1)


def _sides(motion: MovingRows, axis: int) -> Floats:
    """Columns (n, 2): a constant, and the direction of motion."""
    return np.stack([np.ones(len(motion)), motion.sign[:, axis]], axis=1)


#: What the residual may depend on, and its columns (n, k) on an axis; speeds in shares of the fastest.
SHAPES: Mapping[str, Callable[[MovingRows, Modelled, int], Floats]] = {
    "angle": lambda motion, _, axis: harmonics(motion.q_rad[:, axis], 2),
    "direction and angle": lambda motion, _, axis: motion.sign[:, [axis]] * harmonics(motion.q_rad[:, axis], 1),
    "speed": _speed,
    "posture": lambda motion, _, axis: np.concatenate([np.sin(motion.q_rad), np.cos(motion.q_rad)], axis=1),
    "neighbours": _neighbours,
    "torque": lambda motion, modelled, axis: modelled.rigid_nm[:, [axis]] * _sides(motion, axis),
    "run": lambda motion, _, axis: (
        (motion.run == motion.run.max())[:, None] * np.column_stack([_sides(motion, axis), motion.qd_rad_s[:, axis]])
    ),
}
