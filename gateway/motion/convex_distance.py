"""Distances between convex bodies, and to boxes (FCL); distances between line segments and boxes, vectorised."""

from __future__ import annotations

from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from gateway.model.solid import Solid
from gateway.motion.body import Body

Floats = NDArray[np.float64]

#: Boxes are shrunk by this on every side [m], so that touching from outside does not count as contact; also the
#: smallest body size.
TOLERANCE_M = 1e-6


class Exact:
    """Exact distances of the bodies of an arm."""

    def __init__(self, body: Body, boxes_m: Floats, most_m: float) -> None:
        self.plain = np.array([solid.plain for solid in body.solids], dtype=bool)
        self._link = body.link
        self._shapes = [_Shape(solid) for solid in body.solids]
        # a box of kilometres would cost the distance its digits: only what the arm can reach of it counts
        near = np.clip(boxes_m, -most_m, most_m)
        self._boxes = [_box(low, high) for low, high in near]

    def solids_m(self, frames: Floats, first: int, other: int) -> float:
        """Return the distance [m] of two bodies at frames (N + 1, 4, 4), -1 at contact."""
        placed = [self._shapes[body].placed(frames[self._link[body] + 1]) for body in (first, other)]
        return float(fcl.distance(*placed))

    def box_m(self, frames: Floats, first: int, box: int) -> float:
        """Return the distance [m] of a body from a box at frames (N + 1, 4, 4)."""
        obstacle = self._boxes[box]
        if obstacle is None:
            return np.inf
        return float(fcl.distance(self._shapes[first].placed(frames[self._link[first] + 1]), obstacle))


class _Shape:
    """Body as an FCL object."""

    def __init__(self, solid: Solid) -> None:
        around = solid.around
        length = float(np.linalg.norm(around.end_m - around.start_m))
        self._pose = np.eye(4)
        if not solid.plain:
            shape: Any = _hull(solid.points_m)
        elif length > 0.0:
            shape = fcl.Capsule(max(around.radius_m, TOLERANCE_M), length)
            along = (around.end_m - around.start_m) / length
            across = np.linalg.svd(along[None])[2][1]
            self._pose[:3, :3] = np.column_stack([across, np.cross(along, across), along])
        else:
            shape = fcl.Sphere(max(around.radius_m, TOLERANCE_M))
        if solid.plain:
            self._pose[:3, 3] = (around.start_m + around.end_m) / 2
        self._object: Any = fcl.CollisionObject(shape)

    def placed(self, frame: Floats) -> Any:
        """Return the FCL object placed at a frame (4, 4)."""
        pose = frame @ self._pose
        self._object.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
        return self._object


def _hull(points_m: Floats) -> Any:
    """Return the convex FCL body from vertices and outward faces."""
    hull = ConvexHull(points_m)
    number = {vertex: row for row, vertex in enumerate(hull.vertices)}
    faces: list[int] = []
    for corners, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = points_m[corners]
        outward = np.cross(b - a, c - a) @ plane[:3] > 0.0
        faces += [3, *(number[corner] for corner in (corners if outward else corners[::-1]))]
    return fcl.Convex(points_m[hull.vertices], len(hull.simplices), np.array(faces))


def _box(low_m: Floats, high_m: Floats) -> Any:
    """Return a fixed box; None if it is empty."""
    size = high_m - low_m - 2 * TOLERANCE_M
    if not (size > 0.0).all():
        return None
    return fcl.CollisionObject(fcl.Box(*size), fcl.Transform((low_m + high_m) / 2))


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
