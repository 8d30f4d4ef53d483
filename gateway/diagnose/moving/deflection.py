"""Joint elasticity of a moving run seen by a secondary encoder: the link stands behind the motor by the torque."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from gateway.diagnose.moving.fit import MovingProblem, counting_share
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.thresholds import MOVING
from gateway.result.result import EffectResult, Evidence

Floats = NDArray[np.float64]


def elastic_joints(problem: MovingProblem, state: MovingState) -> tuple[EffectResult, ...]:
    """Elastic joints among those with a secondary encoder.

    Wind-up is regressed on the modelled torque of the links, with a constant for the zeros of the two encoders. A joint
    counts where the slope is certain, and foretells the wind-up of blocks of time that were not in its fit.
    """
    motion = problem.motion
    found = []
    for axis in range(motion.axes):
        bend, torque = motion.wind_up_rad[:, axis], state.full.modelled.rigid_nm[:, axis]
        if not np.isfinite(bend).all() or not motion.measured[axis]:
            continue
        fitted = ~motion.given
        design = np.stack([-torque, np.ones(len(bend))], axis=1)
        value, *_ = np.linalg.lstsq(design[fitted], bend[fitted], rcond=None)
        left = (bend - design @ value)[fitted]
        rows = max(counting_share(left) * len(left), 3.0)
        least = 1e-7 + 1e-4 * float(np.ptp(bend))
        spread = max(float(np.sqrt(np.mean(left**2))), least) * np.sqrt(len(left) / rows)
        std = float(spread * np.sqrt(np.linalg.pinv(design[fitted].T @ design[fitted])[0, 0]))
        ratio, compliance = _foretold(problem, design, bend), float(value[0])
        bent = compliance * float(np.abs(torque).max())
        if compliance < MOVING.wind_up * std or ratio > MOVING.wind_up_ratio or bent > MOVING.largest_wind_up_rad:
            continue
        p_value = float(max(student.sf(compliance / std, rows - 2.0) * motion.axes, 1e-300))
        key, evidence = "compliance_rad_nm", Evidence(holdout_rms_ratio=ratio, p_value=p_value)
        found.append(EffectResult("joint_elasticity", (axis + 1,), {key: compliance}, {key: std}, evidence))
    return tuple(found)


def _foretold(problem: MovingProblem, design: Floats, bend: Floats) -> float:
    """RMS of the wind-up that is left on unseen rows, with the torque over without it."""
    squares = np.zeros(2)
    for train, test in problem.splits:
        for place, columns in enumerate((design, design[:, 1:])):
            value, *_ = np.linalg.lstsq(columns[train], bend[train], rcond=None)
            squares[place] += float(((bend - columns @ value)[test] ** 2).sum())
    return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 1.0
