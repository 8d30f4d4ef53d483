"""Inertia of a load: six moments about the centre of gravity, principal axes, and orientation angles of controllers."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

#: Row and column of each moment of a result, [Ixx, Iyy, Izz, Ixy, Ixz, Iyz], in a (3, 3) tensor.
ROW, COLUMN = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
#: What rounding in a file may take from the triangle inequality of principal moments.
ROUNDED = 1e-6


def tensor_of(moments: ArrayLike) -> Floats:
    """Return the tensor (3, 3) of six moments, in the order of a result."""
    tensor = np.zeros((3, 3))
    tensor[ROW, COLUMN] = tensor[COLUMN, ROW] = moments
    return tensor


def moments_of(tensor: Floats) -> tuple[float, ...]:
    """Return the six moments of a tensor (3, 3), in the order of a result."""
    return tuple(tensor[ROW, COLUMN].tolist())


def has_a_body(tensor: Floats) -> bool:
    """Return whether an inertia (3, 3) is physical: principal moments not negative and within the triangle
    inequality.
    """
    if not np.isfinite(tensor).all():
        return False
    least, middle, largest = np.linalg.eigvalsh(tensor).tolist()
    return least >= 0.0 and least + middle >= (1.0 - ROUNDED) * largest


def principal_axes(tensor: Floats) -> tuple[Floats, Floats]:
    """Return principal moments (3,) and axes (columns of a rotation (3, 3)), ordered for the smallest rotation.

    `tensor` = axes diag(moments) axes'.
    """
    moments, axes = np.linalg.eigh(tensor)
    order = max(permutations(range(3)), key=lambda names: sum(abs(axes[row, names[row]]) for row in range(3)))
    moments, axes = moments[list(order)], axes[:, list(order)]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, int(np.argmin(np.diag(axes)))] *= -1.0
    return moments, axes


def zyx_degrees(turn: Floats) -> tuple[float, float, float]:
    """Return the angles [deg] A about z, B about the new y, C about the new x of a rotation (3, 3): Rz(A) Ry(B)
    Rx(C).
    """
    across = math.hypot(turn[0, 0], turn[1, 0])
    if across < 1e-9:
        return 0.0, math.degrees(math.atan2(-turn[2, 0], across)), math.degrees(math.atan2(-turn[1, 2], turn[1, 1]))
    return (
        math.degrees(math.atan2(turn[1, 0], turn[0, 0])),
        math.degrees(math.atan2(-turn[2, 0], across)),
        math.degrees(math.atan2(turn[2, 1], turn[2, 2])),
    )


def quaternion(turn: Floats) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z), w not negative, of a rotation (3, 3)."""
    products = np.array(
        [
            [turn[0, 0] - turn[1, 1] - turn[2, 2], 0.0, 0.0, 0.0],
            [turn[0, 1] + turn[1, 0], turn[1, 1] - turn[0, 0] - turn[2, 2], 0.0, 0.0],
            [turn[0, 2] + turn[2, 0], turn[1, 2] + turn[2, 1], turn[2, 2] - turn[0, 0] - turn[1, 1], 0.0],
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1], np.trace(turn)],
        ]
    )
    x, y, z, w = np.linalg.eigh(products, UPLO="L")[1][:, -1].tolist()
    sense = -1.0 if w < 0.0 else 1.0
    return sense * w, sense * x, sense * y, sense * z
