"""Distances of an arm's body to the keep-out boxes, at postures and all along ways between them.

A way is proven clear, not sampled: between two postures no point of a capsule's segment moves farther than the joint
steps times its levers, so that a stretch whose two ends are clear by more than that in sum is clear everywhere; any
other stretch is halved (as in conservative advancement, Mirtich 1996, section 2.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.model.kinematics import link_frames
from gateway.model.robot import Robot
from gateway.motion.body import Body

Floats = NDArray[np.float64]

#: Boxes are taken smaller by this on every side: what touches from outside is outside.
BOX_TOLERANCE_M = 1e-6
#: A stretch of a way along which no point of the arm moves farther is not halved again; it is blocked unless it is
#: proven clear, so that a way that passes a box closer than half of this is refused.
PATH_RESOLUTION_M = 0.002
#: Rows that are worked on at once.
_BLOCK = 8192


def segment_box_distance(start_m: Floats, end_m: Floats, low_m: Floats, high_m: Floats) -> Floats:
    """Exact distance (m,) [m] of segments to axis-aligned boxes; 0 where they meet.

    The squared distance along the segment is convex and quadratic between the points at which the segment crosses a
    plane of the box: its slope is linear there, so that its zero is found without iteration.

    Parameters
    ----------
    start_m, end_m, low_m, high_m : arrays of shape (m, 3)
        Ends of the segments, lower and upper corners of the boxes.
    """
    way = end_m - start_m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        planes = np.concatenate([(low_m - start_m) / way, (high_m - start_m) / way], axis=1)
    ends = np.tile([0.0, 1.0], (len(way), 1))
    at = np.sort(np.concatenate([np.clip(np.nan_to_num(planes), 0.0, 1.0), ends], axis=1), axis=1)
    slope = np.einsum("mtk,mk->mt", _beyond(start_m[:, None] + at[:, :, None] * way[:, None], low_m, high_m), way)
    last = np.clip((slope <= 0.0).sum(axis=1) - 1, 0, at.shape[1] - 2)
    rows = np.arange(len(way))
    before, after = slope[rows, last], slope[rows, last + 1]
    rise = np.where(after > before, after - before, 1.0)
    share = np.clip(-before / rise, 0.0, 1.0)
    least = at[rows, last] + share * (at[rows, last + 1] - at[rows, last])
    nearest = start_m + least[:, None] * way
    return np.linalg.norm(_beyond(nearest[:, None], low_m, high_m)[:, 0], axis=1)


def _beyond(points: Floats, low: Floats, high: Floats) -> Floats:
    """Vectors (m, t, 3) from the nearest points of boxes (m, 3) to points (m, t, 3)."""
    return points - np.clip(points, low[:, None], high[:, None])


def clearance_m(robot: Robot, body: Body, boxes_m: Floats, q_rad: Floats, enough_m: Floats | None = None) -> Floats:
    """Distance [m] of every capsule's surface to every box, 0 or less where it is inside.

    Parameters
    ----------
    robot : Robot
    body : Body
    boxes_m : array of shape (b, 2, 3)
        Lower and upper corners.
    q_rad : array of shape (n, N)
    enough_m : array of shape (n, capsules), optional
        Where a bounding ball is clear by this, its clearance is given: a lower bound. 0 if left out.

    Returns
    -------
    array of shape (n, capsules, b)
    """
    out = np.empty((len(q_rad), len(body.link), len(boxes_m)))
    for first in range(0, len(q_rad), _BLOCK):
        rows = slice(first, first + _BLOCK)
        frames = link_frames(robot, q_rad[rows])
        out[rows] = _clearance(body, frames, boxes_m, 0.0 if enough_m is None else enough_m[rows, :, None])
    return out


def _clearance(body: Body, frames: Floats, boxes_m: Floats, enough_m: Floats | float) -> Floats:
    """As `clearance_m`, at link frames (n, N, 4, 4)."""
    low, high = boxes_m[:, 0] + BOX_TOLERANCE_M, boxes_m[:, 1] - BOX_TOLERANCE_M
    segments = body.segments_m(frames)
    middle = segments.mean(axis=2)[:, :, None]
    half = np.linalg.norm(body.end_m - body.start_m, axis=1) / 2
    thick = body.radius_m[:, None]
    centre = np.linalg.norm(middle - np.clip(middle, low, high), axis=3)
    found = centre - half[:, None] - thick
    inside = centre <= thick
    found = np.where(inside, centre - thick, found)
    row, capsule, box = np.nonzero((found <= enough_m) & ~inside)
    near = segments[row, capsule]
    found[row, capsule, box] = (
        segment_box_distance(near[:, 0], near[:, 1], low[box], high[box]) - body.radius_m[capsule]
    )
    return found


def blocked_at(robot: Robot, body: Body, boxes_m: Floats, start_rad: Floats, end_rad: Floats) -> Floats:
    """Where straight joint motions meet a box, or cannot be proven to miss it: share of the way, NaN = clear.

    Parameters
    ----------
    robot : Robot
    body : Body
    boxes_m : array of shape (b, 2, 3)
    start_rad, end_rad : arrays of shape (n, N)

    Returns
    -------
    array of shape (n,)
        A place on the way that is not clear; not always the first.
    """
    found = np.full(len(start_rad), np.nan)
    if not len(boxes_m) or not len(start_rad):
        return found
    way = end_rad - start_rad
    path = np.abs(way) @ body.levers_m(robot).T
    owner, low, high = np.arange(len(way)), np.zeros(len(way)), np.ones(len(way))

    def clear(at: Floats) -> Floats:
        step = path[owner] * (high - low)[:, None]
        return clearance_m(robot, body, boxes_m, start_rad[owner] + at[:, None] * way[owner], step / 2)

    def mark(at: Floats, bad: NDArray[np.bool_]) -> None:
        rows = np.flatnonzero(bad.any(axis=(1, 2)))
        found[owner[rows]] = at[rows]

    before, after = clear(low), clear(high)
    mark(high, after <= 0.0)
    mark(low, before <= 0.0)
    while True:
        step = path[owner] * (high - low)[:, None]
        doubtful = before + after <= step[:, :, None]
        mark(low, doubtful & (step <= PATH_RESOLUTION_M)[:, :, None])
        left = np.flatnonzero(doubtful.any(axis=(1, 2)) & np.isnan(found[owner]))
        if not len(left):
            return found
        owner, low, high, before, after = owner[left], low[left], high[left], before[left], after[left]
        middle = (low + high) / 2
        between = clear(middle)
        mark(middle, between <= 0.0)
        owner = np.concatenate([owner, owner])
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        before, after = np.concatenate([before, between]), np.concatenate([between, after])
