"""Exact distances between line segments and boxes, vectorised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def segment_box_distance(start_m: Floats, end_m: Floats, low_m: Floats, high_m: Floats) -> Floats:
    """Return the exact distances (m,) [m] of segments from axis-aligned boxes; 0 where they intersect.

    The squared distance along the segment is convex and piecewise quadratic between its intersections with the planes
    of the box. Its slope is piecewise linear, so that the minimum is found without iteration.

    Parameters
    ----------
    start_m, end_m, low_m, high_m : arrays of shape (m, 3)
        Ends of the segments, lower and upper corners of the boxes.
    """
    direction = end_m - start_m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        planes = np.concatenate([(low_m - start_m) / direction, (high_m - start_m) / direction], axis=1)
    ends = np.tile([0.0, 1.0], (len(direction), 1))
    at = np.sort(np.concatenate([np.clip(np.nan_to_num(planes), 0.0, 1.0), ends], axis=1), axis=1)
    slope = np.einsum(
        "mtk,mk->mt", _beyond(start_m[:, None] + at[:, :, None] * direction[:, None], low_m, high_m), direction
    )
    last = np.clip((slope <= 0.0).sum(axis=1) - 1, 0, at.shape[1] - 2)
    rows = np.arange(len(direction))
    before, after = slope[rows, last], slope[rows, last + 1]
    rise = np.where(after > before, after - before, 1.0)
    share = np.clip(-before / rise, 0.0, 1.0)
    least = at[rows, last] + share * (at[rows, last + 1] - at[rows, last])
    nearest = start_m + least[:, None] * direction
    return np.linalg.norm(_beyond(nearest[:, None], low_m, high_m)[:, 0], axis=1)


def _beyond(points: Floats, low: Floats, high: Floats) -> Floats:
    """Return the vectors (m, t, 3) from the nearest points of boxes (m, 3) to points (m, t, 3)."""
    return points - np.clip(points, low[:, None], high[:, None])


def segment_segment_distance(first_m: Floats, other_m: Floats) -> Floats:
    """Return the exact distances (m,) [m] between segments; 0 where they intersect.

    Ericson, Real-Time Collision Detection, 2005, section 5.1.9: nearest points of the two lines, each clamped to its
    segment in turn.

    Parameters
    ----------
    first_m, other_m : arrays of shape (m, 2, 3)
        Ends of the segments.
    """
    direction, others, between = (
        first_m[:, 1] - first_m[:, 0],
        other_m[:, 1] - other_m[:, 0],
        first_m[:, 0] - other_m[:, 0],
    )
    a, e, b = _dot(direction, direction), _dot(others, others), _dot(direction, others)
    c, f = _dot(direction, between), _dot(others, between)
    across = a * e - b * b
    at = np.where(across > 1e-12 * a * e, np.clip((b * f - c * e) / np.where(across > 0.0, across, 1.0), 0.0, 1.0), 0.0)
    other_at = np.clip((b * at + f) / np.where(e > 0.0, e, 1.0), 0.0, 1.0)
    at = np.clip((b * other_at - c) / np.where(a > 0.0, a, 1.0), 0.0, 1.0)
    return np.linalg.norm(between + at[:, None] * direction - other_at[:, None] * others, axis=1)


def _dot(first: Floats, other: Floats) -> Floats:
    return np.einsum("mk,mk->m", first, other)
