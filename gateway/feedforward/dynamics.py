"""Inverse dynamics of one instant with plain floats: recursive Newton-Euler, fast enough for every SYNC.

Each link's frame is rotated so that its joint axis is z: the transform from link to link is then a constant matrix and
a rotation in a plane. Inertia is taken about the origin of the joint frame, so that no shift to the centre of mass is
needed (Luh, Walker and Paul, 1980; Featherstone, Rigid Body Dynamics Algorithms, 5.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.robot import Robot

Floats = NDArray[np.float64]
PER_LINK = 10


class ArmDynamics:
    """Inverse dynamics of an arm with given inertial parameters.

    Parameters
    ----------
    robot : Robot
        Geometry of the arm; the inertials are those of `parameters`.
    parameters : array of shape (10 N,)
        Per link [m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] in kg, kg m and kg m2.
        About the origin and in the frame of the link. A load is part of the last link.
    gravity_m_s2 : array of shape (3,)
        In the base frame.

    Raises
    ------
    ValueError
        A parameter is not finite.
    """

    __slots__ = ("_fall", "_links")

    def __init__(self, robot: Robot, parameters: ArrayLike, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2) -> None:
        phi = np.asarray(parameters, dtype=float).reshape(robot.axes, PER_LINK)
        if not np.isfinite(phi).all():
            raise ValueError("inertial parameters must be finite")
        self._fall = tuple((-np.asarray(gravity_m_s2, dtype=float)).tolist())
        self._links = tuple(_link_constants(robot, phi, number) for number in range(robot.axes))

    @property
    def axes(self) -> int:
        """Number of axes of the arm."""
        return len(self._links)

    def torque(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> list[float]:
        """Return the actuator torque of one instant, positive in +q.

        Parameters
        ----------
        q, qd, qdd : sequences of floats, one per axis
            Joint positions [rad], velocities [rad/s], accelerations [rad/s2].

        Returns
        -------
        list of floats, one per axis
            Torque [Nm] without rotors, friction and gear losses.
        """
        wx = wy = wz = ux = uy = uz = 0.0  # angular velocity and acceleration
        ax, ay, az = self._fall  # acceleration of the origin less gravity
        handed = []
        for link, angle, rate, gain in zip(self._links, q, qd, qdd, strict=True):
            (a, b, c, d, e, f, g, h, i, px, py, pz, m, hx, hy, hz, xx, xy, xz, yy, yz, zz) = link
            co, si = cos(angle), sin(angle)
            # acceleration of the joint's origin, in the frame of the link before
            tx, ty, tz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
            ax += uy * pz - uz * py + wy * tz - wz * ty
            ay += uz * px - ux * pz + wz * tx - wx * tz
            az += ux * py - uy * px + wx * ty - wy * tx
            # into the frame of this link: constant matrix, then the turn about z
            tx, ty, tz = a * ax + d * ay + g * az, b * ax + e * ay + h * az, c * ax + f * ay + i * az
            ax, ay, az = co * tx + si * ty, co * ty - si * tx, tz
            tx, ty, tz = a * wx + d * wy + g * wz, b * wx + e * wy + h * wz, c * wx + f * wy + i * wz
            wx, wy, wz = co * tx + si * ty, co * ty - si * tx, tz + rate
            tx, ty, tz = a * ux + d * uy + g * uz, b * ux + e * uy + h * uz, c * ux + f * uy + i * uz
            ux, uy, uz = co * tx + si * ty + wy * rate, co * ty - si * tx - wx * rate, tz + gain
            # force m a + u x h + w x (w x h), moment I u + w x (I w) + h x a
            tx, ty, tz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
            sx, sy, sz = xx * wx + xy * wy + xz * wz, xy * wx + yy * wy + yz * wz, xz * wx + yz * wy + zz * wz
            handed.append(
                (
                    m * ax + uy * hz - uz * hy + wy * tz - wz * ty,
                    m * ay + uz * hx - ux * hz + wz * tx - wx * tz,
                    m * az + ux * hy - uy * hx + wx * ty - wy * tx,
                    xx * ux + xy * uy + xz * uz + wy * sz - wz * sy + hy * az - hz * ay,
                    xy * ux + yy * uy + yz * uz + wz * sx - wx * sz + hz * ax - hx * az,
                    xz * ux + yz * uy + zz * uz + wx * sy - wy * sx + hx * ay - hy * ax,
                    co,
                    si,
                )
            )
        return self._backward(handed)

    def _backward(self, handed: list[tuple[float, ...]]) -> list[float]:
        """Sum the wrenches from the last link to the first; the torque is the component about each axis."""
        out = [0.0] * len(handed)
        fx = fy = fz = nx = ny = nz = 0.0
        links = self._links
        for number in range(len(handed) - 1, -1, -1):
            ox, oy, oz, kx, ky, kz, co, si = handed[number]
            fx += ox
            fy += oy
            fz += oz
            nx += kx
            ny += ky
            nz += kz
            out[number] = nz
            (a, b, c, d, e, f, g, h, i, px, py, pz, *_) = links[number]
            tx, ty = co * fx - si * fy, si * fx + co * fy
            fx, fy, fz = a * tx + b * ty + c * fz, d * tx + e * ty + f * fz, g * tx + h * ty + i * fz
            tx, ty = co * nx - si * ny, si * nx + co * ny
            nx, ny, nz = (
                a * tx + b * ty + c * nz + py * fz - pz * fy,
                d * tx + e * ty + f * nz + pz * fx - px * fz,
                g * tx + h * ty + i * nz + px * fy - py * fx,
            )
        return out


def _link_constants(robot: Robot, phi: Floats, number: int) -> tuple[float, ...]:
    """Return rotation (9), origin (3), mass, first moment (3) and inertia (6) of a link; joint axis on z."""
    turn = _turn_to_z(robot.axis[number])
    before = np.eye(3) if number == 0 else _turn_to_z(robot.axis[number - 1])
    rotation = before.T @ robot.placement[number, :3, :3] @ turn
    origin = before.T @ robot.placement[number, :3, 3]
    mass, moment = phi[number, 0], turn.T @ phi[number, 1:4]
    xx, xy, xz, yy, yz, zz = phi[number, 4:]
    inertia = turn.T @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn
    upper = inertia[np.triu_indices(3)]
    return (*rotation.ravel().tolist(), *origin.tolist(), float(mass), *moment.tolist(), *upper.tolist())


def _turn_to_z(axis: Floats) -> Floats:
    """Return a rotation (3, 3) whose third column is `axis`."""
    if axis[0] == axis[1] == 0.0 and axis[2] > 0.0:
        return np.eye(3)
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])
