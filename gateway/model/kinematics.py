"""Forward kinematics: frames of links and axes, vectorised over joint positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.model.robot import Robot

Floats = NDArray[np.float64]
STANDARD_GRAVITY_M_S2 = (0.0, 0.0, -9.80665)
#: Tolerance of axis directions and positions: larger than corrections by kinematic calibration, smaller than between
#: arms.
SAME_AXIS_M, SAME_AXIS_RAD = 3e-3, 5e-3


def cross_matrix(vector: Floats) -> Floats:
    """Return the matrix (3, 3) of the cross product `vector x`."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def sine_cosine(angle_rad: Floats, sine: Floats, cosine: Floats) -> None:
    """Compute sine and cosine of `angle_rad` into two arrays of its shape, to full precision.

    Uses the tangent of the half angle: one function call instead of two that take seven times as long.
    """
    half = np.tan(0.5 * angle_rad)
    np.multiply(half, half, out=cosine)
    cosine += 1.0
    np.divide(2.0, cosine, out=cosine)
    np.multiply(half, cosine, out=sine)
    cosine -= 1.0


def link_frames(robot: Robot, q_rad: Floats) -> Floats:
    """Return the pose of every link in the base frame.

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (n, N)

    Returns
    -------
    array of shape (n, N, 4, 4)
        Base -> link i, translations in m.
    """
    q_rad = np.asarray(q_rad, dtype=float)
    sine, versine = np.sin(q_rad), 1.0 - np.cos(q_rad)
    frames = np.zeros((len(q_rad), robot.axes, 4, 4))
    frames[:, :, 3, 3] = 1.0
    rotation, origin = np.eye(3)[None], np.zeros((1, 3))
    for i in range(robot.axes):
        fixed, step = robot.placement[i, :3, :3], robot.placement[i, :3, 3]
        cross = cross_matrix(robot.axis[i])
        turned = fixed + sine[:, i, None, None] * (fixed @ cross) + versine[:, i, None, None] * (fixed @ cross @ cross)
        origin = origin + rotation @ step
        rotation = rotation @ turned
        frames[:, i, :3, :3], frames[:, i, :3, 3] = rotation, origin
    return frames


def flange_frames(robot: Robot, q_rad: Floats) -> Floats:
    """Return the pose (n, 4, 4) of the flange in the base frame [m]; of the last link if the flange is not known."""
    last = link_frames(robot, q_rad)[:, -1]
    return last if robot.flange is None else last @ robot.flange


def joint_axes_origins(robot: Robot, q_rad: Floats) -> tuple[Floats, Floats]:
    """Return the unit direction (n, N, 3) of every joint axis and a point (n, N, 3) on it [m], in the base frame."""
    frames = link_frames(robot, q_rad)
    return np.einsum("nijk,ik->nij", frames[:, :, :3, :3], robot.axis), frames[:, :, :3, 3]


def kinematic_difference(first: Robot, second: Robot) -> str:
    """Return a text with the difference of the joint axes of two robots at q = 0; empty if they are equal.

    Lines are compared, not frames, for any base frame: a URDF and Denavit-Hartenberg parameters may describe the same
    arm.
    """
    if first.axes != second.axes:
        return f"one has {first.axes} axes, the other {second.axes}"
    zero = np.zeros((1, first.axes))
    (axes, points), (other_axes, other_points) = (joint_axes_origins(robot, zero) for robot in (first, second))
    turned = np.linalg.norm(np.cross(axes[0], other_axes[0]), axis=1)
    turned = np.where(
        np.einsum("ij,ij->i", axes[0], other_axes[0]) < 0, np.pi - np.arcsin(np.minimum(turned, 1)), turned
    )
    across = np.eye(3) - axes[0][:, :, None] * axes[0][:, None, :]
    apart = np.einsum("ijk,ik->ij", across, other_points[0] - points[0])
    shift = np.linalg.lstsq(across.reshape(-1, 3), apart.ravel(), rcond=None)[0]
    apart_m = np.linalg.norm(apart - across @ shift, axis=1)
    for joint in range(first.axes):
        if turned[joint] > SAME_AXIS_RAD:
            return f"the directions of axis {joint + 1} differ by {np.degrees(turned[joint]):.1f} degrees"
        if apart_m[joint] > SAME_AXIS_M:
            return f"the positions of axis {joint + 1} differ by {1e3 * apart_m[joint]:.0f} mm"
    return ""


def gravity_in_last_link(
    robot: Robot, q_rad: Floats, gravity_m_s2: tuple[float, float, float] | Floats = STANDARD_GRAVITY_M_S2
) -> Floats:
    """Return the unit direction (n, 3) of gravity in the frame of the last link."""
    direction = np.asarray(gravity_m_s2, dtype=float)
    rotation = link_frames(robot, q_rad)[:, -1, :3, :3]
    return np.einsum("nji,j->ni", rotation, direction / np.linalg.norm(direction))


def largest_angle_rad(directions: Floats) -> float:
    """Return the largest angle [rad] between any two of the unit vectors (n, 3); 0 for a single one."""
    products = np.clip(directions @ directions.T, -1.0, 1.0)
    return float(np.arccos(products.min()))
