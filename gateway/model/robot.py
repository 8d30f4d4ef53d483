"""Robot model: a serial arm of one to eight revolute axes as arrays, from a URDF or Denavit-Hartenberg parameters.

Link `i` turns with joint `i`. The origin of its frame is on the axis of that joint (the URDF convention). Its pose in
the frame of the previous link is `placement[i] @ rotation(axis[i], q[i])`; for `i = 0` in the root link. Unknown
quantities are NaN: a link without inertial is unknown, not massless.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.errors import ConfigError
from gateway.model import urdf
from gateway.model.urdf_shapes import Pose, Shape

Floats = NDArray[np.float64]
SHORTEST_M = 0.1
#: Largest plausible length of an arm [m], and length from which the unit must be millimetres.
LONGEST_M, MILLIMETRES_FROM_M = 20.0, 600.0
#: Largest plausible mass of the moving links [kg]: the heaviest arms have 8 t at a payload of 2.3 t.
HEAVIEST_KG = 20_000.0
#: Mass of the moving links over the cube of the reach: the densest arms have 200; one of 4 kg in grams has 20 000.
#: A reach below half a metre counts as that, and turntables of few axes, whose reach is none, are left alone.
DENSEST_KG_M3, SMALLEST_REACH_M, MOST_AXES_OF_TABLES = 4000.0, 0.5, 4


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """Collision shape of a link.

    Attributes
    ----------
    pose : array of shape (4, 4)
        Frame of the shape [m] in the link.
    shape : Shape
    own : bool
        True if the shape belongs to the link itself, not to a body fixed to it.
    """

    pose: Floats
    shape: Shape
    own: bool


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Geometry, inertials and limits of an arm of N axes.

    Attributes
    ----------
    name : str
    placement : array of shape (N, 4, 4)
        Pose [m] of link i in link i-1 (root link for the first) at q = 0.
    axis : array of shape (N, 3)
        Unit axis of joint i in link i.
    mass_kg : array of shape (N,)
    com_m : array of shape (N, 3)
        Centre of mass in the link's frame.
    inertia_kg_m2 : array of shape (N, 3, 3)
        About the centre of mass, axes of the link's frame.
    lower_rad, upper_rad : arrays of shape (N,)
        Joint limits, -inf and inf if not defined.
    velocity_rad_s, effort_nm : arrays of shape (N,)
        Joint limits, NaN if not defined (0 counts as not defined).
    flange : array of shape (4, 4) or None
        Pose [m] of the flange in the last link.
    link_names, joint_names : tuples of N str
    shapes : tuple of N tuples of LinkShape
        Collision shapes of each link; empty if not defined.
    base_shapes : tuple of LinkShape
        Collision shapes of the fixed base below joint 1, in the base frame.
    source : str
        File of the robot model; mesh paths are relative to it.
    frames : tuple of (str, array of shape (4, 4))
        Links fixed to the last link, and their poses [m] in it.
    remarks : tuple of str
        Remarks on content of the source that is not used as written.
    """

    name: str
    placement: Floats
    axis: Floats
    mass_kg: Floats
    com_m: Floats
    inertia_kg_m2: Floats
    lower_rad: Floats
    upper_rad: Floats
    velocity_rad_s: Floats
    effort_nm: Floats
    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    shapes: tuple[tuple[LinkShape, ...], ...]
    base_shapes: tuple[LinkShape, ...] = ()
    flange: Floats | None = None
    source: str = ""
    frames: tuple[tuple[str, Floats], ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def axes(self) -> int:
        """Number of axes of the arm."""
        return len(self.axis)

    @property
    def last_link(self) -> str:
        """Name of the frame in which a load is stated: `link_6` for an arm with six axes."""
        return frame_of_load(self.axes)


class DhRows(Protocol):
    """Table of Denavit-Hartenberg parameters; theta = q + theta_offset."""

    @property
    def convention(self) -> str: ...
    @property
    def alpha_rad(self) -> Sequence[float]: ...
    @property
    def a_m(self) -> Sequence[float]: ...
    @property
    def d_m(self) -> Sequence[float]: ...
    @property
    def theta_offset_rad(self) -> Sequence[float]: ...


def frame_of_load(axes: int) -> str:
    """Return the name of the last link's frame of an arm with `axes` axes."""
    return f"link_{axes}"


def transform(rotation: Floats, translation: Floats | Sequence[float]) -> Floats:
    """Return the 4 x 4 pose of a (3, 3) rotation and a translation [m] of shape (3,)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = translation
    return pose


def rotation_rpy(rpy_rad: Sequence[float] | Floats) -> Floats:
    """Return the rotation (3, 3) of fixed-axis roll, pitch, yaw [rad]: Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def with_flange(robot: Robot, xyz_m: Sequence[float], rpy_rad: Sequence[float] = (0.0, 0.0, 0.0)) -> Robot:
    """Return a copy of the arm with its flange at `xyz_m`, `rpy_rad` of the last link."""
    return replace(robot, flange=transform(rotation_rpy(rpy_rad), xyz_m))


def reach_m(robot: Robot) -> float:
    """Return the length of an arm [m]: sum of the distances from joint to joint; at least that of its last link."""
    return max(float(np.linalg.norm(robot.placement[1:, :3, 3], axis=1).sum()), float(link_lengths_m(robot)[-1]))


def link_lengths_m(robot: Robot) -> Floats:
    """Return the length (N,) [m] of every link, the scale of errors of its first moment.

    Distance to the next joint or to the centre of mass, whichever is larger. The last link reaches to the flange, and
    is at least as long as the step before it, because a load is not smaller than the wrist. At least 0.1 m.
    """
    steps = np.linalg.norm(robot.placement[:, :3, 3], axis=1)
    last = 0.0 if robot.flange is None else float(np.linalg.norm(robot.flange[:3, 3]))
    onward = np.append(steps[1:], max(last, float(steps[-1])))
    return np.maximum(np.maximum(onward, np.nan_to_num(np.linalg.norm(robot.com_m, axis=1))), SHORTEST_M)


def robot_from_urdf(text: str, where: str, tip: str | None = None) -> Robot:
    """Read an arm from URDF text.

    Fixed joints are merged: bodies on them belong to the link before. A fixed link without inertial is a mere frame; a
    moved link without inertial is unknown. Other movable joints that are not part of the arm are fixed at zero, with a
    remark.

    Parameters
    ----------
    text : str
    where : str
        Name of the file, for messages.
    tip : str, optional
        Last link of the arm, if the file leaves it ambiguous.

    Raises
    ------
    ConfigError
        Not XML, entity declarations, not one to eight driven joints in one chain, or a value that is missing or not
        finite; the message names file and element.
    """
    chain = urdf.read_chain(text, where, tip)
    count = len(chain.joints)
    if not FEWEST_AXES <= count <= MOST_AXES:
        advice = (
            urdf.name_the_tip(chain.joints[MOST_AXES - 1].child) if count > MOST_AXES else "name the URDF of the arm"
        )
        raise ConfigError(
            f"{where}: robot '{chain.name}' has {count} moving joints in its chain, {FEWEST_AXES} to {MOST_AXES}"
            f" revolute ones are needed; {advice}"
        )
    placement = np.array([transform(rotation_rpy(joint.rpy_rad), joint.xyz_m) for joint in chain.joints])
    for i, joint in enumerate(chain.joints):
        for pose in reversed(joint.fixed_before):
            placement[i] = transform(rotation_rpy(pose.rpy_rad), pose.xyz_m) @ placement[i]
    inertials = [_merged(link) for link in chain.links]
    robot = Robot(
        name=chain.name,
        placement=placement,
        axis=np.array([joint.axis for joint in chain.joints]),
        mass_kg=np.array([inertial[0] for inertial in inertials]),
        com_m=np.array([inertial[1] for inertial in inertials]),
        inertia_kg_m2=np.array([inertial[2] for inertial in inertials]),
        lower_rad=np.array([joint.lower_rad for joint in chain.joints]),
        upper_rad=np.array([joint.upper_rad for joint in chain.joints]),
        velocity_rad_s=np.array([joint.velocity_rad_s for joint in chain.joints]),
        effort_nm=np.array([joint.effort_nm for joint in chain.joints]),
        link_names=tuple(link.name for link in chain.links),
        joint_names=tuple(joint.name for joint in chain.joints),
        shapes=tuple(_shapes(link) for link in chain.links),
        base_shapes=tuple(LinkShape(_chained(placed.poses), placed.shape, True) for placed in chain.base_shapes),
        source=where,
        frames=tuple((frame.name, _chained(frame.poses)) for frame in chain.frames),
        remarks=tuple(_remarks(chain, where)),
    )
    # Refuse lengths and masses that no arm has: a URDF is in metres and kilograms
    from_joints_m = np.linalg.norm(np.nan_to_num(robot.com_m), axis=1).max()
    for what, length_m in (("from joint to joint", reach_m(robot)), ("to a centre of mass", float(from_joints_m))):
        if length_m > LONGEST_M:
            unit = "millimetres" if length_m > MILLIMETRES_FROM_M else "centimetres or millimetres"
            raise ConfigError(
                f"{where}: robot '{robot.name}' measures {length_m:.4g} m {what}, beyond {LONGEST_M:g} m: its lengths"
                f" are in {unit}; export it in metres (lengths, centres of mass, and inertia in kg m2)"
            )
    mass_kg, volume_m3 = float(np.nansum(robot.mass_kg)), max(reach_m(robot), SMALLEST_REACH_M) ** 3
    if mass_kg > HEAVIEST_KG or (robot.axes > MOST_AXES_OF_TABLES and mass_kg > DENSEST_KG_M3 * volume_m3):
        raise ConfigError(
            f"{where}: the moving links of robot '{robot.name}' weigh {mass_kg:.4g} kg at a reach of"
            f" {reach_m(robot):.3g} m: its masses are in grams; export it in kilograms (and inertia in kg m2)"
        )
    return robot


def or_another_tip(robot: Robot, axes: int) -> str:
    """Return the hint to name another last link, if a URDF has more axes than the arm; else an empty text."""
    if axes >= robot.axes or not robot.source:
        return ""
    more = ", ".join(robot.joint_names[axes:])
    return f"; where {more} is not an axis of the arm, {urdf.name_the_tip(robot.link_names[axes - 1])}"


def _remarks(chain: urdf.Chain, where: str) -> Iterator[str]:
    """Return remarks on content of the file that is not used as written."""
    if chain.fixed_at_zero:
        yield f"{where}: joints taken as fixed at zero: {', '.join(chain.fixed_at_zero)}"
    if chain.unused_shapes:
        yield f"{where}: collision geometry left out: {', '.join(chain.unused_shapes)}"


def robot_from_dh(table: DhRows, name: str = "dh") -> Robot:
    """Return an arm from Denavit-Hartenberg parameters; links are unknown, limits open.

    Modified (Craig): `Rx(alpha_i) Tx(a_i) Rz(theta_i) Tz(d_i)`, link frame = DH frame.
    Standard (Paul): `Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)`; frames of all links but the last are on their
    own joint's axis, the last is its DH frame.

    Raises
    ------
    ConfigError
        Unknown convention, not one to eight rows, columns of different length, or a value that is not finite. Also a
        standard table whose last a is not 0: that frame would not be on its axis (give the length in the flange).
    """
    columns = [
        np.asarray(column, dtype=float) for column in (table.alpha_rad, table.a_m, table.d_m, table.theta_offset_rad)
    ]
    axes = len(table.alpha_rad)
    if any(column.shape != (axes,) or not np.isfinite(column).all() for column in columns):
        raise ConfigError(
            f"DH table of '{name}': alpha_rad, a_m, d_m and theta_offset_rad need one finite number per axis"
        )
    if not FEWEST_AXES <= axes <= MOST_AXES:
        raise ConfigError(f"DH table of '{name}' has {axes} rows; {FEWEST_AXES} to {MOST_AXES} axes are supported")
    alpha, a, d, offset = columns
    axis = np.tile([0.0, 0.0, 1.0], (axes, 1))
    if table.convention == "modified":
        placement = np.array(
            [_rx(alpha[i]) @ _move(a[i], 0.0) @ _move(0.0, d[i]) @ _rz(offset[i]) for i in range(axes)]
        )
    elif table.convention == "standard":
        if a[-1] != 0.0:
            raise ConfigError(
                f"DH table of '{name}': a_m of row {axes} must be 0 in the standard convention; put it in the flange"
            )
        placement = np.empty((axes, 4, 4))
        placement[0] = np.eye(4)
        for i in range(axes - 1):
            placement[i + 1] = _rz(offset[i]) @ _move(a[i], d[i]) @ _rx(alpha[i])
        placement[-1] = placement[-1] @ _rz(offset[-1]) @ _move(0.0, d[-1]) @ _rx(alpha[-1])
        axis[-1] = _rx(-alpha[-1])[:3, :3] @ axis[-1]
    else:
        raise ConfigError(f"DH table of '{name}': convention '{table.convention}' must be 'modified' or 'standard'")
    unknown, open_ = np.full(axes, np.nan), np.full(axes, np.inf)
    return Robot(
        name=name,
        placement=placement,
        axis=axis,
        mass_kg=unknown,
        com_m=np.full((axes, 3), np.nan),
        inertia_kg_m2=np.full((axes, 3, 3), np.nan),
        lower_rad=-open_,
        upper_rad=open_,
        velocity_rad_s=unknown,
        effort_nm=unknown,
        link_names=tuple(f"link_{i + 1}" for i in range(axes)),
        joint_names=tuple(f"joint_{i + 1}" for i in range(axes)),
        shapes=((),) * axes,
    )


def _rx(angle: float) -> Floats:
    return transform(rotation_rpy((angle, 0.0, 0.0)), (0.0, 0.0, 0.0))


def _rz(angle: float) -> Floats:
    return transform(rotation_rpy((0.0, 0.0, angle)), (0.0, 0.0, 0.0))


def _move(x: float, z: float) -> Floats:
    return transform(np.eye(3), (x, 0.0, z))


def _chained(poses: Sequence[Pose]) -> Floats:
    """Return the pose (4, 4) at the end of a chain of poses."""
    frame = np.eye(4)
    for pose in poses:
        frame = frame @ transform(rotation_rpy(pose.rpy_rad), pose.xyz_m)
    return frame


def _shapes(link: urdf.MovedLink) -> tuple[LinkShape, ...]:
    own = [LinkShape(_chained(placed.poses), placed.shape, True) for placed in link.own_shapes]
    return (*own, *(LinkShape(_chained(placed.poses), placed.shape, False) for placed in link.fixed_shapes))


def _merged(link: urdf.MovedLink) -> tuple[float, Floats, Floats]:
    """Return mass [kg], centre of mass [m] and inertia about it [kg m2] of a link with all bodies fixed to it."""
    if link.own is None:
        return np.nan, np.full(3, np.nan), np.full((3, 3), np.nan)
    parts = []
    for poses, inertial in [((), link.own), *link.fixed]:
        frame = _chained((*poses, inertial.pose))
        xx, xy, xz, yy, yz, zz = inertial.inertia_kg_m2
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        parts.append((inertial.mass_kg, frame[:3, 3], frame[:3, :3] @ tensor @ frame[:3, :3].T))
    mass = sum(part[0] for part in parts)
    com = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass if mass > 0 else parts[0][1]
    tensor = np.zeros((3, 3))
    for part_mass, part_com, part_tensor in parts:
        arm = part_com - com
        tensor += part_tensor + part_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, com, tensor
