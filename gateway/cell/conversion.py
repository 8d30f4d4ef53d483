"""Pure conversion between the motor side and the joint side of one arm.

With motor position p, motor torque t and, per axis, gear ratio N, position sign sp, torque sign st:

    theta = sp p / N            position at the gear output
    f = st N t                  torque at the gear output, gear losses not included
    q = A^-1 theta + q0         joint position,  q0 = zero_offset_rad
    tau = A^T f                 joint torque (power is the same on both sides: f . theta' = tau . q')

A gear loses what it transmits: where the motor drives, f is N eta t; where it is driven back, N t / eta. At rest the
side is that of the last motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.cell.config import ArmConfig


@dataclass(frozen=True, slots=True)
class AxisConversion:
    """Gears and couplings between the motors and the joints of an arm with N axes.

    Attributes
    ----------
    ratio : array of shape (N,)
        Gear ratio N, negative where the gear turns the sense round.
    efficiency : array of shape (N,)
        Gear efficiency eta in (0, 1].
    position_sign, torque_sign : arrays of shape (N,)
        +1 or -1.
    zero_offset_rad : array of shape (N,)
        Joint angle at which the drives' positions are zero.
    torque_constant_nm_per_a : array of shape (N,)
    coupling : array of shape (N, N)
        A of theta = A (q - q0), ratios not included.
    """

    ratio: np.ndarray
    efficiency: np.ndarray
    position_sign: np.ndarray
    torque_sign: np.ndarray
    zero_offset_rad: np.ndarray
    torque_constant_nm_per_a: np.ndarray
    coupling: np.ndarray

    @classmethod
    def from_arm(cls, arm: ArmConfig) -> AxisConversion:
        """Return the conversion of a configured arm."""
        return cls(
            ratio=np.array([axis.gear_ratio.value for axis in arm.axis]),
            efficiency=np.array([axis.gear_efficiency.value for axis in arm.axis]),
            position_sign=np.array([axis.position_sign for axis in arm.axis], dtype=float),
            torque_sign=np.array([axis.torque_sign for axis in arm.axis], dtype=float),
            zero_offset_rad=np.array([axis.zero_offset_rad for axis in arm.axis]),
            torque_constant_nm_per_a=np.array([axis.torque_constant_nm_per_a.value for axis in arm.axis]),
            coupling=np.eye(len(arm.axis)) if arm.coupling is None else np.array(arm.coupling, dtype=float),
        )

    def joint_position(self, motor_rad: np.ndarray) -> np.ndarray:
        """Return the joint positions (..., N) [rad] of motor positions (..., N) [rad]."""
        return self.joint_velocity(motor_rad) + self.zero_offset_rad

    def joint_velocity(self, motor_rad_s: np.ndarray) -> np.ndarray:
        """Return the joint velocities (..., N) [rad/s] of motor velocities (..., N) [rad/s]."""
        return (motor_rad_s * (self.position_sign / self.ratio)) @ np.linalg.inv(self.coupling).T

    def joint_bound(self, motor: np.ndarray) -> np.ndarray:
        """Most (..., N) that each joint moves where each motor moves by so much (..., N), to either side.

        Displacements, speeds or accelerations: rad, rad/s, rad/s2.
        """
        return (np.abs(motor) / np.abs(self.ratio)) @ np.abs(np.linalg.inv(self.coupling)).T

    def motor_position(self, joint_rad: np.ndarray) -> np.ndarray:
        """Return the motor positions (..., N) [rad] of joint positions (..., N) [rad]."""
        return self.motor_velocity(joint_rad - self.zero_offset_rad)

    def motor_velocity(self, joint_rad_s: np.ndarray) -> np.ndarray:
        """Return the motor velocities (..., N) [rad/s] of joint velocities (..., N) [rad/s]."""
        return (joint_rad_s @ self.coupling.T) * (self.position_sign * self.ratio)

    def gear_velocity(self, joint_rad_s: np.ndarray) -> np.ndarray:
        """Return the velocities at the gear outputs (..., N) [rad/s] of joint velocities (..., N) [rad/s]."""
        return joint_rad_s @ self.coupling.T

    def motor_torque_of_current(self, current_a: np.ndarray) -> np.ndarray:
        """Return the motor torque (..., N) [Nm] of motor current (..., N) [A]: torque = Kt i (JP3698770B2)."""
        return current_a * self.torque_constant_nm_per_a

    def joint_torque(self, motor_torque_nm: np.ndarray) -> np.ndarray:
        """Joint torque without gear losses, A^T (st N t).

        Parameters
        ----------
        motor_torque_nm : array of shape (..., N)
            NaN = not measured.

        Returns
        -------
        array of shape (..., N)
            NaN where a motor that acts on the joint was not measured.
        """
        return _mix(motor_torque_nm * (self.torque_sign * self.ratio), self.coupling)

    def joint_torque_by_direction(self, motor_torque_nm: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Joint torque with the gear efficiency of the side each gear was last driven from.

        Parameters
        ----------
        motor_torque_nm : array of shape (..., N)
        direction : array of shape (..., N)
            Sign of each joint's last motion; where it is 0 the side is unknown and no efficiency is applied.

        Returns
        -------
        array of shape (..., N)
            A^T f with f = N eta t where torque and motion agree (driving) and N t / eta where they oppose.
        """
        output_nm = motor_torque_nm * (self.torque_sign * self.ratio)
        side = np.sign(output_nm * self.gear_velocity(np.asarray(direction, dtype=float)))
        return _mix(output_nm * self.efficiency ** np.nan_to_num(side), self.coupling)

    def joint_torque_std(self, motor_torque_std_nm: np.ndarray) -> np.ndarray:
        """Standard deviation of the joint torque (..., N) from that of independent motors (..., N) [Nm]."""
        variance = (motor_torque_std_nm * np.abs(self.ratio)) ** 2
        return np.sqrt(_mix(variance, self.coupling**2))

    def motor_torque(self, joint_torque_nm: np.ndarray) -> np.ndarray:
        """Motor torque (..., N) [Nm] that holds joint torques (..., N) [Nm] over loss-free gears."""
        return (joint_torque_nm @ np.linalg.inv(self.coupling)) * (self.torque_sign / self.ratio)


def _mix(output: np.ndarray, coupling: np.ndarray) -> np.ndarray:
    """Return A^T times the output torques, NaN only where a NaN contributes."""
    known = np.isfinite(output)
    mixed = np.where(known, output, 0.0) @ coupling
    missing = (~known).astype(float) @ (coupling != 0).astype(float) > 0
    return np.where(missing, np.nan, mixed)
