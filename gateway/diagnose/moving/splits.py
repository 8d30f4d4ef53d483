"""Division of rows into those that choose a model and those that validate it.

For repeated motion, a block of time is a part of the period, held out of all periods at once. Other periods of the same
motion would give no independent test. Blocks of time inside every run, pooled over the runs, choose. With several runs,
a run whose load is also in another run is held out whole, because blocks of one run say little about other runs.
User-given rows validate, or outer blocks inside every run, each validating a model chosen without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.model.motion import Mask, MovingRows

Splits = tuple[tuple[Mask, Mask], ...]

#: Time left out between what is fitted and what is held out, at most [s] and as a share of the run.
GAP_S, GAP_SHARE = 0.3, 0.03


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
