"""Exact bodies of a link: all points within a radius of the convex hull of a few points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gateway.model.capsule import Capsule, capsule_of
from gateway.model.mesh import find_mesh, mesh_corners
from gateway.model.robot import LinkShape
from gateway.model.urdf_shapes import Box, Cylinder, Mesh

Floats = NDArray[np.float64]

#: Number of sides of the prism around a cylinder, wider by 1 / cos(pi / sides) - 1 = 0.9 % at its edges.
CYLINDER_SIDES = 24
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


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
