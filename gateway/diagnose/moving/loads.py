"""Load of a moving run: mass and centre of gravity with an uncertainty that knows the model is not perfect.

The spread has two parts: what noise of the residual's size allows, and how far the estimate moves when each block of
time is left out (jackknife). The second is the larger one as soon as the model lacks something.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.fit import MovingProblem
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.thresholds import MOVING
from gateway.identify.load_estimate import known_load, load_directions, load_from_moment, load_result, unknown_load
from gateway.identify.loads import BARE_LABEL
from gateway.model.effects.velocity_friction import Stribeck
from gateway.result.result import LoadResult

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
    covariance = state.full.inverse[np.ix_(where, where)] + over_blocks(problem, state, where)
    turn = load_directions(moment)
    std = np.sqrt(np.diag(turn @ covariance @ turn.T))
    if not moment[0] > 0 or std[0] > MOVING.loose_mass * moment[0]:
        return load_result(unknown_load(label), robot)
    found = np.concatenate([[True], std[1:] <= MOVING.loose_com_m])
    return load_result(load_from_moment(label, moment, covariance, np.ones(4), found), robot)


def over_blocks(problem: MovingProblem, state: MovingState, where: NDArray[np.int_]) -> Floats:
    """Covariance of parameters over fits that leave out one block of time each; zero with a given hold-out."""
    return jackknife(problem, np.array([fit.value[where] for fit in state.fits]))


def jackknife(problem: MovingProblem, estimates: Floats) -> Floats:
    """Covariance of estimates (splits, k) that leave out one block of time each; zero with a given hold-out."""
    if problem.motion.given.any() or len(estimates) < 3:
        return np.zeros((estimates.shape[1],) * 2)
    centred = estimates - estimates.mean(axis=0)
    return (len(estimates) - 1) / len(estimates) * centred.T @ centred


def friction_level(problem: MovingProblem, state: MovingState) -> Floats:
    """Dry friction (N,) [Nm] towards standstill, NaN for an axis that was not judged."""
    level = state.full.value[problem.base.friction[:, 0]].copy()
    for term in state.terms:
        if isinstance(term, Stribeck):
            level[term.axis] += state.full.value[state.full.part([term])[0]]
    return np.where(problem.motion.measured, np.abs(level), np.nan)
