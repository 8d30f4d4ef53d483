"""Geometry of an arm: base, links and load as convex bodies, each with the source of its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.model.kinematics import link_frames
from gateway.model.mesh import MeshError
from gateway.model.robot import LinkShape, Robot, reach_m
from gateway.model.solid import Capsule, Solid, solid_box, solid_capsule, solid_of

Floats = NDArray[np.float64]

#: Assumed radius of a link without geometry, as a share of the arm's reach: arms of the 10 kg class (reach 1.3 m) have
#: links of 0.10 to 0.15 m in diameter, those of the 165 kg class (2.7 m) of 0.25 to 0.35 m.
ASSUMED_SHARE = 0.05
GEOMETRY = "collision geometry of the URDF"
#: Link index of fixed bodies.
BASE = -1
#: Name of the part on the flange.
LOAD = "load"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Bodies of one part of the arm.

    Attributes
    ----------
    name : str
        "base", "column", "link 3", "load".
    link : int
        Index (from 0) of the link that the part moves with; `BASE` = fixed.
    solids : tuple of Solid
        Bodies in the frame of that link; fixed parts in the base frame.
    source : str
        Size, and the source of the size.
    known : bool
        True if the shape is defined by the URDF or the cell file, without an assumption.
    """

    name: str
    link: int
    solids: tuple[Solid, ...]
    source: str
    known: bool


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """All bodies of the arm for collision checks; one row per body.

    Attributes
    ----------
    parts : tuple of Part
    solids : tuple of k Solid
        Bodies of all parts, in order.
    part : int array of shape (k,)
        Index in `parts` of each body.
    link : int array of shape (k,)
        Index (from 0) of the link that the body moves with; `BASE` = fixed.
    start_m, end_m : arrays of shape (k, 3)
        Segment of the capsule around each body.
    radius_m : array of shape (k,)
        Radius of that capsule.
    """

    parts: tuple[Part, ...]
    solids: tuple[Solid, ...]
    part: NDArray[np.intp]
    link: NDArray[np.intp]
    start_m: Floats
    end_m: Floats
    radius_m: Floats

    def segments_m(self, frames: Floats) -> Floats:
        """Return the ends (n, k, 2, 3) [m] of the segments in the base frame, from frames (n, N + 1, 4, 4)."""
        of_link = frames[:, self.link + 1]
        ends = np.stack([self.start_m, self.end_m], axis=1)
        return np.matmul(ends, of_link[:, :, :3, :3].transpose(0, 1, 3, 2)) + of_link[:, :, None, :3, 3]

    def levers_m(self, robot: Robot) -> Floats:
        """Return the largest distance (k, N) [m] of a body's points from each joint axis; 0 for later joints.

        A point moves by at most the sum of these levers times the joint rotations. A rotation does not move a ball
        about its centre.
        """
        steps = np.linalg.norm(robot.placement[:, :3, 3], axis=1)
        lever = np.zeros((len(self.link), robot.axes))
        for row, (link, solid) in enumerate(zip(self.link, self.solids, strict=True)):
            if link == BASE:
                continue
            length = float(np.linalg.norm(solid.points_m, axis=1).max())
            for joint in range(link):
                lever[row, joint] = steps[joint + 1 : link + 1].sum() + length
            lever[row, link] = np.linalg.norm(np.cross(robot.axis[link], solid.points_m), axis=1).max()
        return lever


def base_and_link_frames(robot: Robot, q_rad: Floats) -> Floats:
    """Return the frames (n, N + 1, 4, 4) of base and links in the base frame [m], at postures (n, N)."""
    base = np.broadcast_to(np.eye(4), (len(q_rad), 1, 4, 4))
    return np.concatenate([base, link_frames(robot, q_rad)], axis=1)


def body_of_parts(parts: Sequence[Part]) -> Body:
    """Return the collision bodies of the parts as one table."""
    solids = [solid for part in parts for solid in part.solids]
    rows = [row for row, part in enumerate(parts) for _ in part.solids]
    return Body(
        parts=tuple(parts),
        solids=tuple(solids),
        part=np.array(rows, dtype=np.intp),
        link=np.array([parts[row].link for row in rows], dtype=np.intp),
        start_m=np.array([solid.around.start_m for solid in solids]).reshape(-1, 3),
        end_m=np.array([solid.around.end_m for solid in solids]).reshape(-1, 3),
        radius_m=np.array([solid.around.radius_m for solid in solids]),
    )


