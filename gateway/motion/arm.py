"""Joint-side view of the drives of one arm: joint setpoints out, one sample per SYNC in."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drives.drive import DriveCommand
from drives.epoch import Epoch
from drives.group import DriveGroup
from gateway.cell.conversion import AxisConversion
from gateway.data.visit import ArmSample
from gateway.feedforward.identified import AxisConstants


class JointSide:
    """Convert the answers of the drives to the joint side.

    Parameters
    ----------
    axes : AxisConversion
    """

    def __init__(self, axes: AxisConversion) -> None:
        self._to_joint = np.diag(axes.position_sign / axes.ratio) @ np.linalg.inv(axes.coupling).T
        self._to_torque = np.diag(axes.torque_sign * axes.ratio) @ axes.coupling
        self._zero = axes.zero_offset_rad

    def sample(self, epoch: Epoch) -> ArmSample:
        """Return the sample of one SYNC; NaN for a drive that did not answer."""
        motor = np.array([(np.nan, np.nan) if r is None else (r.position_rad, r.torque_nm) for r in epoch.readings])
        q_rad = motor[:, 0] @ self._to_joint + self._zero
        torque_nm = motor[:, 1] @ self._to_torque
        return ArmSample(epoch.sync_index, epoch.time_s, q_rad, torque_nm, epoch.readings, epoch.instruments)


class Arm:
    """Joint-side view of a drive group.

    Parameters
    ----------
    name : str
    drives : DriveGroup
        Connected and configured.
    axes : AxisConversion
    known : tuple of AxisConstants, optional
        Rotors and friction, where they are known.
    """

    def __init__(
        self, name: str, drives: DriveGroup, axes: AxisConversion, known: tuple[AxisConstants, ...] = ()
    ) -> None:
        self.name = name
        self.known = known
        self.axes = axes
        self.drives = drives
        self._sample = JointSide(axes).sample

    def where(self) -> np.ndarray:
        """Return the joint positions (N,) [rad] of the arm with its brakes on."""
        return self.axes.joint_position(np.array(self.drives.positions_rad()))

    def enable(self, stop_requested: Callable[[], bool] = lambda: False) -> ArmSample:
        """Enable the drives; they hold their present positions."""
        return self._sample(self.drives.enable(stop_requested))

    def disable(self) -> None:
        """Apply the brakes and disable the drives."""
        self.drives.disable()

    def quick_stop(self) -> None:
        """Stop with the quick stop ramps of the drives."""
        self.drives.quick_stop()

    def brake_drop_rad(self) -> np.ndarray:
        """Return how far each joint (N,) [rad] has moved since the drives were disabled."""
        return self.axes.joint_bound(np.array(self.drives.brake_drop_rad))

    def command(
        self, q_rad: np.ndarray, ahead_rad: np.ndarray | None = None, offset_nm: np.ndarray | None = None
    ) -> Sequence[DriveCommand]:
        """Return the drive targets for joint positions (N,) [rad].

        Parameters
        ----------
        q_rad : array of shape (N,)
        ahead_rad : array of shape (N,), optional
            Setpoint of the next SYNC, if known; for arms with feedforward.
        offset_nm : array of shape (N,), optional
            Joint torque that the drives add to the output of their own controller.
        """
        del ahead_rad
        motor = self.axes.motor_position(q_rad).tolist()
        if offset_nm is None:
            return [DriveCommand(value) for value in motor]
        torque = self.axes.motor_torque(offset_nm).tolist()
        return [DriveCommand(value, nm) for value, nm in zip(motor, torque, strict=True)]

    def exchange(self, commands: Sequence[DriveCommand]) -> ArmSample:
        """Exchange one SYNC with targets of `command`."""
        return self._sample(self.drives.exchange(commands))

    def hold(self) -> ArmSample:
        """Exchange one SYNC with the last targets."""
        return self._sample(self.drives.hold())

    def checked(self, epoch: Epoch) -> ArmSample:
        """Return the samples of a SYNC shared with other arms; raise the errors that they show."""
        self.drives.check(epoch)
        return self._sample(epoch)
