"""Rows of a diagnosis in motion: delayed torque aligned with position, and their division for choice and validation.

The torque filter of a drive delays by some milliseconds. Every arm has this delay, so it is not an effect. If
uncorrected, its error would repeat in every period and look like a missing effect. The delay is taken from an estimate
of the same rows with all nuisance parameters.

For repeated motion, a block of time is a part of the period, held out of all periods at once. Other periods of the same
motion would give no independent test. Blocks of time inside every run, pooled over the runs, choose. With several runs,
a run whose load is also in another run is held out whole, because blocks of one run say little about other runs.
User-given rows validate, or outer blocks inside every run, each validating a model chosen without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.periods import uninterrupted
from gateway.data.table import Table
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.errors import DataUnusable
from gateway.estimate.moving_estimate import estimate_moving
from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.stretches import Stretches
from gateway.model.motion import LARGEST, Mask, MovingRows, prepare
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

#: Standard deviations from which on a delay is there.
_CERTAIN: Final = 3.0
#: Delay [s] beyond which it is none of a filter, but torque of another axis or sign.
_MOST_S: Final = 0.05
#: What of moving rows goes by the time of each axis: of every row, and of all.
_OF_ROWS: Final = ("q_rad", "qd_rad_s", "qdd_rad_s2", "judged", "sign", "rigid")
_OF_AXES: Final = ("speed_rad_s", "floor_nm")
Splits = tuple[tuple[Mask, Mask], ...]
#: Time left out between what is fitted and what is held out, at most [s] and as a share of the run.
GAP_S, GAP_SHARE = 0.3, 0.03


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


def blocks(motion: MovingRows, count: int) -> Splits:
    """Blocks of time inside every run, pooled over the runs: (train, test) masks of shape (n,)."""
    pieces = [list(_pieces(motion, number, count)) for number in np.unique(motion.run)]
    return _joined(motion, [[own[(k + shift) % count] for shift, own in enumerate(pieces)] for k in range(count)])


def choosing(motion: MovingRows, count: int, known: frozenset[str]) -> Splits:
    """Splits for the choice: whole runs where other runs carry their load, else blocks of time."""
    runs = np.unique(motion.run[~motion.held_out])
    complete = [number for number in runs if len(runs) >= MOVING.several_runs and _shared(motion, number, known)]
    splits: list[list[tuple[Mask, Mask]]] = [[] for _ in range(count)]
    for place, number in enumerate(complete):
        mine = (motion.run == number) & ~motion.held_out
        splits[place % count].append((mine, mine))
    for shift, number in enumerate(number for number in runs if number not in complete):
        own = list(_pieces(motion, number, count))
        for k in range(count):
            splits[k].append(own[(k + shift) % count])
    return _joined(motion, splits)


def judging(motion: MovingRows, count: int) -> tuple[MovingRows, ...]:
    """Return the rows with each outer block in turn held out for validation; unchanged if the user held out rows."""
    if motion.held_out.any():
        return (motion,)
    return tuple(
        replace(motion, held_out=test, judged=motion.judged & (train | test)[:, None])
        for train, test in blocks(motion, count)
    )


def _shared(motion: MovingRows, number: int, known: frozenset[str]) -> bool:
    """Return True if every load of a run is known or is also in another run."""
    fitted = ~motion.held_out
    others = set(motion.load[fitted & (motion.run != number)])
    return all(label in others or label in known for label in {*motion.load[fitted & (motion.run == number)]})


def _pieces(motion: MovingRows, number: int, count: int) -> Iterator[tuple[Mask, Mask]]:
    """Rows of each block of a run that may be fitted, and those rows with their neighbours in time."""
    mine = (motion.run == number) & ~motion.held_out
    rows = np.flatnonzero(mine)
    rows = rows[np.argsort(motion.phase_s[rows], kind="stable")]
    gap = min(GAP_S, GAP_SHARE * float(np.ptp(motion.phase_s[rows]))) if len(rows) else 0.0
    for part in np.array_split(rows, count):
        test = np.zeros(len(motion), dtype=bool)
        test[part] = True
        if len(part):
            first, last = motion.phase_s[part[[0, -1]]]
            near = mine & (motion.phase_s >= first - gap) & (motion.phase_s <= last + gap)
            yield test, near | test
        else:
            yield test, test


def _joined(motion: MovingRows, splits: list[list[tuple[Mask, Mask]]]) -> Splits:
    out = []
    for parts in splits:
        if parts:
            test, near = (np.any([part[place] for part in parts], axis=0) for place in (0, 1))
            if test.any():
                out.append((~motion.held_out & ~near, test))
    return tuple(out)