def moving_parts(arm: ArmConfig, robot: Robot) -> list[Part]:
    """Return the links and the load of a configured arm.

    A link has the collision geometry of the URDF. If that is missing or unreadable, it is a capsule from the link's
    joint to the next one. Its radius is `arm.link_radius_m`, else an assumed one. The capsule of link 2 begins one
    radius from its joint, because the shoulder itself belongs to link 1.
    """
    return [*(_link(arm, robot, link) for link in range(robot.axes)), _load(arm, robot)]


def stated_radius_m(arm: ArmConfig, robot: Robot, link: int) -> tuple[float, str]:
    """Return the radius [m] of a link (from 0) without known shape, and its source."""
    if arm.link_radius_m is None:
        radius = ASSUMED_SHARE * reach_m(robot)
        return radius, f"{radius:.3f} m, assumed: {ASSUMED_SHARE:g} x reach; give arm.link_radius_m"
    radius = arm.link_radius_m[link] if isinstance(arm.link_radius_m, tuple) else arm.link_radius_m
    return radius, f"{radius:g} m, arm.link_radius_m"


def solids_of(shapes: Sequence[LinkShape], source: str) -> tuple[list[Solid], list[str]]:
    """Return the bodies of the readable shapes, and the reasons why others cannot be read."""
    solids: list[Solid] = []
    unusable: list[str] = []
    for shape in shapes:
        try:
            solids.append(solid_of(shape, source))
        except MeshError as error:
            unusable.append(str(error))
    return solids, unusable


def _link(arm: ArmConfig, robot: Robot, link: int) -> Part:
    name = f"link {link + 1}"
    solids, unusable = solids_of(robot.shapes[link], robot.source)
    if any(body.own for body in robot.shapes[link]) and not unusable:
        return Part(name, link, tuple(solids), GEOMETRY, known=True)
    radius, words = stated_radius_m(arm, robot, link)
    words = f"{words} ({'; '.join(unusable)})" if unusable else words
    # from the link's joint to the next one; for the last link to the flange
    start = np.zeros(3)
    end = robot.placement[link + 1, :3, 3] if link + 1 < robot.axes else _flange(robot)[:3, 3]
    length = float(np.linalg.norm(end))
    if link == 1 and length > 0.0:
        start = min(radius / length, 1.0) * end
    return Part(name, link, (*solids, solid_capsule(Capsule(start, end, radius))), words, known=False)


def _flange(robot: Robot) -> Floats:
    return np.eye(4) if robot.flange is None else robot.flange


def _load(arm: ArmConfig, robot: Robot) -> Part:
    """Return the stated box, or a body from the flange to every stated point, else a ball on the flange."""
    last, flange = robot.axes - 1, _flange(robot)
    if arm.load_size_m is not None:
        pose = flange.copy()
        pose[:3, 3] += arm.load_size_m[2] / 2 * flange[:3, 2]
        return Part(LOAD, last, (solid_box(np.array(arm.load_size_m), pose),), "arm.load_size_m", known=True)
    if arm.load_radius_m is not None:
        radius, words = arm.load_radius_m, f"{arm.load_radius_m:g} m, arm.load_radius_m"
    elif arm.load_points_m:
        radius, words = stated_radius_m(arm, robot, last)
        words = f"as link {robot.axes}: {words}; give arm.load_radius_m"
    else:
        radius = stated_radius_m(arm, robot, last)[0]
        words = f"a ball of {2 * radius:.3f} m on the flange, assumed; give arm.load_size_m"
    middle = flange[:3, 3] + (0.0 if robot.flange is None else radius) * flange[:3, 2]
    stars = [Capsule(flange[:3, 3], np.array(point), radius) for point in arm.load_points_m]
    solids = tuple(solid_capsule(capsule) for capsule in stars or [Capsule(middle, middle, radius)])
    return Part(LOAD, last, solids, words, known=arm.load_radius_m is not None)
