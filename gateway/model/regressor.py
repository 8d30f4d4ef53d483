"""Regressor: torque of an arm with N axes, linear in the inertial parameters of its links.

Full rows: `tau = Y(q, qd, qdd) phi`, ten columns per link [m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz], first moment
`h = m c` and inertia about the origin of the link frame. Rest rows: four columns per link [m, hx, hy, hz]. The torque
is that of the actuator, positive in +q, and holds the arm against gravity.

Rows are computed in blocks, so that the work arrays fit the cache and memory does not grow beyond the result. Arrays
are ordered (link, row, small matrix), so that the work is in matrix products. The step from link to link is linear in
[1, sin q, cos q] (Rodrigues' formula after the fixed placement of each joint).

In motion, spatial velocities and accelerations go from link to link (Featherstone, Rigid Body Dynamics Algorithms).
They are rows [linear, angular] at the origin and in the frame of the link (ch. 2 and 5). The wrench of a link is linear
in the twelve numbers of its motion.

At rest, the torque of a body on an axis is `k . (p - o)`, with its position `p` and a point `o` of the axis. The
horizontal vector `k` is `up x axis` times the gravitational acceleration. Only the two horizontal components of every
pose are needed. For each link they are stored as columns [origin, x, y, z].
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.model.kinematics import STANDARD_GRAVITY_M_S2, cross_matrix, sine_cosine
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
_MOTION = 12  # fall (3), gain (3), products of the spin xx yy zz xy yz zx


def full_names(axes: int) -> tuple[str, ...]:
    """Return the names of the full columns: m_1, hx_1 .. Izz_N."""
    return tuple(f"{name}_{link}" for link in range(1, axes + 1) for name in FULL_PER_LINK)


def gravity_names(axes: int) -> tuple[str, ...]:
    """Return the names of the rest columns: m_1, hx_1 .. hz_N."""
    return tuple(f"{name}_{link}" for link in range(1, axes + 1) for name in GRAVITY_PER_LINK)


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
    out, axes = _checked(robot, q, out, 10 * robot.axes), robot.axes
    constant, turned = np.zeros((axes, 3, 6, 6)), np.zeros((axes, 6, 6))
    for j in range(axes):
        cross, lever = cross_matrix(robot.axis[j]), cross_matrix(robot.placement[j, :3, 3])
        for k, turn in enumerate(_turns(robot, j)):
            constant[j, k, :3, :3] = constant[j, k, 3:, 3:] = turn
            constant[j, k, 3:, :3] = lever @ turn
        turned[j, :3, :3] = turned[j, 3:, 3:] = cross
    parts = tuple(tuple((k, float(axis[k])) for k in range(3) if axis[k] != 0.0) for axis in robot.axis)
    # torque of axis 1 per unit of the motion of link 1: only its own axis moves the first link
    first = np.einsum("mkc,k->mc", _WRENCH_MAP.reshape(_MOTION, 6, 10)[:, 3:], robot.axis[0])
    falling = np.concatenate([-np.asarray(gravity_m_s2, dtype=float), np.zeros(3)]) @ constant[0]
    constant = constant.reshape(-1, 3, 36)
    # work arrays, reused from block to block; constant zeros are never written
    n = min(len(q), _MOVING_BLOCK)
    phase, step, wrench = np.ones((3, axes, n)), np.empty((n, 36)), np.empty((n, 60))
    state = np.zeros((axes, n, 2 + axes, 6))  # in the frame of a link: velocity, acceleration less gravity, screws
    for j in range(axes):
        state[j, :, 2 + j, 3:] = robot.axis[j]
    velocity, motion, result = np.empty((2, 5, axes, n)), np.empty((axes, _MOTION, n)), np.zeros((n, axes, 10 * axes))
    for rows in _blocks(len(q), n):
        angle, speed, gain = (np.ascontiguousarray(value[rows].T) for value in (q, qd, qdd))
        sine_cosine(angle, phase[1], phase[2])
        by_row = phase.transpose(1, 2, 0)
        state[0, :, 0] = 0.0
        state[0, :, 1] = by_row[0] @ falling
        for j in range(axes):
            if j:
                step_j = np.matmul(by_row[j], constant[j], out=step).reshape(-1, 6, 6)
                np.matmul(state[j - 1, :, : j + 2], step_j, out=state[j, :, : j + 2])
                across = state[j, :, 0] @ turned[j]
                across *= qd[rows, j, None]
                state[j, :, 1] += across
            for k, part in parts[j]:
                state[j, :, 0, 3 + k] += speed[j] if part == 1.0 else part * speed[j]
                state[j, :, 1, 3 + k] += gain[j] if part == 1.0 else part * gain[j]
        _motion_of_links(state, velocity, motion.transpose(1, 0, 2))
        np.matmul(motion[0].T, first, out=result[:, 0, :10])
        for j in range(1, axes):
            by_parameter = np.matmul(motion[j].T, _WRENCH_MAP, out=wrench).reshape(n, 6, 10)
            np.matmul(state[j, :, 2 : 3 + j], by_parameter, out=result[:, : j + 1, 10 * j : 10 * j + 10])
        out[rows] = result
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
    return _rest_rows(robot, q_rad, gravity_m_s2, out, robot.axes)


def load_regressor(
    robot: Robot,
    q_rad: ArrayLike,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    out: Floats | None = None,
) -> Floats:
    """Return the columns (n, N, 4) of a load on the last link at rest: Nm per [kg, kg m, kg m, kg m]."""
    return _rest_rows(robot, q_rad, gravity_m_s2, out, 1)


def _checked(robot: Robot, q: Floats, out: Floats | None, columns: int) -> Floats:
    if q.ndim != 2 or q.shape[1] != robot.axes:
        raise ValueError(f"joint positions need the shape (n, {robot.axes}), got {q.shape}")
    shape = (len(q), robot.axes, columns)
    if out is None:
        return np.empty(shape)
    if out.shape != shape:
        raise ValueError(f"out needs the shape {shape}, got {out.shape}")
    return out


def _rest_rows(robot: Robot, q_rad: ArrayLike, gravity_m_s2: ArrayLike, out: Floats | None, links: int) -> Floats:
    """Return the rows of the last links of an arm at rest: positions [rad] (n, N), result (n, N, 4 * links)."""
    q, gravity, axes = np.asarray(q_rad, dtype=float), np.asarray(gravity_m_s2, dtype=float), robot.axes
    out, skipped = _checked(robot, q, out, 4 * links), axes - links
    constant = np.zeros((axes, 3, 4, 4))
    for j in range(axes):
        constant[j, 0, 0, 0] = 1.0
        constant[j, 0, 1:, 0] = robot.placement[j, :3, 3]
        constant[j, :, 1:, 1:] = _turns(robot, j)
    level = np.zeros((3, 4))  # horizontal x, horizontal y and a row that counts origins
    length = float(np.linalg.norm(gravity))
    if length > 0.0:
        up = -gravity / length
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
        x /= np.linalg.norm(x)
        level[:2, 1:] = x, np.cross(up, x)
    level[2, 0] = 1.0
    first = (level @ constant[0]).reshape(3, 12)
    constant = constant.reshape(-1, 3, 16)
    # work arrays, reused from block to block
    n = min(len(q), _REST_BLOCK)
    phase, step = np.ones((3, axes, n)), np.empty((axes - 1, n, 16))
    places, push = np.empty((n, 3, 4 * axes)), np.empty((n, axes, 3))
    for rows in _blocks(len(q), n):
        sine_cosine(np.ascontiguousarray(q[rows].T), phase[1], phase[2])
        by_row = phase.transpose(1, 2, 0)
        np.matmul(by_row[1:], constant[1:], out=step)
        places[:, :, :4] = (by_row[0] @ first).reshape(n, 3, 4)
        for j in range(1, axes):
            step_j = step[j - 1].reshape(n, 4, 4)
            np.matmul(places[:, :, 4 * j - 4 : 4 * j], step_j, out=places[:, :, 4 * j : 4 * j + 4])
        # the horizontal vector k and -k . o of every axis, as rows on [origin, x, y, z]
        x, y = np.ascontiguousarray(places[:, :2].transpose(1, 2, 0)).reshape(2, axes, 4, n)
        axis_x, axis_y = np.zeros((2, axes, n))
        for k in range(3):
            if robot.axis[:, k].any():
                part = length * robot.axis[:, k, None]
                axis_x += part * x[:, 1 + k]
                axis_y += part * y[:, 1 + k]
        push[:, :, 0] = -axis_y.T
        push[:, :, 1] = axis_x.T
        push[:, :, 2] = (axis_y * x[:, 0] - axis_x * y[:, 0]).T
        np.matmul(push, places[:, :, 4 * skipped :], out=out[rows])
        for i in range(skipped + 1, axes):
            out[rows, i, : 4 * (i - skipped)] = 0.0
    return out


def _turns(robot: Robot, joint: int) -> tuple[Floats, Floats, Floats]:
    """Return the rotation from a link to the one before, per unit of 1, sin q and cos q."""
    rotation, cross = robot.placement[joint, :3, :3], cross_matrix(robot.axis[joint])
    twice = rotation @ cross @ cross
    return rotation + twice, rotation @ cross, -twice


def _blocks(count: int, size: int) -> Iterator[slice]:
    """Yield blocks of `size` rows; the last one overlaps the one before."""
    for start in range(0, count, max(size, 1)):
        first = min(start, count - size)
        yield slice(first, first + size)


def _motion_of_links(state: Floats, velocity: Floats, motion: Floats) -> None:
    """Compute the twelve numbers (12, N, n) of every link's motion: origin acceleration minus gravity first.

    Vectors are stored in five components x, y, z, x, y: (y, z, x) and (z, x, y) are then slices, and a cross product
    needs three steps.
    """
    velocity[:, :3] = state[:, :, 0].reshape(*state.shape[:2], 2, 3).transpose(2, 3, 0, 1)
    velocity[:, 3:] = velocity[:, :2]
    motion[:6] = state[:, :, 1].transpose(2, 0, 1)
    linear, spin = velocity
    motion[:3] += spin[1:4] * linear[2:5]
    motion[:3] -= spin[2:5] * linear[1:4]
    np.multiply(spin[:3], spin[:3], out=motion[6:9])
    np.multiply(spin[:3], spin[1:4], out=motion[9:12])


def _wrench_map() -> Floats:
    """Return the map (12, 6 * 10) from the motion of a link to its wrench: [force; moment] by [m, h, I].

    Force `m fall + ([gain]x + [spin]x [spin]x) h`, moment `h x fall + I gain + spin x (I spin)`.
    """
    to = np.zeros((_MOTION, 6, 10))
    fall, gain = to[0:3], to[3:6]
    xx, yy, zz, xy, yz, xz = to[6:12]
    products = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    inertia = {(0, 0): 4, (0, 1): 5, (0, 2): 6, (1, 1): 7, (1, 2): 8, (2, 2): 9}
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        fall[a, a, 0] = 1.0
        gain[b, a, 1 + c] += 1.0  # gain x h
        gain[c, a, 1 + b] -= 1.0
        fall[c, 3 + a, 1 + b] += 1.0  # h x fall
        fall[b, 3 + a, 1 + c] -= 1.0
        for k in range(3):
            products[a][k][a, 1 + k] += 1.0  # spin (spin . h) - spin^2 h
            products[k][k][a, 1 + a] -= 1.0
            gain[k, 3 + a, inertia[min(a, k), max(a, k)]] += 1.0
            products[b][k][3 + a, inertia[min(c, k), max(c, k)]] += 1.0  # spin x (I spin)
            products[c][k][3 + a, inertia[min(b, k), max(b, k)]] -= 1.0
    return to.reshape(_MOTION, 60)


_WRENCH_MAP = _wrench_map()
