"""What a rest pose tells about a load: the kernel of every choice of poses."""

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
    """Fisher information of each pose on [m, hx, hy, hz] of the load, the bare arm measured at the same pose.

    Loaded less bare has twice the variance of one: `L' W L / 2`. One pose alone has rank 3.

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
    rows = _weighted_rows(robot, q_rad, sigma_nm, gravity_m_s2)
    return np.matmul(rows.transpose(0, 2, 1), rows) / 2.0


def axis_information(
    robot: Robot, q_rad: ArrayLike, sigma_nm: ArrayLike, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2
) -> Floats:
    """Fisher information of all poses together, of the rows of each axis by itself: array of shape (N, 4, 4).

    Parameters and units are those of `payload_information`.
    """
    rows = _weighted_rows(robot, q_rad, sigma_nm, gravity_m_s2)
    return np.einsum("nij,nik->ijk", rows, rows) / 2.0


def _weighted_rows(robot: Robot, q_rad: ArrayLike, sigma_nm: ArrayLike, gravity_m_s2: ArrayLike) -> Floats:
    """Rows (n, N, 4) of the load over their standard deviation; zeros where an axis is not measured."""
    sigma = np.asarray(sigma_nm, dtype=float)
    inverse = np.where(np.isfinite(sigma), 1.0 / np.where(np.isfinite(sigma), sigma, 1.0), 0.0)
    return load_regressor(robot, q_rad, gravity_m_s2) * inverse[:, None]


def information_under_gains(information: ArrayLike, load: ArrayLike, gain_std: ArrayLike) -> Floats:
    """What is left of summed information when every axis's torque constant is known to a share only.

    An axis whose constant is wrong by `g` is wrong by `g L load` at every pose alike: to the covariance of its rows
    comes `s^2 (L load)(L load)'`, and by Sherman and Morrison `A` becomes
    `A - s^2 (A load)(A load)' / (1 + s^2 load' A load)`.

    Parameters
    ----------
    information : array of shape (N, 4, 4)
        Of the rows of one axis each, over all poses.
    load : array of shape (4,)
        Mass [kg] and first moment [kg m].
    gain_std : array of shape (N,)
        Relative standard deviation of the torque constants.

    Returns
    -------
    array of shape (4, 4)
    """
    each, load, variance = np.asarray(information), np.asarray(load), np.asarray(gain_std) ** 2
    torque = each @ load
    lost = variance / (1.0 + variance * (torque @ load))
    return (each - lost[:, None, None] * torque[:, :, None] * torque[:, None, :]).sum(axis=0)


def expected_std(information: ArrayLike, mass_kg: float, com_m: ArrayLike) -> tuple[float, Floats]:
    """Standard deviation of mass [kg] and centre of mass (3,) [m] that summed information (4, 4) promises.

    Infinite for what the poses cannot give. The centre of mass is `h / m`: its deviation needs a guess of the load.
    """
    total = np.asarray(information, dtype=float)
    scale = np.sqrt(np.maximum(np.diag(total), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(safe, safe))
    open_ = values < 1e-10 * max(float(values[-1]), 1e-300)
    com = np.asarray(com_m, dtype=float)
    turn = np.column_stack([-com, np.eye(3)]) / max(abs(mass_kg), 1e-12)
    directions = np.vstack([[1.0, 0.0, 0.0, 0.0], turn]) / safe
    parts = directions @ vectors
    lost = (np.abs(parts[:, open_]) > 1e-6 * np.linalg.norm(parts, axis=1, keepdims=True)).any(axis=1)
    std = np.sqrt((parts[:, ~open_] ** 2 / values[~open_]).sum(axis=1))
    std[lost] = np.inf
    return float(std[0]), std[1:]
