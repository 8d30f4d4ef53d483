"""Fisher information of rest poses about a load."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot

Floats = NDArray[np.float64]


def payload_information(
    robot: Robot, q_rad: ArrayLike, sigma_nm: ArrayLike, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2
) -> Floats:
    """Return the information of each pose on [m, hx, hy, hz] of the load, if the unloaded arm is measured there too.

    The difference of loaded and unloaded torque has twice the variance of one: `L' W L / 2`. One pose has rank 3.

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (n, N)
    sigma_nm : array of shape (N,)
        Standard deviation of a half-sum; NaN or infinite = the axis is not measured.
    gravity_m_s2 : array of shape (3,)

    Returns
    -------
    array of shape (n, 4, 4)
        1/kg^2, 1/(kg kg m), 1/(kg m)^2.
    """
    sigma = np.asarray(sigma_nm, dtype=float)
    inverse = np.where(np.isfinite(sigma), 1.0 / np.where(np.isfinite(sigma), sigma, 1.0), 0.0)
    rows = load_regressor(robot, q_rad, gravity_m_s2) * inverse[:, None]
    return np.matmul(rows.transpose(0, 2, 1), rows) / 2.0
