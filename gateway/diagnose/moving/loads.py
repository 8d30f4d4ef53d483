"""Load of a moving run: mass and centre of gravity with an uncertainty that knows the model is not perfect.

The spread has two parts: what noise of the residual's size allows, and how far the estimate moves when each block of
time is left out (jackknife). The second is the larger one as soon as the model lacks something.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held import listed
from gateway.diagnose.moving.fit import MovingFit, MovingProblem, fit, usual_of
from gateway.diagnose.moving.splits import blocks
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.thresholds import MOVING
from gateway.identify.budget import CONSTANTS, FRICTION, LINKS, budget_by_priors
from gateway.identify.load_estimate import (
    known_load,
    load_from_moment,
    load_result,
    unknown_load,
)
from gateway.identify.loads import BARE_LABEL
from gateway.identify.spread import jackknife, wider
from gateway.model.effects.velocity_friction import Stribeck
from gateway.model.robot import reach_m
from gateway.result.result import LoadResult, NuisanceResult

Floats = NDArray[np.float64]


def loads_of(
    problem: MovingProblem, state: MovingState, known: Mapping[str, tuple[float, Floats]]
) -> tuple[LoadResult, ...]:
    """Every load label of the fitted rows; what they cannot give is unknown and named."""
    motion = problem.motion
    fitted = motion.load[~motion.given]
    labels = [
        str(label) for label in np.unique(motion.load) if label != BARE_LABEL and (label in fitted or label in known)
    ]
    return tuple(_load(problem, state, label, known) for label in labels)


def _load(
    problem: MovingProblem, state: MovingState, label: str, known: Mapping[str, tuple[float, Floats]]
) -> LoadResult:
    robot = problem.motion.robot
    if label in known:
        return load_result(known_load(label, *known[label]), robot)
    if label not in problem.base.loads:
        return load_result(unknown_load(label), robot)
    where = np.arange(problem.base.loads[label].start, problem.base.loads[label].start + 4)
    moment = state.full.value[where]
    covariance = spread_of(problem, state, where)
    found = np.full(4, bool(np.isfinite(covariance).all()))
    estimate = load_from_moment(label, moment, covariance, np.ones(4), found, reach_m(robot))
    load = load_result(estimate, robot)
    return replace(load, budget=_budget(state.full, int(where[0]), float(covariance[0, 0])))


def _budget(full: MovingFit, mass: int, variance: float) -> dict[str, float]:
    """Share of a mass's variance by source: the load's own inertia counts as noise, which it is to the mass."""
    base = full.base
    first = min((part.start for part in base.loads.values()), default=base.carried)
    sources = {
        CONSTANTS: base.gain,
        LINKS: np.arange(first),
        FRICTION: np.concatenate([base.friction.ravel(), base.level.ravel(), base.loss]),
    }
    return budget_by_priors(full.spread[: len(base.mean), mass], base.precision, sources, variance)


def spread_of(problem: MovingProblem, state: MovingState, where: NDArray[np.int_]) -> Floats:
    """Covariance of parameters (k,): what the noise allows, or where it is wider, what leaving out blocks shows."""
    without = jackknife(np.array([fit.value[where] for fit in _without_blocks(problem, state)]))
    return wider(state.full.spread[np.ix_(where, where)], without)


def _without_blocks(problem: MovingProblem, state: MovingState) -> Sequence[MovingFit]:
    """Fits that leave out a block of time of every run: to leave out a whole run is to lose what only it shows."""
    if len(np.unique(problem.motion.run[~problem.motion.given])) < MOVING.several_runs:
        return state.fits
    splits = blocks(problem.motion, MOVING.blocks)
    return [fit(problem, state.terms, train, test, state.full) for train, test in splits]


def nuisances(problem: MovingProblem, state: MovingState) -> dict[str, NuisanceResult]:
    """Gain and load friction of every axis, NaN where it was not judged. An effect in its place is the whole."""
    base, full, unseen = state.full.base, state.full, ~problem.motion.measured
    place = np.concatenate([base.gain, base.loss])
    for term in state.terms:
        index = usual_of(base, term)
        if index is not None:
            place[place == index] = full.part([term])[0]
    value, std = full.value[place], np.sqrt(np.diag(spread_of(problem, state, place)))
    found = {"gain": slice(0, base.axes), "load_friction": slice(base.axes, None)}
    return {
        name: NuisanceResult(listed(np.where(unseen, np.nan, value[at])), listed(np.where(unseen, np.nan, std[at])))
        for name, at in found.items()
    }


def friction_level(problem: MovingProblem, state: MovingState) -> Floats:
    """Dry friction (N,) [Nm] towards standstill, NaN for an axis that was not judged."""
    level = state.full.value[problem.base.friction[:, 0]].copy()
    for term in state.terms:
        if isinstance(term, Stribeck):
            level[term.axis] += state.full.value[state.full.part([term])[0]]
    return np.where(problem.motion.measured, np.abs(level), np.nan)
