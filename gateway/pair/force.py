"""Wrench on a gripper from joint torques, and its internal part that loads the workpiece (CN104379308 [0063]).

A wrench `[F (3) N; M (3) Nm]` is what the WORKPIECE exerts ON THE GRIPPER, about the fingertip, in the axes of that
robot's base. Joint torque is actuator torque, positive in +q: `tau_motor = tau_model + tau_friction - J^T W`.

Both grippers also carry the part. About the part's centre `h_ext = h_1 + h_2` holds its weight and inertia reaction,
`h_int = (h_2 - h_1)/2` is what squeezes and bends it, and only that is corrected: a hand that nulled the whole wrench
would let go of its share of the weight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gateway.pair.transform import Floats, cross_matrix

GRAVITY_M_S2 = (0.0, 0.0, -9.80665)


def dead_band(value: ArrayLike, band: ArrayLike) -> Floats:
    """Apply a dead band (6,) to a value (..., 6); continuous at its edge."""
    values = np.asarray(value, dtype=float)
    return np.sign(values) * np.maximum(np.abs(values) - np.asarray(band), 0.0)


def to_centre(w_r_b: ArrayLike, lever_m: ArrayLike) -> Floats:
    """Return matrices (..., 6, 6) that map a wrench at a fingertip, base axes, to the part's centre, world axes.

    Parameters
    ----------
    w_r_b : array of shape (3, 3)
        Base in the world.
    lever_m : array of shape (..., 3)
        From the centre to the fingertip, world axes.
    """
    turn, lever = np.asarray(w_r_b, dtype=float), np.asarray(lever_m, dtype=float)
    matrix = np.zeros((*lever.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = turn
    matrix[..., 3:, :3] = cross_matrix(lever) @ turn
    return matrix


def split(first: ArrayLike, second: ArrayLike) -> tuple[Floats, Floats]:
    """Split both grippers' wrenches into external and internal wrench (..., 6), about the part's centre, world axes."""
    one, two = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return one + two, 0.5 * (two - one)


def share_of_part(part_mass_kg: float, acceleration_m_s2: ArrayLike, gravity_m_s2: ArrayLike = GRAVITY_M_S2) -> Floats:
    """Return the force (..., 3) [N] of half the part on its gripper, `m (g - a)/2`, world axes."""
    return 0.5 * part_mass_kg * (np.asarray(gravity_m_s2, dtype=float) - np.asarray(acceleration_m_s2, dtype=float))
