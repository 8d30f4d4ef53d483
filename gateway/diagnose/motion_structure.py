"""Is what the model leaves noise, or does it still hang on the motion?

Columns without a cause (harmonics of the angles, speeds, motion of the neighbours, another friction in the last run)
are put on trial like an effect. If they help on rows no fit has seen, the residual has structure that no effect of the
library explains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.motion_fit import MovingProblem
from gateway.diagnose.motion_state import MovingState
from gateway.diagnose.motion_trial import Trial, put_on_trial
from gateway.model.motion import MovingRows
from gateway.model.motion_terms import Modelled, MovingTerm

Floats = NDArray[np.float64]

RATIO = 0.87
CHANCE = 1e-3


def structured_axes(problem: MovingProblem, state: MovingState) -> dict[int, float]:
    """Axes (from 0) whose residual still hangs on their motion, with the held-out ratio that shows it."""
    found = {}
    for axis in np.flatnonzero(problem.motion.measured):
        best = 1.0
        for term in _shapeless(int(axis), float(problem.motion.speed_rad_s[axis])):
            trial = put_on_trial(problem, state.fits, state.full, term)
            if trial is not None and _convinces(trial):
                best = min(best, trial.ratio)
        if best < 1.0:
            found[int(axis)] = best
    return found


def _convinces(trial: Trial) -> bool:
    return trial.ratio <= RATIO and trial.p_held <= 10.0 * CHANCE and trial.p_demand <= CHANCE


def _shapeless(axis: int, top_rad_s: float) -> list[MovingTerm]:
    def angle(motion: MovingRows, _: Modelled) -> Floats:
        q = motion.q_rad[:, axis]
        return np.stack([np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)], axis=1)[:, None, :]

    def directed(motion: MovingRows, _: Modelled) -> Floats:
        q, sign = motion.q_rad[:, axis], motion.sign[:, axis]
        return np.stack([sign * np.sin(q), sign * np.cos(q)], axis=1)[:, None, :]

    def speed(motion: MovingRows, _: Modelled) -> Floats:
        part, sign = np.abs(motion.qd_rad_s[:, axis]) / top_rad_s, motion.sign[:, axis]
        return np.stack([sign * np.exp(-part / 0.1), sign * part**2, part], axis=1)[:, None, :]

    def postures(motion: MovingRows, _: Modelled) -> Floats:
        return np.concatenate([np.sin(motion.q_rad), np.cos(motion.q_rad)], axis=1)[:, None, :]

    def passed_on(motion: MovingRows, modelled: Modelled) -> Floats:
        torque = modelled.rigid_nm[:, axis]
        return np.stack([torque, torque * motion.sign[:, axis]], axis=1)[:, None, :]

    def neighbours(motion: MovingRows, _: Modelled) -> Floats:
        others = [other for other in range(6) if other != axis]
        return np.concatenate([motion.sign[:, others], motion.qd_rad_s[:, others]], axis=1)[:, None, :]

    def by_run(motion: MovingRows, _: Modelled) -> Floats:
        other = (motion.run == motion.run.max()).astype(float)
        return np.stack([other, other * motion.sign[:, axis], other * motion.qd_rad_s[:, axis]], axis=1)[:, None, :]

    shapes = ((angle, 4), (directed, 2), (speed, 3), (postures, 12), (neighbours, 10), (passed_on, 2), (by_run, 3))
    return [
        MovingTerm(
            "structure", (axis,), (axis,), columns, tuple(f"c{number}" for number in range(count)), str(position)
        )
        for position, (columns, count) in enumerate(shapes)
    ]
