"""Bodies of a link for distances: capsules around its shapes, and exact convex hulls with a radius."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gateway.model.mesh import MeshError, find_mesh, mesh_corners
from gateway.model.robot import LinkShape
from gateway.model.urdf_shapes import Box, Cylinder, Mesh, Sphere

Floats = NDArray[np.float64]

#: Number of steps to find the circle around projected vertices; it is at most 1 / steps too large.
CIRCLE_STEPS = 200
#: Number of sides of the prism around a cylinder, wider by 1 / cos(pi / sides) - 1 = 0.9 % at its edges.
CYLINDER_SIDES = 24
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, slots=True, eq=False)
class Capsule:
    """Capsule: all points within `radius_m` of the segment from `start_m` to `end_m`, arrays of shape (3,)."""

    start_m: Floats
    end_m: Floats
    radius_m: float


def capsule_of(body: LinkShape, source: str) -> Capsule:
    """Return a capsule, in the link's frame, that contains one shape of a link.

    Parameters
    ----------
    body : LinkShape
    source : str
        File that names the shape; mesh paths are relative to it.

    Raises
    ------
    MeshError
        The shape is a mesh that cannot be read, or of an unknown kind.
    """
    shape, pose = body.shape, body.pose
    middle, along = pose[:3, 3], pose[:3, 2]
    if isinstance(shape, Sphere):
        return Capsule(middle, middle, shape.radius_m)
    if isinstance(shape, Cylinder):
        return Capsule(middle - shape.length_m / 2 * along, middle + shape.length_m / 2 * along, shape.radius_m)
    if isinstance(shape, Box):
        longest = int(np.argmax(shape.size_m))
        across = np.delete(np.array(shape.size_m), longest)
        half = shape.size_m[longest] / 2 * pose[:3, longest]
        return Capsule(middle - half, middle + half, float(np.linalg.norm(across)) / 2)
    if isinstance(shape, Mesh):
        points = mesh_corners(find_mesh(shape.file, source)) * shape.scale
        return capsule_around(points @ pose[:3, :3].T + middle)
    raise MeshError(f"{shape.what} is not known, or has no size")


def capsule_around(points_m: Floats) -> Capsule:
    """Return a small capsule around points (n, 3): the smallest along their principal and the coordinate axes."""
    with suppress(QhullError, ValueError):  # flat or few: all points are kept
        points_m = points_m[ConvexHull(points_m).vertices]
    spread = points_m - points_m.mean(axis=0)
    principal = np.linalg.eigh(spread.T @ spread)[1].T
    return min((_along(points_m, axis) for axis in (*principal, *np.eye(3))), key=_volume)


def _volume(capsule: Capsule) -> float:
    return capsule.radius_m**2 * (float(np.linalg.norm(capsule.end_m - capsule.start_m)) + 4 / 3 * capsule.radius_m)


def _along(points: Floats, axis: Floats) -> Capsule:
    """Return a capsule around points with its segment along a unit axis, as short as its end caps allow."""
    across = np.linalg.svd(axis[None])[2][1:]
    flat, height = points @ across.T, points @ axis
    centre = _circle(flat)
    distance = np.linalg.norm(flat - centre, axis=1)
    radius = float(distance.max())
    bulge = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    low, high = float((height + bulge).min()), float((height - bulge).max())
    if low > high:
        low = high = (low + high) / 2
    foot = centre @ across
    return Capsule(foot + low * axis, foot + high * axis, radius)


def _circle(points: Floats) -> Floats:
    """Return the centre (2,) of a small circle around points (n, 2).

    Badoiu and Clarkson, Smaller core-sets for balls, 2003: successively shorter steps to the farthest point.
    """
    centre = best = (points.min(axis=0) + points.max(axis=0)) / 2
    least = np.inf
    for step in range(1, CIRCLE_STEPS + 1):
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] < least:
            least, best = distance[farthest], centre
        centre = centre + (points[farthest] - centre) / (step + 1)
    return best


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Convex body, and a capsule around it.

    Attributes
    ----------
    points_m : array of shape (v, 3)
        The body is their convex hull, enlarged by `radius_m` on all sides.
    radius_m : float
    around : Capsule
        Capsule that contains the body; equal to the body for one or two points.
    """

    points_m: Floats
    radius_m: float
    around: Capsule

    @property
    def plain(self) -> bool:
        """True if the body is a capsule or a ball, so that distances to `around` are exact."""
        return len(self.points_m) <= 2


def solid_capsule(capsule: Capsule) -> Solid:
    """Return a capsule as a body."""
    return Solid(np.array([capsule.start_m, capsule.end_m]), capsule.radius_m, capsule)


def solid_box(size_m: Floats, pose: Floats) -> Solid:
    """Return a box of a size (3,) about the origin of a pose (4, 4)."""
    size = (float(size_m[0]), float(size_m[1]), float(size_m[2]))
    return solid_of(LinkShape(pose, Box(size), True), "")


def solid_of(body: LinkShape, source: str) -> Solid:
    """Return the body, in the link's frame, of one shape of a link; for a mesh a convex body around it.

    Parameters
    ----------
    body : LinkShape
    source : str
        File that names the shape; mesh paths are relative to it.

    Raises
    ------
    MeshError
        The shape is a mesh that cannot be read, or of an unknown kind.
    """
    shape, pose = body.shape, body.pose
    around = capsule_of(body, source)
    if isinstance(shape, Cylinder) and not shape.rounded:
        angle = 2 * np.pi * np.arange(CYLINDER_SIDES) / CYLINDER_SIDES
        circle = shape.radius_m / np.cos(np.pi / CYLINDER_SIDES) * np.column_stack([np.cos(angle), np.sin(angle)])
        ends = [np.column_stack([circle, np.full(CYLINDER_SIDES, end * shape.length_m / 2)]) for end in (-1, 1)]
        points = np.vstack(ends)
    elif isinstance(shape, Box):
        points = _CORNERS * shape.size_m
    elif isinstance(shape, Mesh):
        points = mesh_corners(find_mesh(shape.file, source)) * shape.scale
        try:
            points = points[ConvexHull(points).vertices]
        except (QhullError, ValueError):  # flat or few: the capsule is the body
            return solid_capsule(around)
    else:
        return solid_capsule(around)
    return Solid(points @ pose[:3, :3].T + pose[:3, 3], 0.0, around)
