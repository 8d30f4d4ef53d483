"""Regressor: torque of an arm with N axes, linear in the inertial parameters of its links.

Full rows: `tau = Y(q, qd, qdd) phi`, ten columns per link [m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz], first moment
`h = m c` and inertia about the origin of the link frame. Rest rows: four columns per link [m, hx, hy, hz]. The torque
is that of the actuator, positive in +q, and holds the arm against gravity.

Rows are computed in blocks, so that the work arrays fit the cache and memory does not grow beyond the result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.model import newton_euler, statics
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

FULL_PER_LINK = ("m", "hx", "hy", "hz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
GRAVITY_PER_LINK = FULL_PER_LINK[:4]
#: Columns of the last link and its load in the rest rows.
LOAD_COLUMNS = slice(-4, None)

# Rows in a block: work arrays fill the second-level cache. Not powers of two: such strides fall into the same cache
# sets. Matrix products of this size stay on one thread.
_MOVING_BLOCK = 352
_REST_BLOCK = 520


def full_names(axes: int) -> tuple[str, ...]:
    """Return the names of the full columns: m_1, hx_1 .. Izz_N."""
    return _names(axes, FULL_PER_LINK)


def gravity_names(axes: int) -> tuple[str, ...]:
    """Return the names of the rest columns: m_1, hx_1 .. hz_N."""
    return _names(axes, GRAVITY_PER_LINK)


def _names(axes: int, per_link: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}_{link}" for link in range(1, axes + 1) for name in per_link)


def regressor(
    robot: Robot,
    q_rad: ArrayLike,
    qd_rad_s: ArrayLike,
    qdd_rad_s2: ArrayLike,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    out: Floats | None = None,
) -> Floats:
    """Return the full regressor rows of a moving arm.

    Parameters
    ----------
    robot : Robot
    q_rad, qd_rad_s, qdd_rad_s2 : arrays of shape (n, N)
    gravity_m_s2 : array of shape (3,)
        Gravity in the base frame.
    out : array of shape (n, N, 10 N), optional
        Written to and returned.

    Returns
    -------
    array of shape (n, N, 10 N)
        Nm per unit of `full_names` (kg, kg m, kg m2).
    """
    q, qd, qdd = (np.asarray(value, dtype=float) for value in (q_rad, qd_rad_s, qdd_rad_s2))
    out = _checked(robot, q, out, 10 * robot.axes)
    gravity = np.asarray(gravity_m_s2, dtype=float)
    constants = newton_euler.MotionConstants.of(robot)
    size, starts = _blocks(len(q), _MOVING_BLOCK)
    work = newton_euler.MotionBuffers.of(constants, size)
    for start in starts:
        rows = slice(start, start + size)
        newton_euler.block(constants, work, (q[rows], qd[rows], qdd[rows]), gravity, out[rows])
    return out


def gravity_regressor(
    robot: Robot,
    q_rad: ArrayLike,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    out: Floats | None = None,
) -> Floats:
    """Return the regressor rows of an arm at rest.

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (n, N)
    gravity_m_s2 : array of shape (3,)
        Gravity in the base frame.
    out : array of shape (n, N, 4 N), optional
        Written to and returned.

    Returns
    -------
    array of shape (n, N, 4 N)
        Nm per unit of `gravity_names` (kg, kg m).
    """
    q = np.asarray(q_rad, dtype=float)
    return _rest_rows(robot, q, gravity_m_s2, _checked(robot, q, out, 4 * robot.axes))


def load_regressor(
    robot: Robot,
    q_rad: ArrayLike,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    out: Floats | None = None,
) -> Floats:
    """Return the columns (n, N, 4) of a load on the last link at rest: Nm per [kg, kg m, kg m, kg m]."""
    q = np.asarray(q_rad, dtype=float)
    return _rest_rows(robot, q, gravity_m_s2, _checked(robot, q, out, 4))


def _checked(robot: Robot, q: Floats, out: Floats | None, columns: int) -> Floats:
    if q.ndim != 2 or q.shape[1] != robot.axes:
        raise ValueError(f"joint positions need the shape (n, {robot.axes}), got {q.shape}")
    shape = (len(q), robot.axes, columns)
    if out is None:
        return np.empty(shape)
    if out.shape != shape:
        raise ValueError(f"out needs the shape {shape}, got {out.shape}")
    return out


def _blocks(count: int, most: int) -> tuple[int, list[int]]:
    """Return the size and the starts of the blocks; the last one overlaps the one before."""
    size = min(count, most)
    if not size:
        return 0, []
    starts = list(range(0, count - size, size))
    return size, [*starts, count - size]


def _rest_rows(robot: Robot, q: Floats, gravity_m_s2: ArrayLike, out: Floats) -> Floats:
    constants = statics.RestConstants.of(robot, np.asarray(gravity_m_s2, dtype=float))
    size, starts = _blocks(len(q), _REST_BLOCK)
    work = statics.RestBuffers.of(robot.axes, size)
    for start in starts:
        rows = slice(start, start + size)
        statics.block(constants, work, q[rows], out[rows])
    return out
