"""Alignment of torque that a drive reports later than the position, before any fit.

The torque filter of a drive delays by some milliseconds. Every arm has this delay, so it is not an effect. If
uncorrected, its error would repeat in every period and look like a missing effect. The delay is taken from an estimate
of the same rows with all nuisance parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.periods import uninterrupted
from gateway.data.table import Table
from gateway.errors import DataUnusable
from gateway.estimate.moving_estimate import estimate_moving
from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.stretches import Stretches
from gateway.model.motion import LARGEST, MovingRows, prepare
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

#: Standard deviations from which on a delay is there.
_CERTAIN: Final = 3.0
#: Delay [s] beyond which it is none of a filter, but torque of another axis or sign.
_MOST_S: Final = 0.05
#: What of moving rows goes by the time of each axis: of every row, and of all.
_OF_ROWS: Final = ("q_rad", "qd_rad_s", "qdd_rad_s2", "judged", "sign", "rigid")
_OF_AXES: Final = ("speed_rad_s", "floor_nm")


def lags(table: Table, robot: Robot, knowledge: Knowledge) -> Floats:
    """Delay (N,) [s] of each axis's torque against its position; 0 where no delay is significant.

    The links are free in that fit, so that a delay cannot compensate for wrong CAD values.
    """
    moving = table.take(table.moving)
    free = replace(knowledge.of_loads(moving.load), link_std=np.inf, change=1.0)
    found = np.zeros(table.axes)
    try:
        motions = estimate_moving(moving, robot, free).motion
    except DataUnusable:  # too little for an estimation: the diagnosis says so itself
        return found
    for one in motions:
        if _CERTAIN * one.delay_std_s < one.delay_s < _MOST_S:
            found[one.joint - 1] = one.delay_s
    return found


def prepare_in_step(
    table: Table,
    holdout: Table | None,
    robot: Robot,
    gravity_m_s2: Floats,
    delay_s: Floats,
    largest: float = LARGEST,
) -> MovingRows:
    """Prepare rows with each axis's torque assigned to the motion `delay_s` (N,) earlier.

    The motion is shifted, not the torque, because the motion is smooth and torque jumps at a reversal.

    Raises
    ------
    DataUnusable
        No axis has torque rows in motion.
    """
    motion = prepare(table, holdout, robot, gravity_m_s2, largest)
    for delay in np.unique(delay_s[delay_s > 0]):
        mine = delay_s == delay
        then = prepare(_earlier(table, delay), holdout and _earlier(holdout, delay), robot, gravity_m_s2, largest)
        rows = {name: _columns_of(then, motion, name, mine) for name in _OF_ROWS}
        shifted = {name: np.where(mine, getattr(then, name), getattr(motion, name)) for name in _OF_AXES}
        motion = replace(motion, **rows, **shifted)
    return replace(motion, delay_s=delay_s)


def _columns_of(then: MovingRows, now: MovingRows, name: str, mine: NDArray[np.bool_]) -> NDArray[np.generic]:
    values = getattr(now, name).copy()
    values[:, mine] = getattr(then, name)[:, mine]
    return values


def _earlier(table: Table, delay_s: float) -> Table:
    """Return the table with the motion of its moving rows taken `delay_s` earlier."""
    rows = np.flatnonzero(table.moving)
    stretches = Stretches.of(uninterrupted(table)[rows], table.time_s[rows])
    seen = np.isfinite(table.q2nd_rad[rows]).all(axis=0)
    moved: dict[str, Floats] = {}
    for name in ("q_rad", "qd_rad_s", "qdd_rad_s2", "q2nd_rad"):
        axes = np.flatnonzero(seen) if name == "q2nd_rad" else np.arange(table.axes)
        moved[name] = getattr(table, name).copy()
        if len(axes):
            moved[name][np.ix_(rows, axes)] = stretches.earlier(moved[name][np.ix_(rows, axes)], delay_s)[0]
    return replace(table, **moved)
