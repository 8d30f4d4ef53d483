"""Compute blocks of the full regressor: spatial velocities and accelerations from link to link, then wrenches per
parameter.

Arrays are ordered (link, row, small matrix), so that the work is in matrix products. The step from link to link is
linear in [1, sin q, 1 - cos q]. The wrench of a link is linear in the twelve numbers of its motion. Spatial vectors are
rows [linear, angular] at the origin and in the frame of the link (Featherstone, Rigid Body Dynamics Algorithms, ch. 2
and 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.kinematics import cross_matrix, sine_cosine
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

_MOTION = 12  # fall (3), gain (3), products of the spin xx yy zz xy yz zx


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


@dataclass(frozen=True, slots=True, eq=False)
class MotionConstants:
    """Constants of an arm that do not depend on the sample.

    `step` (N, 3, 36): spatial step to each link by [1, sin q, cos q]. `turned` (N, 6, 6): spatial cross product with
    the joint axis. `axis` (N, 3): joint axis. `first` (12, 10): torque of axis 1 per unit of the motion of link 1.
    `parts`: nonzero components of each axis as (index, value).
    """

    step: Floats
    turned: Floats
    axis: Floats
    first: Floats
    parts: tuple[tuple[tuple[int, float], ...], ...]

    @staticmethod
    def of(robot: Robot) -> MotionConstants:
        """Return the constants of an arm: Rodrigues' formula after the fixed placement of each joint."""
        step, turned = np.zeros((robot.axes, 3, 6, 6)), np.zeros((robot.axes, 6, 6))
        for j in range(robot.axes):
            rotation, cross = robot.placement[j, :3, :3], cross_matrix(robot.axis[j])
            lever, twice = cross_matrix(robot.placement[j, :3, 3]), rotation @ cross @ cross
            for k, turn in enumerate((rotation + twice, rotation @ cross, -twice)):
                step[j, k, :3, :3] = step[j, k, 3:, 3:] = turn
                step[j, k, 3:, :3] = lever @ turn
            turned[j, :3, :3] = turned[j, 3:, 3:] = cross
        parts = tuple(tuple((k, float(axis[k])) for k in range(3) if axis[k] != 0.0) for axis in robot.axis)
        first = np.einsum("mkc,k->mc", _WRENCH_MAP.reshape(_MOTION, 6, 10)[:, 3:], robot.axis[0])
        return MotionConstants(step.reshape(-1, 3, 36), turned, robot.axis, first, parts)


@dataclass(frozen=True, slots=True, eq=False)
class MotionBuffers:
    """Work arrays for blocks of `n` rows, reused from block to block; constant zeros are never written."""

    phase: Floats
    step: Floats
    state: Floats
    velocity: Floats
    motion: Floats
    wrench: Floats
    rows: Floats

    @staticmethod
    def of(constants: MotionConstants, n: int) -> MotionBuffers:
        """Return the work arrays for blocks of n rows of one arm."""
        axes = len(constants.axis)
        state = np.zeros((axes, n, 2 + axes, 6))  # velocity, acceleration, a screw for each axis
        for j in range(axes):
            state[j, :, 2 + j, 3:] = constants.axis[j]
        return MotionBuffers(
            phase=np.ones((3, axes, n)),
            step=np.empty((n, 36)),
            state=state,
            velocity=np.empty((2, 5, axes, n)),
            motion=np.empty((axes, _MOTION, n)),
            wrench=np.empty((n, 60)),
            rows=np.zeros((n, axes, 10 * axes)),
        )


def block(
    constants: MotionConstants, work: MotionBuffers, motion: tuple[Floats, Floats, Floats], gravity: Floats, out: Floats
) -> None:
    """Compute the rows of one block.

    Parameters
    ----------
    constants : MotionConstants
    work : MotionBuffers
        Work arrays of the length of the block.
    motion : three arrays of shape (n, N)
        Positions [rad], velocities [rad/s], accelerations [rad/s2].
    gravity : array of shape (3,)
        In the base frame [m/s2].
    out : array of shape (n, N, 10 N)
    """
    n = len(out)
    _hand_on(constants, work, motion, gravity)
    _motion_of_links(work)
    np.matmul(work.motion[0].T, constants.first, out=work.rows[:, 0, :10])  # only its own axis moves the first link
    for j in range(1, len(constants.axis)):
        wrench = np.matmul(work.motion[j].T, _WRENCH_MAP, out=work.wrench).reshape(n, 6, 10)
        np.matmul(work.state[j, :, 2 : 3 + j], wrench, out=work.rows[:, : j + 1, 10 * j : 10 * j + 10])
    out[...] = work.rows


def _hand_on(
    constants: MotionConstants, work: MotionBuffers, motion: tuple[Floats, Floats, Floats], gravity: Floats
) -> None:
    """Compute velocity, acceleration minus gravity, and screws of every link, in its frame, into `work.state`."""
    q, qd, qdd = (np.ascontiguousarray(value.T) for value in motion)
    sine_cosine(q, work.phase[1], work.phase[2])
    phase, state, rates = work.phase.transpose(1, 2, 0), work.state, motion[1]
    falling = np.concatenate([-gravity, np.zeros(3)]) @ constants.step[0].reshape(3, 6, 6)
    state[0, :, 0] = 0.0
    state[0, :, 1] = phase[0] @ falling
    for j in range(len(constants.axis)):
        if j:
            step = np.matmul(phase[j], constants.step[j], out=work.step).reshape(-1, 6, 6)
            np.matmul(state[j - 1, :, : j + 2], step, out=state[j, :, : j + 2])
            across = state[j, :, 0] @ constants.turned[j]
            across *= rates[:, j, None]
            state[j, :, 1] += across
        for k, part in constants.parts[j]:
            state[j, :, 0, 3 + k] += qd[j] if part == 1.0 else part * qd[j]
            state[j, :, 1, 3 + k] += qdd[j] if part == 1.0 else part * qdd[j]


def _motion_of_links(work: MotionBuffers) -> None:
    """Compute the twelve numbers of every link's motion into `work.motion`: origin acceleration minus gravity first.

    Vectors are stored in five components x, y, z, x, y: (y, z, x) and (z, x, y) are then slices, and a cross product
    needs three steps.
    """
    motion, velocity = work.motion.transpose(1, 0, 2), work.velocity
    velocity[:, :3] = work.state[:, :, 0].reshape(*work.state.shape[:2], 2, 3).transpose(2, 3, 0, 1)
    velocity[:, 3:] = velocity[:, :2]
    motion[:6] = work.state[:, :, 1].transpose(2, 0, 1)
    linear, spin = velocity
    motion[:3] += spin[1:4] * linear[2:5]
    motion[:3] -= spin[2:5] * linear[1:4]
    np.multiply(spin[:3], spin[:3], out=motion[6:9])
    np.multiply(spin[:3], spin[1:4], out=motion[9:12])
