"""Shape selection for families of effects with nonlinear shape parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit, prior_precision
from gateway.diagnose.moving.state import MovingState, refitted, state_of
from gateway.diagnose.moving.trial import extend, possible, put_on_trial, trials_of
from gateway.model.effects.axis_coupling import MotorCoupling
from gateway.model.term import Term

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
