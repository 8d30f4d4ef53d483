"""Bodies of the arm for display: the convex bodies of the clearance check, with few corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gateway.live.wire import ShownArm, ShownBody
from gateway.model.solid import Solid
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

#: Number of directions with an extreme point of a body; upper bound of drawn corners.
DIRECTIONS = 96
#: Corners around a ball at each end of a capsule, as rows from its pole to its rim, and around.
RINGS, SIDES = 3, 14
#: Faces of a hull that are in one plane are drawn as one, up to this difference of their normals.
FLAT = 1e-4


def shown_arm(name: str, workspace: Workspace) -> ShownArm:
    """Return an arm for display, with its limits and its bodies."""
    space = workspace.space
    assumed = tuple(f"{part.name}: {part.source}" for part in space.body.parts if not part.known)
    return ShownArm(
        name=name,
        robot=workspace.robot,
        bodies=tuple(
            shown_body(int(link), solid) for link, solid in zip(space.body.link, space.body.solids, strict=True)
        ),
        boxes_m=space.boxes_m,
        assumed=assumed,
        modelled=workspace.links is not None,
        speed_rad_s=workspace.speed_rad_s,
        torque_nm=workspace.torque_nm,
        following_error_rad=workspace.following_error_rad,
    )


def shown_body(link: int, solid: Solid) -> ShownBody:
    """Return a body with few corners; of a capsule, points on its surface."""
    points = _capsule_points(solid) if solid.plain else _outermost(solid.points_m)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # flat: the capsule around it is drawn
        points = _capsule_points(solid)
        hull = ConvexHull(points)
    planes: list[tuple[Floats, set[int]]] = []
    for equation, corners in zip(hull.equations, hull.simplices, strict=True):
        for known, together in planes:
            if float(np.abs(known - equation).max()) < FLAT:
                together.update(corners.tolist())
                break
        else:
            planes.append((equation, set(corners.tolist())))
    return ShownBody(
        link, points, tuple(_around(hull.points, equation[:3], sorted(corners)) for equation, corners in planes)
    )


def _outermost(points_m: Floats) -> Floats:
    """Return the extreme points of (v, 3) in fixed directions, at most `DIRECTIONS` of them."""
    if len(points_m) <= DIRECTIONS:
        return points_m
    # directions spread evenly over the sphere: Saff and Kuijlaars, Distributing many points on a sphere, 1997
    number = np.arange(DIRECTIONS)
    height = 1.0 - (2.0 * number + 1.0) / DIRECTIONS
    angle = number * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    directions = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    return points_m[np.unique(np.argmax(points_m @ directions.T, axis=0))]


def _capsule_points(solid: Solid) -> Floats:
    """Return points on the capsule around a body."""
    around = solid.around
    way = around.end_m - around.start_m
    length = float(np.linalg.norm(way))
    along = way / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    across = np.linalg.svd(along[None])[2][1:]
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
    points = []
    for end, sign in ((around.start_m, -1.0), (around.end_m, 1.0)):
        points.append(end[None] + sign * around.radius_m * along)
        for ring in range(RINGS):
            tilt = 0.5 * np.pi * ring / RINGS
            ball = np.cos(tilt) * circle + sign * np.sin(tilt) * along
            points.append(end + around.radius_m * ball)
    return np.vstack(points)


def _around(points: Floats, normal: Floats, corners: list[int]) -> tuple[int, ...]:
    """Return the corners of a convex polygon in order around its normal."""
    place = points[corners] - points[corners].mean(axis=0)
    first = place[0] / np.linalg.norm(place[0])
    second = np.cross(normal, first)
    angle = np.arctan2(place @ second, place @ first)
    return tuple(corners[index] for index in np.argsort(angle))
