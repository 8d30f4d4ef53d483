"""Distances between convex bodies, and to boxes, computed with FCL."""

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
        """Return the distance [m] of two bodies at frames (N + 1, 4, 4)."""
        one, two = self._shapes[first], self._shapes[other]
        return one.placed(frames[self._link[first] + 1]).distance_m(two.placed(frames[self._link[other] + 1]))

    def box_m(self, frames: Floats, first: int, box: int) -> float:
        """Return the distance [m] of a body from a box at frames (N + 1, 4, 4)."""
        obstacle = self._boxes[box]
        if obstacle is None:
            return np.inf
        return float(fcl.distance(self._shapes[first].placed(frames[self._link[first] + 1]).thing, obstacle))


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
        self._turned = solid.plain
        self.thing: Any = fcl.CollisionObject(shape)

    def placed(self, frame: Floats) -> _Shape:
        """Return the FCL object placed at a frame (4, 4)."""
        pose = frame @ self._pose if self._turned else frame
        self.thing.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
        return self

    def distance_m(self, other: _Shape) -> float:
        """Return the distance [m] to another body, -1 at contact."""
        return float(fcl.distance(self.thing, other.thing))


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
