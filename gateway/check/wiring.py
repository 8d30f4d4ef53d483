"""Hypotheses of how an arm is wired (order of drives, signs, gear ratios, torque scales), and the joint values under
each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.cell.conversion import AxisConversion
from gateway.model.robot import Robot

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Motor-side means at rest, each posture approached in both directions.

    Attributes
    ----------
    motor_rad, motor_nm : arrays of shape (n, 2, N)
        Values by drive; first the approach with all joints decreasing, then increasing.
    """

    motor_rad: Floats
    motor_nm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class WiredArm:
    """Known properties of the arm.

    Attributes
    ----------
    robot : Robot
    gravity_m_s2 : array of shape (3,)
    axes : AxisConversion
        Conversion of the cell file.
    torque_limit_nm : array of shape (N,)
    trust : float
        Relative standard deviation of the links' masses.
    load_kg : float
        Standard deviation of the unknown load's mass.
    """

    robot: Robot
    gravity_m_s2: Floats
    axes: AxisConversion
    torque_limit_nm: Floats
    trust: float
    load_kg: float


@dataclass(frozen=True, slots=True)
class Wiring:
    """Difference of the arm from the cell file.

    Attributes
    ----------
    name : str
        `as_stated`, `reversed` (position and torque), `position_reversed`, `torque_reversed`, `swapped`, `gear_ratio`,
        `torque_scale`.
    joints : tuple of int
        From 1.
    factor : float
        Gear ratio of the cell file divided by the true one; reported divided by true torque.
    """

    name: str
    joints: tuple[int, ...] = ()
    factor: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Interpretation of the motor values under a wiring: order of the drives, conversion, torque factor."""

    order: NDArray[np.int64]
    axes: AxisConversion
    torque_factor: Floats
    #: Torque factor per axis, relative to the interpretation of the cell file.
    scale: Floats

    @classmethod
    def stated(cls, axes: AxisConversion) -> Reading:
        """Return the interpretation of the cell file."""
        count = len(axes.ratio)
        return cls(np.arange(count), axes, np.ones(count), np.ones(count))

    def with_wiring(self, wiring: Wiring) -> Reading:
        """Return the interpretation of the motor values with one additional wiring difference."""
        at = [joint - 1 for joint in wiring.joints]
        if wiring.name == "swapped":
            order = self.order.copy()
            order[at] = order[at[::-1]]
            return replace(self, order=order)
        axes, torque, scale = self.axes, self.torque_factor.copy(), self.scale.copy()
        signs = np.ones_like(scale)
        signs[at] = -1.0
        if wiring.name in ("reversed", "position_reversed"):
            axes = replace(axes, position_sign=axes.position_sign * signs)
        if wiring.name in ("reversed", "torque_reversed"):
            axes = replace(axes, torque_sign=axes.torque_sign * signs)
        if wiring.name == "gear_ratio":
            ratio = axes.ratio.copy()
            ratio[at] /= wiring.factor
            axes = replace(axes, ratio=ratio)
        if wiring.name == "torque_scale":
            torque[at] *= wiring.factor
        if wiring.name in ("gear_ratio", "torque_scale"):
            scale[at] *= wiring.factor
        return replace(self, axes=axes, torque_factor=torque, scale=scale)

    def joints(self, moves: Moves, stated: AxisConversion) -> tuple[Floats, Floats, Floats]:
        """Return joint angles, half-sums of the two approaches, and half-differences along the motion, (n, N) each.

        The half-difference is computed without the gear efficiency: friction and gear losses both make it positive.
        """
        position, torque = moves.motor_rad[..., self.order], moves.motor_nm[..., self.order] / self.torque_factor
        up = np.sign(self.axes.joint_velocity(stated.motor_velocity(np.ones(len(self.order)))[self.order]))
        sides = [self.axes.joint_torque_by_direction(torque[:, side], sense * up) for side, sense in enumerate((-1, 1))]
        band = self.axes.joint_torque(torque[:, 1] - torque[:, 0]) / 2.0 * up
        return self.axes.joint_position(position.mean(axis=1)), (sides[0] + sides[1]) / 2.0, band
