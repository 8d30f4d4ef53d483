"""Forward kinematics of arms by the rows of a table.

Standard (distal) Denavit-Hartenberg rows `T = Rz(theta) Tz(d) Tx(a) Rx(alpha)`, implemented separately, so that no
formula is shared with the gateway. All functions take stacks: leading dimensions are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
