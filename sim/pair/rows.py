"""Denavit-Hartenberg rows of an arm whose joints a robot file describes: by the common normals of its axes.

The errors of a seed are drawn about these rows, so they are those of a data sheet: lengths and angles are rounded as in
a robot file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import ArmSpec
from sim.pair.geometry import ArmGeometry
from sim.urdf import SimBody, moved, rpy_of, translation, turn

Array = NDArray[np.float64]

#: Decimals of a length [m] and of an angle [deg] of a data sheet.
LENGTH_DECIMALS, ANGLE_DECIMALS = 8, 7
#: Axes whose directions differ by less are parallel [rad], and nearer points are one [m].
PARALLEL_RAD, POINT_M = 1e-6, 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ArmRows:
    """An arm in rows.

    Attributes
    ----------
    geometry : ArmGeometry
    bodies : links of the robot file in the frames that turn with the rows; None where the file gives none
    """

    geometry: ArmGeometry
    bodies: tuple[SimBody | None, ...]


def rows_of(arm: ArmSpec) -> ArmRows:
    """The arm of a cell file without errors, where the cell puts it."""
    links = _links(arm)
    start = links[0] @ _onto_z(arm.chain.axis[0])
    before, angles, found = start, [], []
    turning: list[Array] = []
    for i in range(1, len(links)):
        angle, length, height, twist = _row(before, links[i][:3, 3], links[i][:3, :3] @ arm.chain.axis[i])
        turning.append(before @ turn("z", angle))
        before = turning[-1] @ translation(length, 0.0, height) @ turn("x", twist)
        found.append((length, height, twist))
        angles.append(angle)
    turning.append(before)
    end = links[-1] @ arm.fingertip
    flange = (links[-1] @ arm.flange)[:3, 3]
    last_m = _length(float((flange - before[:3, 3]) @ before[:3, 2]))
    lengths, heights, twists = np.array([*found, (0.0, last_m, 0.0)]).T
    geometry = ArmGeometry(
        d_m=heights,
        a_m=lengths,
        alpha_rad=twists,
        zero_rad=np.array([*angles, 0.0]),
        base=_stated(arm.base) @ _stated(start),
        tool=_stated(np.linalg.inv(before @ translation(0.0, 0.0, last_m)) @ end),
    )
    placed = (_stated(np.linalg.inv(frame) @ link) for frame, link in zip(turning, links, strict=True))
    return ArmRows(geometry, tuple(moved(body, frame) for body, frame in zip(arm.chain.bodies, placed, strict=True)))


def _links(arm: ArmSpec) -> list[Array]:
    """Frames (4, 4) of the robot file's links in the arm's base, all joints at 0."""
    frame, links = np.eye(4), []
    for placed in arm.chain.placement:
        frame = frame @ placed
        links.append(frame)
    return links


def _row(before: Array, point_m: Array, axis: Array) -> tuple[float, float, float, float]:
    """Angle [rad], length [m], height [m] and twist [rad] from a frame (4, 4) to the axis of the next joint.

    The frame is on its own joint's axis; the next axis goes through a point (3,) [m] in a direction (3,).
    """
    own, x_before, origin = before[:3, 2], before[:3, 0], before[:3, 3]
    across = np.cross(own, axis)
    sine = float(np.linalg.norm(across))
    away = point_m - origin
    if sine < PARALLEL_RAD:
        side = away - (away @ own) * own
        length, height = float(np.linalg.norm(side)), 0.0
        normal = side / length if length > POINT_M else x_before
        length = length if length > POINT_M else 0.0
    else:
        normal = across / sine
        length = float(away @ normal)
        height = float(np.cross(away, axis) @ normal) / sine
        if length < -POINT_M or (abs(length) <= POINT_M and normal @ x_before < 0.0):
            normal, length = -normal, -length
    angle = np.arctan2(np.cross(x_before, normal) @ own, x_before @ normal)
    twist = np.arctan2(np.cross(own, axis) @ normal, own @ axis)
    return _angle(float(angle)), _length(length), _length(height), _angle(float(twist))


def _onto_z(axis: Array) -> Array:
    """Turn (4, 4) of a frame that puts its z along an axis (3,) of it."""
    tilt, around = np.arctan2(np.hypot(axis[0], axis[1]), axis[2]), np.arctan2(axis[1], axis[0])
    return turn("z", around) @ turn("y", tilt) if tilt > 0.0 else np.eye(4)


def _length(value_m: float) -> float:
    return round(value_m, LENGTH_DECIMALS) + 0.0


def _angle(value_rad: float) -> float:
    degrees = round(float(np.rad2deg(value_rad)), ANGLE_DECIMALS) + 0.0
    return float(np.deg2rad(180.0 if degrees == -180.0 else degrees))


def _stated(pose: Array) -> Array:
    """A pose (4, 4) with lengths and angles as a data sheet states them."""
    roll, pitch, yaw = (_angle(angle) for angle in rpy_of(pose[:3, :3]))
    return translation(*(_length(value) for value in pose[:3, 3])) @ turn("z", yaw) @ turn("y", pitch) @ turn("x", roll)
