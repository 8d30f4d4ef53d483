"""Paths of straight joint motions between postures: positions on them, and postures as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Largest joint step between two points of a path at which the holding torque is checked [rad].
PATH_STEP_RAD = 0.05


def angles(q_rad: Sequence[float] | np.ndarray) -> str:
    """Return the text of a posture (N,)."""
    return "[" + ", ".join(f"{value:.3f}" for value in q_rad) + "] rad"


def path_points(start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
    """Return points (k, N) on a straight joint motion, at most `PATH_STEP_RAD` apart, both ends included."""
    path = np.array([start_rad, end_rad])
    return postures_at(path, path_positions(path))


def path_positions(path_rad: np.ndarray) -> np.ndarray:
    """Return positions (k,) in rows along a path (n, N), at most `PATH_STEP_RAD` apart, all rows included."""
    step = np.abs(np.diff(path_rad, axis=0)).max(axis=1)
    count = np.maximum(np.ceil(step / PATH_STEP_RAD), 1).astype(int)
    row = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return np.append(row + within / count[row], len(count))


def postures_at(path_rad: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return postures (k, N) at positions in rows along a path (n, N)."""
    row = np.minimum(place.astype(int), max(len(path_rad) - 2, 0))
    share = (place - row)[:, None]
    return (1.0 - share) * path_rad[row] + share * path_rad[np.minimum(row + 1, len(path_rad) - 1)]
