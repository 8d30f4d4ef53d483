"""Compute blocks of regressor rows of an arm at rest.

The gravity torque of a body on an axis is `k . (p - o)`, with its position `p`, a point `o` of the axis, and the
horizontal vector `k = up x axis` times the gravitational acceleration. Only the two horizontal components of every pose
are needed. For each link they are stored as columns [origin, x, y, z] and propagated by a matrix that is linear in [1,
sin q, cos q].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.kinematics import cross_matrix, sine_cosine
from gateway.model.robot import Robot

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RestConstants:
    """Constants of an arm that do not depend on the sample.

    `step` (N, 3, 16): propagation of [origin, x, y, z] by [1, sin q, cos q]. `first` (3, 12): columns of link 1,
    horizontal x, horizontal y and a row that counts origins. `axis` (N, 3): joint axis. `gravity_m_s2`: magnitude of
    gravity.
    """

    step: Floats
    first: Floats
    axis: Floats
    gravity_m_s2: float

    @staticmethod
    def of(robot: Robot, gravity_m_s2: Floats) -> RestConstants:
        """Return the constants of an arm in a gravity field (3,), base frame."""
        step = np.zeros((robot.axes, 3, 4, 4))
        for j in range(robot.axes):
            rotation, cross = robot.placement[j, :3, :3], cross_matrix(robot.axis[j])
            twice = rotation @ cross @ cross
            step[j, 0, 0, 0] = 1.0
            step[j, 0, 1:, 0] = robot.placement[j, :3, 3]
            step[j, :, 1:, 1:] = rotation + twice, rotation @ cross, -twice
        level = np.zeros((3, 4))
        level[:2, 1:], level[2, 0] = _level(gravity_m_s2), 1.0
        first = (level @ step[0]).reshape(3, 12)
        return RestConstants(step.reshape(-1, 3, 16), first, robot.axis, float(np.linalg.norm(gravity_m_s2)))


@dataclass(frozen=True, slots=True, eq=False)
class RestBuffers:
    """Work arrays for blocks of `n` rows, reused from block to block."""

    phase: Floats
    step: Floats
    places: Floats
    push: Floats

    @staticmethod
    def of(axes: int, n: int) -> RestBuffers:
        """Return the work arrays for blocks of n rows of an arm."""
        return RestBuffers(
            phase=np.ones((3, axes, n)),
            step=np.empty((axes - 1, n, 16)),
            places=np.empty((n, 3, 4 * axes)),
            push=np.empty((n, axes, 3)),
        )


def block(constants: RestConstants, work: RestBuffers, q: Floats, out: Floats) -> None:
    """Compute the rows of the last links of one block: positions [rad] (n, N), `out` (n, N, 4 * links)."""
    n, axes = q.shape
    first = axes - out.shape[2] // 4
    angle = np.ascontiguousarray(q.T)
    sine_cosine(angle, work.phase[1], work.phase[2])
    phase, places = work.phase.transpose(1, 2, 0), work.places
    step = np.matmul(phase[1:], constants.step[1:], out=work.step).reshape(axes - 1, n, 4, 4)
    places[:, :, :4] = (phase[0] @ constants.first).reshape(n, 3, 4)
    for j in range(1, axes):
        np.matmul(places[:, :, 4 * j - 4 : 4 * j], step[j - 1], out=places[:, :, 4 * j : 4 * j + 4])
    _push(constants, work)
    np.matmul(work.push, work.places[:, :, 4 * first :], out=out)
    for i in range(first + 1, axes):
        out[:, i, : 4 * (i - first)] = 0.0


def _push(constants: RestConstants, work: RestBuffers) -> None:
    """Compute the horizontal vector k and -k . o of every axis as rows on [origin, x, y, z], into `work.push`."""
    x, y = np.ascontiguousarray(work.places[:, :2].transpose(1, 2, 0)).reshape(2, len(constants.axis), 4, -1)
    axis_x = np.zeros((x.shape[0], x.shape[2]))
    axis_y = np.zeros_like(axis_x)
    for k in range(3):
        if constants.axis[:, k].any():
            part = constants.gravity_m_s2 * constants.axis[:, k, None]
            axis_x += part * x[:, 1 + k]
            axis_y += part * y[:, 1 + k]
    work.push[:, :, 0] = -axis_y.T
    work.push[:, :, 1] = axis_x.T
    work.push[:, :, 2] = (axis_y * x[:, 0] - axis_x * y[:, 0]).T


def _level(gravity: Floats) -> Floats:
    """Return two horizontal unit vectors (2, 3) x, y that form a right-handed frame with "up" as z."""
    length = float(np.linalg.norm(gravity))
    if length == 0.0:
        return np.zeros((2, 3))
    up = -gravity / length
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = np.cross(other, up)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x)])
