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
from gateway.identify.loads import BARE_LABEL
from gateway.model.effects.velocity_friction import Stribeck
from gateway.result.result import LoadResult

Floats = NDArray[np.float64]

QUANTITIES = ("mass_kg", "com_x_m", "com_y_m", "com_z_m")


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
    if label in known:
        mass, com = known[label]
        return LoadResult(label, mass, 0.0, tuple(float(x) for x in com), (0.0, 0.0, 0.0))
    if label not in problem.base.loads:
        return LoadResult(label, unidentifiable=QUANTITIES)
    where = np.arange(problem.base.loads[label].start, problem.base.loads[label].start + 4)
    parameters = state.full.value[where]
    covariance = state.full.inverse[np.ix_(where, where)] + over_blocks(problem, state, where)
    mass, mass_std = float(parameters[0]), float(np.sqrt(covariance[0, 0]))
    if not mass > 0 or mass_std > MOVING.loose_mass * mass:
        return LoadResult(label, unidentifiable=QUANTITIES)
    com = parameters[1:] / mass
    turn = np.column_stack([-com / mass, np.eye(3) / mass])
    turn = np.vstack([[1.0, 0.0, 0.0, 0.0], turn])
    spread = turn @ covariance @ turn.T
    std = np.sqrt(np.diag(spread))
    loose = std[1:] > MOVING.loose_com_m
    com_out = tuple(float("nan") if bad else float(x) for x, bad in zip(com, loose, strict=True))
    return LoadResult(
        label=label,
        mass_kg=mass,
        mass_std_kg=mass_std,
        com_m=com_out,
        com_std_m=tuple(float(x) for x in std[1:]),
        com_flange_m=_in_flange(problem, com) if not loose.any() else None,
        correlation=tuple(tuple(float(x) for x in row) for row in spread / np.outer(std, std)),
        unidentifiable=tuple(name for name, bad in zip(QUANTITIES[1:], loose, strict=True) if bad),
    )


def _in_flange(problem: MovingProblem, com_m: Floats) -> tuple[float, ...] | None:
    flange = problem.motion.robot.flange
    if flange is None:
        return None
    return tuple(float(x) for x in flange[:3, :3].T @ (com_m - flange[:3, 3]))


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
