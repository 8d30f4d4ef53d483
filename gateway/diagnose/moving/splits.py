"""Which rows choose a model and which rows judge it.

Where a motion repeats, a block of time is a part of the period, held out of all periods at once: a period says nothing
new of a model that has seen another one.

Blocks of time inside every run, pooled over the runs, choose; where there are several runs, those whose load hangs in
another run too are held out whole, because blocks of one run say little about another. Rows that were given judge, or
outer blocks inside every run, each judged by a model that was chosen without it.
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
    """Splits that choose: whole runs where the others still show their load, blocks of time in the others."""
    runs = np.unique(motion.run[~motion.held_out])
    whole = [number for number in runs if len(runs) >= MOVING.several_runs and _shared(motion, number, known)]
    splits: list[list[tuple[Mask, Mask]]] = [[] for _ in range(count)]
    for place, number in enumerate(whole):
        mine = (motion.run == number) & ~motion.held_out
        splits[place % count].append((mine, mine))
    for shift, number in enumerate(number for number in runs if number not in whole):
        own = list(_pieces(motion, number, count))
        for k in range(count):
            splits[k].append(own[(k + shift) % count])
    return _joined(motion, splits)


def judging(motion: MovingRows, count: int) -> tuple[MovingRows, ...]:
    """The rows, with each outer block in turn given to judge; as they are where rows were given."""
    if motion.held_out.any():
        return (motion,)
    return tuple(
        replace(motion, held_out=test, judged=motion.judged & (train | test)[:, None])
        for train, test in blocks(motion, count)
    )


def _shared(motion: MovingRows, number: int, known: frozenset[str]) -> bool:
    """Whether every load of a run is known, or hangs in another run too."""
    fitted = ~motion.held_out
    others = set(motion.load[fitted & (motion.run != number)])
    return all(label in others or label in known for label in {*motion.load[fitted & (motion.run == number)]})


def _pieces(motion: MovingRows, number: int, count: int) -> Iterator[tuple[Mask, Mask]]:
    """Rows of each block of a run that may be fitted, and those with the rows near to it."""
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
