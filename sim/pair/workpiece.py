"""The workpiece as a six-dimensional spring and damper between two grippers, handed to the joints as `J^T W`.

The nominal pose of gripper 2 is gripper 1 times the grasp; the part resists the deviation from it in position and
rotation. Between two exact evaluations the deviation follows the joints linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.pair.geometry import ArmGeometry, frames

Array = NDArray[np.float64]

#: Damping of the part against the effective mass between the grippers, share of critical.
DAMPING = 0.1


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Of the part: straight [N/m] and turned [Nm/rad]."""

    straight_n_m: float = 4.0e5
    turned_nm_rad: float = 4.0e3


def rotation_vector(rotation: Array) -> Array:
    """Rotation vector (3,) [rad] of a rotation (3, 3) by a small angle."""
    skew = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.sqrt(skew @ skew))
    return skew if sine < 1e-9 else skew * (np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0)) / sine)


@dataclass(slots=True)
class Closure:
    """Both grippers at one instant.

    Attributes
    ----------
    deviation : (6,) of gripper 2 from where gripper 1 and the part want it [m; rad], world axes
    jacobian : (6, J) its rate per joint speed; columns of arm 1, then of arm 2
    tips : fingertips (4, 4) in the world [m]
    q_rad : (J,) where it was evaluated
    """

    deviation: Array
    jacobian: Array
    tips: tuple[Array, Array]
    q_rad: Array


class Workpiece:
    """The part between two arms.

    Parameters
    ----------
    arms : true geometry of both
    stiffness : of the part
    """

    def __init__(self, arms: tuple[ArmGeometry, ArmGeometry], stiffness: Stiffness) -> None:
        axes = [len(arm.d_m) for arm in arms]
        self._axes = max(axes)
        self._slots = np.concatenate([self._axes * index + np.arange(count) for index, count in enumerate(axes)])
        both = [_lengthened(arm, self._axes) for arm in arms]
        self._both = ArmGeometry(
            *(np.stack([getattr(arm, name) for arm in both]) for name in ArmGeometry.__slots__)  # type: ignore[attr-defined]
        )
        self.grasp = np.eye(4)
        self.stiffness = np.repeat([stiffness.straight_n_m, stiffness.turned_nm_rad], 3)
        self.damping = np.zeros(6)
        self._kept: tuple[Array, Array] | None = None

    def grip(self, q_rad: Array) -> None:
        """Close both grippers free of force at joint angles (J,)."""
        first, second = self._both.base @ frames(self._both, self._each(q_rad))[:, -1] @ self._both.tool
        self.grasp = np.linalg.inv(first) @ second

    def let_go(self) -> None:
        """Open both grippers for good: no force from here on."""
        self.stiffness, self.damping = np.zeros(6), np.zeros(6)

    def open(self) -> None:
        """Open both grippers: no force until they close."""
        if self._kept is None:
            self._kept = self.stiffness, self.damping
            self.stiffness, self.damping = np.zeros(6), np.zeros(6)

    def close(self, q_rad: Array) -> None:
        """Close the grippers, if they are open, and grip afresh free of force at joint angles (J,)."""
        if self._kept is not None:
            (self.stiffness, self.damping), self._kept = self._kept, None
        self.grip(q_rad)

    def at(self, q_rad: Array) -> Closure:
        """Deviation and its Jacobian at joint angles (J,)."""
        both = self._both
        links = both.base[:, None] @ frames(both, self._each(q_rad))
        first, second = links[:, -1] @ both.tool
        wanted = first @ self.grasp
        deviation = np.empty(6)
        deviation[:3] = second[:3, 3] - wanted[:3, 3]
        deviation[3:] = rotation_vector(second[:3, :3] @ wanted[:3, :3].T)
        before = np.concatenate([both.base[:, None], links[:, :-1]], axis=1)
        axis = before[:, :, :3, 2]
        arm = np.stack([wanted[:3, 3], second[:3, 3]])[:, None] - before[:, :, :3, 3]
        rate = np.empty((6, 2, self._axes))
        rate[3:] = axis.transpose(2, 0, 1)
        for row, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
            rate[row] = axis[..., a] * arm[..., b] - axis[..., b] * arm[..., a]
        rate[:, 0] *= -1.0
        return Closure(deviation, rate.reshape(6, -1).take(self._slots, axis=1), (first, second), q_rad)

    def _each(self, q_rad: Array) -> Array:
        """Return joint angles (2, N) of each arm, padded with 0 for the shorter one."""
        each = np.zeros(2 * self._axes)
        each[self._slots] = q_rad
        return each.reshape(2, self._axes)

    def size_damping(self, mobility: Array) -> None:
        """Damping from the mobility (6, 6) between the grippers, `J M^-1 J^T`: of its largest mode, each kind."""
        for part in (slice(0, 3), slice(3, 6)):
            effective = 1.0 / float(np.linalg.eigvalsh(mobility[part, part])[-1])
            self.damping[part] = 2.0 * DAMPING * np.sqrt(self.stiffness[part] * effective)


def _lengthened(arm: ArmGeometry, axes: int) -> ArmGeometry:
    """Return the same arm, its table padded with identity rows."""
    none = np.zeros(axes - len(arm.d_m))
    return ArmGeometry(
        *(np.append(row, none) for row in (arm.d_m, arm.a_m, arm.alpha_rad, arm.zero_rad)),
        base=arm.base,
        tool=arm.tool,
    )
