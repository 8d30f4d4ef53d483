"""Test of the residual for dependence on the motion.

Columns without a physical cause (harmonics of the angles, speeds, motion of the neighbours, another friction in the
last run) are tried like effects. If they improve held-out rows, the residual has structure that no effect of the
library explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.trial import Trial, put_on_trial
from gateway.model.motion import Modelled, MovingRows
from gateway.model.term import OnAxis
from gateway.model.unnamed import harmonics

Floats = NDArray[np.float64]


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
    return (
        trial.ratio <= MOVING.structure_ratio
        and trial.p_held <= 10.0 * MOVING.structure_p
        and trial.p_demand <= MOVING.structure_p
    )


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
