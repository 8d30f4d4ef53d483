"""Joint elasticity in motion from a secondary encoder: the wind-up is proportional to the torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.wind_up import design_of, elastic, wind_up
from gateway.identify.correlation import counting_share
from gateway.model.motion import Mask
from gateway.result.result import EffectResult, Evidence

Floats = NDArray[np.float64]


def elastic_joints(
    problem: MovingProblem, state: MovingState, pairs: Sequence[tuple[Mask, Mask]]
) -> tuple[EffectResult, ...]:
    """Report elastic joints among those with a secondary encoder.

    The wind-up is regressed on the modelled torque of the links, with a constant for the zeros of the two encoders. A
    joint is reported if the slope is significant and predicts the wind-up of rows that were not in its fit; `pairs` are
    fitted and held-out rows.
    """
    motion = problem.motion
    found = []
    for axis in range(motion.axes):
        bend, torque = motion.wind_up_rad[:, axis], state.full.modelled.rigid_nm[:, axis]
        if not np.isfinite(bend).all() or not motion.measured[axis]:
            continue
        fitted = ~motion.held_out
        compliance, std, p_value = wind_up(torque[fitted], bend[fitted], counting_share, motion.axes)
        # Ratio of the held-out RMS of the wind-up with the torque to that without it
        design = design_of(torque)
        squares = np.zeros(2)
        for train, test in pairs:
            for place, columns in enumerate((design, design[:, 1:])):
                value, *_ = np.linalg.lstsq(columns[train], bend[train], rcond=None)
                squares[place] += float(((bend - columns @ value)[test] ** 2).sum())
        ratio = float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 1.0
        bent = compliance * float(np.abs(torque).max())
        if compliance < MOVING.wind_up * std or ratio > MOVING.wind_up_ratio or bent > MOVING.largest_wind_up_rad:
            continue
        found.append(elastic(axis, compliance, std, Evidence(holdout_rms_ratio=ratio, p_value=p_value)))
    return tuple(found)
