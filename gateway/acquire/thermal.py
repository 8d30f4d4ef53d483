"""Reduce the effect of thermal drift: order of the loads, and a warm-up before them.

Loads are measured in forward and reverse order, with the unloaded arm twice in the middle: a, bare, bare, a. A drift
that is linear in time then has the same mean under every load and cancels in the differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from gateway.data.recording.reader import read
from gateway.data.visit import RestPose
from gateway.identify.drift import AGAIN
from gateway.identify.prior_loads import BARE_LABEL

#: Number of poses in one round of the warm-up.
ROUND_POSES: Final = 4
#: Relative change of the friction band between rounds below which an arm counts as warm.
STILL: Final = 0.02


@dataclass(frozen=True, slots=True)
class Block:
    """Poses that are measured one after the other under one load."""

    load: str
    poses: tuple[RestPose, ...]


def blocks_of(labels: Sequence[str], poses: Sequence[RestPose], is_thermal: bool) -> tuple[Block, ...]:
    """Return the blocks in measuring order.

    Without `is_thermal`: the unloaded arm, then each load. With it: the loads, the unloaded arm twice, the loads in
    reverse order; the second block of a load has the same poses under new numbers.
    """
    once = tuple(poses)
    if not is_thermal:
        return tuple(Block(label, once) for label in (BARE_LABEL, *labels))
    again = _again(once)
    forth = [Block(label, once) for label in (*labels, BARE_LABEL)]
    return (*forth, *(Block(block.load, again) for block in reversed(forth)))


def bracket_of(label: str, poses: Sequence[RestPose]) -> tuple[Block, ...]:
    """Return the blocks of a load between two of the unloaded arm: linear drift cancels in their difference."""
    once = tuple(poses)
    return (Block(BARE_LABEL, once), Block(label, once), Block(BARE_LABEL, _again(once)))


def _again(poses: Sequence[RestPose]) -> tuple[RestPose, ...]:
    """Return the same poses under the numbers of the second block."""
    return tuple(replace(pose, number=pose.number + AGAIN) for pose in poses)


def warm_up(
    poses: Sequence[RestPose],
    path: Path,
    longest_s: float,
    measure: Callable[[Sequence[RestPose]], None],
) -> str:
    """Move between a few poses until their friction no longer changes, or the time is over; return the outcome.

    Parameters
    ----------
    poses : sequence of RestPose
    path : Path
        Recording of the warm-up; it is continued.
    longest_s : float
        Longest duration [s], in bus time.
    measure : callable
        Function that measures poses and appends them to the recording.
    """
    chosen = poses[:ROUND_POSES]
    number = _rounds(path)
    while True:
        number += 1
        measure([replace(pose, number=pose.number + AGAIN * (number - 1)) for pose in chosen])
        bands, time_s = _bands(path, number)
        change = np.nanmedian(np.abs(bands[-1] / bands[-2])) - 1.0 if number > 1 else np.inf
        if abs(change) <= STILL:
            return f"warm: after {time_s / 60:.1f} min friction changes by {100 * change:+.1f} % a round"
        if time_s >= longest_s:
            return (
                f"the warm-up ends after {time_s / 60:.1f} min, friction still changes by {100 * change:+.1f} % a round"
            )


def _rounds(path: Path) -> int:
    """Return the number of rounds in a file."""
    if not path.exists():
        return 0
    return max(
        (visit.pose // AGAIN + 1 for arm in read(path).arms for visit in arm.visits if visit.complete), default=0
    )


def _bands(path: Path, rounds: int) -> tuple[np.ndarray, float]:
    """Return the friction bands (rounds, poses, N) [Nm] of the warm-up, and its duration [s]."""
    visits = [visit for arm in read(path).arms for visit in arm.visits if visit.complete]
    both = [(visit.pose, visit.friction_band_nm) for visit in visits if visit.friction_band_nm is not None]
    both.sort(key=lambda each: each[0])
    seen = [[band for pose, band in both if pose // AGAIN == one] for one in range(rounds)]
    shortest = min(len(row) for row in seen)
    taken_s = float(visits[-1].time_s[-1] - visits[0].time_s[0])
    return np.array([row[:shortest] for row in seen]), taken_s
