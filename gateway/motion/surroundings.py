"""Surroundings of an arm: floor, wall, column and boxes, from the cell file or assumed where it does not define
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.model.kinematics import link_frames
from gateway.model.robot import LinkShape, Robot, reach_m, transform
from gateway.model.solid import solid_of
from gateway.model.urdf_shapes import Cylinder
from gateway.motion.body import BASE, GEOMETRY, Part, solids_of, stated_radius_m

Floats = NDArray[np.float64]

#: A base tilted by more than this from upright is mounted on a wall or a ceiling [rad].
WALL_ANGLE_RAD = np.pi / 4
#: A base tilted by more than this counts as inverted [rad]: a floor at the height of the base would block the arm.
INVERTED_MOUNT_ANGLE_RAD = np.radians(100.0)
#: Clearance below the shoulder's axis, in radii of a link, where floor, wall or column are assumed: a link of the
#: assumed thickness may then be horizontal, and 30 degrees lower.
SHOULDER_CLEARANCE = 2.0
#: A shoulder offset from the base's origin below this share of the reach does not determine the direction of the arm.
LEAST_SHARE = 0.01
#: Assumed radius of a column, as a share of the reach: bases of the 10 kg class (reach 1.3 m) are 0.25 to 0.35 m wide,
#: those of the 165 kg class (2.7 m) 0.5 to 0.9 m.
COLUMN_SHARE = 0.1
#: Number of angles of joint 1 at which the shoulder's height is computed.
_TURNS = 72


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Unbounded plane; the arm stays where `normal . x` is above `height_m`.

    Attributes
    ----------
    name : str
        "floor" or "wall".
    normal : array of shape (3,)
        Unit normal vector in the base frame, pointing to the free side.
    height_m : float
    source : str
        Position, and the source of the position.
    """

    name: str
    normal: Floats
    height_m: float
    source: str


def surroundings_of(arm: ArmConfig, robot: Robot) -> tuple[tuple[Plane, ...], Floats, tuple[Part, ...]]:
    """Return planes, boxes (b, 2, 3) [m] by lower and upper corner, and the own base and column of a configured arm."""
    planes = tuple(_planes(arm, robot))
    floor = next((plane.height_m for plane in planes if plane.name == "floor"), None)
    boxes_m = np.array([(box.min_m, box.max_m) for box in arm.keep_out]).reshape(-1, 2, 3)
    return planes, boxes_m, tuple(_fixed_parts(arm, robot, floor))


def upward(arm: ArmConfig, robot: Robot) -> Floats:
    """Return the unit vector (3,) against gravity in the base frame; along axis 1 without gravity."""
    gravity = np.array(arm.gravity_m_s2)
    size = float(np.linalg.norm(gravity))
    return -gravity / size if size > 0.0 else outward(robot)


def outward(robot: Robot) -> Floats:
    """Return the unit vector (3,) along axis 1, from the base to the arm."""
    axis = robot.placement[0, :3, :3] @ robot.axis[0]
    heights = link_frames(robot, np.zeros((1, robot.axes)))[0, _shoulder(robot) :, :3, 3] @ axis
    determining = heights[0] if abs(heights[0]) > LEAST_SHARE * reach_m(robot) else heights[np.argmax(np.abs(heights))]
    return -axis if determining < 0.0 else axis


def _shoulder(robot: Robot) -> int:
    """Return the index of joint 2; of joint 1 where that is the only one."""
    return min(1, robot.axes - 1)


def _lean_rad(arm: ArmConfig, robot: Robot) -> float:
    return float(np.arccos(np.clip(upward(arm, robot) @ outward(robot), -1.0, 1.0)))


def _shoulder_m(robot: Robot, direction: Floats) -> float:
    """Return the largest height [m] of the shoulder along a direction, over all angles of joint 1."""
    q_rad = np.zeros((_TURNS, robot.axes))
    q_rad[:, 0] = np.linspace(-np.pi, np.pi, _TURNS)
    return float((link_frames(robot, q_rad)[:, _shoulder(robot), :3, 3] @ direction).max())


def _assumed_height_m(arm: ArmConfig, robot: Robot, direction: Floats) -> float:
    """Return 0 (the origin of the base), or a lower height if the shoulder needs clearance."""
    clearance = SHOULDER_CLEARANCE * stated_radius_m(arm, robot, 1)[0]
    return min(0.0, _shoulder_m(robot, direction) - clearance)


def _planes(arm: ArmConfig, robot: Robot) -> Iterator[Plane]:
    up, out, lean = upward(arm, robot), outward(robot), _lean_rad(arm, robot)
    if arm.floor_m is None and lean > INVERTED_MOUNT_ANGLE_RAD:
        height = -reach_m(robot)
        yield Plane("floor", up, height, f"{height:.3f} m, assumed: one reach below an inverted base; give arm.floor_m")
    elif arm.floor_m is None:
        height = _assumed_height_m(arm, robot, up)
        yield Plane("floor", up, height, f"{height:.3f} m, assumed; give arm.floor_m, or false where there is none")
    elif not isinstance(arm.floor_m, bool):
        yield Plane("floor", up, arm.floor_m, f"{arm.floor_m:g} m, arm.floor_m")
    if arm.wall or (arm.wall is None and lean > WALL_ANGLE_RAD):
        words = "arm.wall" if arm.wall else "assumed, because the base is tilted; give arm.wall"
        yield Plane("wall", out, _assumed_height_m(arm, robot, out), words)


def _fixed_parts(arm: ArmConfig, robot: Robot, floor_m: float | None) -> Iterator[Part]:
    """Return the geometry of the base and of the column that carries the arm."""
    solids, unusable = solids_of(robot.base_shapes, robot.source)
    if solids:
        yield Part("base", BASE, tuple(solids), GEOMETRY, known=not unusable)
    if arm.column_radius_m is False:
        return
    out = outward(robot)
    lean = _lean_rad(arm, robot)
    bottom = 0.0 if floor_m is None or lean > WALL_ANGLE_RAD else min(0.0, floor_m / np.cos(lean))
    if arm.column_radius_m is None:
        radius = COLUMN_SHARE * reach_m(robot)
        words = f"radius {radius:.3f} m, assumed; give arm.column_radius_m, or false where there is none"
    else:
        radius, words = float(arm.column_radius_m), f"radius {arm.column_radius_m:g} m, arm.column_radius_m"
    shoulder = _shoulder_m(robot, out) - SHOULDER_CLEARANCE * stated_radius_m(arm, robot, 1)[0]
    top = min(0.0, shoulder) if solids and arm.column_radius_m is None else shoulder
    if top - bottom > 1e-3:
        # a cylinder about the first axis through the origin of the base
        across: Floats = np.linalg.svd(out[None])[2][1]
        turned: Floats = np.column_stack([across, np.cross(out, across), out])
        shape = LinkShape(transform(turned, (bottom + top) / 2 * out), Cylinder(radius, top - bottom), True)
        yield Part("column", BASE, (solid_of(shape, ""),), words, known=arm.column_radius_m is not None)
