"""Two arms over one bar: forward kinematics, and two equal arms of six axes with the reference path.

Standard (distal) Denavit-Hartenberg rows `T = Rz(theta) Tz(d) Tx(a) Rx(alpha)`, implemented separately, so that no
formula is shared with the gateway. All functions take stacks: leading dimensions are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: d, a [m], alpha [rad] per row.
DH_D_M = np.array([0.45, 0.0, 0.0, 0.64, 0.0, 0.10])
DH_A_M = np.array([0.15, 0.60, 0.10, 0.0, 0.0, 0.0])
DH_ALPHA_RAD = np.deg2rad([90.0, 0.0, -90.0, 90.0, -90.0, 0.0])
TOOL_M = 0.15
BASE_DISTANCE_M = 1.9
GRIP_M = 0.20
GRAVITY_M_S2 = 9.80665
DURATION_S = 6.0
#: Joint positions of master and slave near the start of the path, elbow up, tool down.
START_RAD = np.deg2rad([[-25.0, 85.0, -182.0, 0.0, -83.0, -25.0], [25.0, 85.0, -182.0, 0.0, -83.0, 25.0]])


@dataclass(frozen=True, slots=True, eq=False)
class ArmGeometry:
    """One arm (or a stack of arms).

    Attributes
    ----------
    d_m, a_m, alpha_rad, zero_rad : arrays of shape (..., N)
        Rows of the table; the angle of a row is joint position + zero_rad.
    base : array of shape (..., 4, 4), base in the world [m]
    tool : array of shape (..., 4, 4), fingertip in frame N [m]
    """

    d_m: Array
    a_m: Array
    alpha_rad: Array
    zero_rad: Array
    base: Array
    tool: Array


def translation(x: float, y: float, z: float) -> Array:
    """Pose (4, 4) moved by x, y, z [m]."""
    result = np.eye(4)
    result[:3, 3] = x, y, z
    return result


def turn(axis: str, angle_rad: Array | float) -> Array:
    """Pose (..., 4, 4) turned about an axis of the frame, "x", "y" or "z", by an angle [rad]."""
    angle = np.asarray(angle_rad, dtype=float)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    result = np.zeros((*angle.shape, 4, 4))
    result[..., range(4), range(4)] = 1.0
    result[..., first, first] = result[..., second, second] = np.cos(angle)
    result[..., second, first] = np.sin(angle)
    result[..., first, second] = -np.sin(angle)
    return result


def nominal_arm(base: Array) -> ArmGeometry:
    """The reference arm as its data sheet says, on a base (4, 4) in the world [m]."""
    return ArmGeometry(
        DH_D_M.copy(), DH_A_M.copy(), DH_ALPHA_RAD.copy(), np.zeros(6), base, translation(0.0, 0.0, TOOL_M)
    )


def bases() -> tuple[Array, Array]:
    """Bases of the reference arms in the world: 1.9 m apart along x, facing each other."""
    return np.eye(4), translation(BASE_DISTANCE_M, 0.0, 0.0) @ turn("z", np.pi)


def nominal_arms() -> tuple[ArmGeometry, ArmGeometry]:
    """Both reference arms without errors."""
    first, second = bases()
    return nominal_arm(first), nominal_arm(second)


def frames(arm: ArmGeometry, q_rad: Array) -> Array:
    """Frames 1 to N (..., N, 4, 4) in the arm's own base [m]."""
    angle = np.asarray(q_rad, dtype=float) + arm.zero_rad
    c, s = np.cos(angle), np.sin(angle)
    ca, sa = np.cos(arm.alpha_rad), np.sin(arm.alpha_rad)
    rows = np.zeros((*angle.shape, 4, 4))
    rows[..., 0, 0], rows[..., 0, 1], rows[..., 0, 2], rows[..., 0, 3] = c, -s * ca, s * sa, arm.a_m * c
    rows[..., 1, 0], rows[..., 1, 1], rows[..., 1, 2], rows[..., 1, 3] = s, c * ca, -c * sa, arm.a_m * s
    rows[..., 2, 1], rows[..., 2, 2], rows[..., 2, 3] = sa, ca, arm.d_m
    rows[..., 3, 3] = 1.0
    for i in range(1, angle.shape[-1]):
        rows[..., i, :, :] = rows[..., i - 1, :, :] @ rows[..., i, :, :]
    return rows


def tip(arm: ArmGeometry, q_rad: Array) -> Array:
    """Fingertip (..., 4, 4) in the world [m]."""
    return arm.base @ frames(arm, q_rad)[..., -1, :, :] @ arm.tool


def jacobian(arm: ArmGeometry, q_rad: Array) -> Array:
    """Twist (..., 6, N) `[m/s; rad/s]` of the fingertip in world axes per joint speed [rad/s]."""
    own = frames(arm, q_rad)
    world = arm.base[..., None, :, :] @ own
    end = (world[..., -1, :, :] @ arm.tool)[..., :3, 3]
    root = np.broadcast_to(arm.base[..., None, :, :], own[..., :1, :, :].shape)
    before = np.concatenate([root, world[..., :-1, :, :]], axis=-3)
    axis, origin = before[..., :3, 2], before[..., :3, 3]
    linear = np.cross(axis, end[..., None, :] - origin)
    return np.swapaxes(np.concatenate([linear, axis], axis=-1), -1, -2)


def grasps() -> tuple[Array, Array]:
    """Grippers 1 and 2 in the part's frame: from above, 0.2 m to both sides of its centre along x."""
    first = translation(-GRIP_M, 0.0, 0.0) @ turn("y", np.pi)
    second = translation(GRIP_M, 0.0, 0.0) @ turn("x", np.pi)
    return first, second


def quintic(x: Array) -> Array:
    """Rest to rest from 0 to 1, `10 x^3 - 15 x^4 + 6 x^5`."""
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def part_poses(dt_s: float) -> Array:
    """Reference path of the part's centre (M, 4, 4) in the world [m], 6 s at speed setting 1."""
    count = round(DURATION_S / dt_s) + 1
    u = quintic(np.linspace(0.0, 1.0, count))
    poses = (
        turn("z", np.deg2rad(20.0) * np.sin(1.3 * np.pi * u))
        @ turn("y", np.deg2rad(10.0) * np.sin(2.0 * np.pi * u))
        @ turn("x", np.deg2rad(12.0) * np.sin(3.0 * np.pi * u))
    )
    poses[:, 0, 3] = 0.95 + 0.08 * np.sin(2.0 * np.pi * u)
    poses[:, 1, 3] = -0.35 + 0.70 * u
    poses[:, 2, 3] = 0.55 + 0.12 * np.sin(2.0 * np.pi * u + 0.6)
    return poses
