"""Detect rest intervals in a log: poses and approach direction of each joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from gateway.formats.log_map import LogRest

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Rest interval: rows, pose number, sign of each joint's last motion (N,); 0 = unknown."""

    rows: slice
    pose: int
    direction: NDArray[np.int8]


def at_rest(time_s: Floats, q_rad: Floats, labels: NDArray[np.object_], rest: LogRest) -> list[Stretch]:
    """Return the intervals in which no joint moves, each with one load.

    Parameters
    ----------
    time_s : array of shape (n,)
    q_rad : array of shape (n, N)
    labels : array of shape (n,)
        Label of the load.
    rest : LogRest
    """
    found: list[Stretch] = []
    known: list[Floats] = []
    for start, stop in _windows(time_s, q_rad, labels, rest):
        begin = int(np.searchsorted(time_s, time_s[start] + rest.settle_s))
        end = int(np.searchsorted(time_s, time_s[stop - 1] - rest.settle_s, side="right"))
        if end - begin < 2:
            continue
        mean = q_rad[begin:end].mean(axis=0)
        pose = _pose(mean, known, rest.same_pose_rad)
        found.append(
            Stretch(slice(begin, end), rest.first_pose + pose, _direction(q_rad[:start], mean, rest.within_rad))
        )
    return found


def _windows(time_s: Floats, q_rad: Floats, labels: NDArray[np.object_], rest: LogRest) -> list[tuple[int, int]]:
    """Yield the first row and the row after the last of each rest interval."""
    if len(time_s) < 2:
        return []
    width = max(2, round(rest.seconds / float(np.median(np.diff(time_s)))) + 1)
    if width > len(time_s):
        return []
    _, load = np.unique(labels.astype(str), return_inverse=True)
    watched = np.column_stack([q_rad / rest.within_rad, 2.0 * load])
    origin = (width - 1) // 2 - (width - 1)  # the window begins at its row
    spread = maximum_filter1d(watched, width, axis=0, origin=origin) - minimum_filter1d(
        watched, width, axis=0, origin=origin
    )
    still = np.asarray((spread <= 1.0).all(axis=1))
    still[len(time_s) - width + 1 :] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [(int(first), int(last) - 1 + width) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def _pose(mean_rad: Floats, known: list[Floats], same_rad: float) -> int:
    for number, other in enumerate(known):
        if np.abs(mean_rad - other).max() <= same_rad:
            return number
    known.append(mean_rad)
    return len(known) - 1


def _direction(before_rad: Floats, mean_rad: Floats, within_rad: float) -> NDArray[np.int8]:
    signs = np.zeros(len(mean_rad), dtype=np.int8)
    for joint, at_rad in enumerate(mean_rad):
        elsewhere = np.flatnonzero(np.abs(before_rad[:, joint] - at_rad) > within_rad)
        if len(elsewhere):
            signs[joint] = np.sign(at_rad - before_rad[elsewhere[-1], joint])
    return signs
