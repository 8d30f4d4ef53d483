"""Poses as 4 x 4 matrices, rotations as axis and angle, and the one rule by which a correction enters a pose.

A correction is a 6-vector `[dP (3) m; log dR (3) rad]` in the axes of the frame that the pose is given in:
`P'' = P + dP`, `R'' = dR R` (CN104379308 eqs. (21) to (26)). It is not a product of poses, which would turn P about the
frame's origin as well. All functions take stacks: leading dimensions are kept.

The relation between two grippers, and the slave's command that follows from it, are eqs. (3) and (4).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
SMALL_RAD = 1e-6
NEARLY_HALF_TURN_RAD = 1e-3


def cross_matrix(vector: ArrayLike) -> Floats:
    """Matrix (..., 3, 3) of the cross product with `vector` (..., 3) from the left."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    matrix = np.zeros((*x.shape, 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def exp_rotation(vector_rad: ArrayLike) -> Floats:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    vector = np.asarray(vector_rad, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    small = angle < SMALL_RAD
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    second = np.where(small, 0.5 - angle**2 / 24.0, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    cross = cross_matrix(vector)
    return np.eye(3) + first * cross + second * (cross @ cross)


def log_rotation(rotation: ArrayLike) -> Floats:
    """Rotation vectors (..., 3) [rad] of rotations (..., 3, 3), angle from 0 to pi."""
    matrix = np.asarray(rotation, dtype=float)
    vector = 0.5 * np.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(vector, axis=-1)
    cosine = 0.5 * (np.trace(matrix, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < SMALL_RAD
    scale = np.where(small, 1.0 + sine**2 / 6.0, angle / np.where(small, 1.0, sine))
    logarithm = vector * scale[..., None]
    turned = angle > math.pi - NEARLY_HALF_TURN_RAD
    if np.any(turned):
        logarithm = np.where(turned[..., None], _log_near_half_turn(matrix, vector, angle), logarithm)
    return logarithm


def _log_near_half_turn(matrix: Floats, vector: Floats, angle: Floats) -> Floats:
    """Axis from the symmetric part, sign from the skew one, where the skew part vanishes."""
    versine = 1.0 - np.cos(angle)[..., None, None]
    symmetric = 0.5 * (matrix + np.swapaxes(matrix, -1, -2)) - np.eye(3)
    outer = symmetric / np.where(np.abs(versine) < 1e-12, 1.0, versine) + np.eye(3)
    column = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, column[..., None, None], axis=-1)[..., 0]
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-300)
    sign = np.where(np.sum(axis * vector, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return sign * axis * angle[..., None]


def pose(rotation: ArrayLike, position_m: ArrayLike) -> Floats:
    """Pose (..., 4, 4) of a rotation (..., 3, 3) and a position (..., 3) [m]."""
    turn, place = np.asarray(rotation, dtype=float), np.asarray(position_m, dtype=float)
    result = np.zeros((*np.broadcast_shapes(turn.shape[:-2], place.shape[:-1]), 4, 4))
    result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = turn, place, 1.0
    return result


def inverse(transform: ArrayLike) -> Floats:
    """Inverse (..., 4, 4) of poses, by the transposed rotation."""
    stated = np.asarray(transform, dtype=float)
    result = np.zeros_like(stated)
    turned = np.swapaxes(stated[..., :3, :3], -1, -2)
    result[..., :3, :3] = turned
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", turned, stated[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result


def apply_correction(transform: ArrayLike, correction: ArrayLike) -> Floats:
    """Poses (..., 4, 4) with corrections (..., 6) [m, rad] added: `P + dP`, `dR R`."""
    stated, change = np.asarray(transform, dtype=float), np.asarray(correction, dtype=float)
    return pose(exp_rotation(change[..., 3:]) @ stated[..., :3, :3], stated[..., :3, 3] + change[..., :3])


def corrected_pose(transform: Floats, correction: Floats) -> Floats:
    """`apply_correction` for one pose (4, 4) and one correction (6,): the scalar path that runs each SYNC."""
    dx, dy, dz, x, y, z = correction.tolist()
    square = x * x + y * y + z * z
    if square < SMALL_RAD**2:
        first, second = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        first, half = math.sin(angle) / angle, math.sin(0.5 * angle) / angle
        second = 2.0 * half * half
    change = np.array(
        [
            [1.0 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y],
            [second * x * y + first * z, 1.0 - second * (x * x + z * z), second * y * z - first * x],
            [second * x * z - first * y, second * y * z + first * x, 1.0 - second * (x * x + y * y)],
        ]
    )
    result = transform.copy()
    result[:3, :3] = change @ transform[:3, :3]
    result[0, 3] += dx
    result[1, 3] += dy
    result[2, 3] += dz
    return result


def correction_between(corrected: ArrayLike, transform: ArrayLike) -> Floats:
    """Correction (..., 6) [m, rad] that turns `transform` into `corrected` (CN104379308 eqs. (21), (22))."""
    after, before = np.asarray(corrected, dtype=float), np.asarray(transform, dtype=float)
    turn = after[..., :3, :3] @ np.swapaxes(before[..., :3, :3], -1, -2)
    return np.concatenate([after[..., :3, 3] - before[..., :3, 3], log_rotation(turn)], axis=-1)


def relation(w_t_b1: ArrayLike, b1_t_e1: ArrayLike, w_t_b2: ArrayLike, b2_t_e2: ArrayLike) -> Floats:
    """Pose of gripper 2 in gripper 1, eq. (3).

    Parameters
    ----------
    w_t_b1, w_t_b2 : arrays of shape (4, 4)
        Bases of master and slave in the world [m].
    b1_t_e1, b2_t_e2 : arrays of shape (..., 4, 4)
        Gripper poses in their own bases [m].

    Returns
    -------
    array of shape (..., 4, 4)
        `E1_T_E2 = inv(W_T_B1 B1_T_E1) W_T_B2 B2_T_E2`.
    """
    return inverse(np.asarray(w_t_b1) @ np.asarray(b1_t_e1)) @ (np.asarray(w_t_b2) @ np.asarray(b2_t_e2))


def slave_command(w_t_b1: ArrayLike, b1_t_e1: ArrayLike, w_t_b2: ArrayLike, e1_t_e2: ArrayLike) -> Floats:
    """Command of gripper 2 in its base, eq. (4): `B2_T_E2 = inv(W_T_B2) W_T_B1 B1_T_E1 E1_T_E2`; shapes (..., 4, 4)."""
    return (inverse(w_t_b2) @ np.asarray(w_t_b1)) @ np.asarray(b1_t_e1) @ np.asarray(e1_t_e2)
