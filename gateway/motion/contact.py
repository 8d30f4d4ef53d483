"""Detect contact and drives that do not follow their setpoints, from unexplained torque and following error.

The model lacks the load, and friction and rotors that were not identified. The difference between measured and modelled
torque is therefore compared with its own recent mean: the load changes it slowly, contact changes it at once.
"""

from __future__ import annotations

import numpy as np

from gateway.errors import LimitExceeded
from gateway.motion.reactions import ARM_RULES
from gateway.motion.workspace import Workspace

#: Jump of the unexplained torque, as a share of the joint's torque limit; friction at a reversal is below half of it.
#: A gear that changes from driving to back-driven adds (1 / eta - eta) of the torque it carries.
CONTACT_SHARE = 0.25
#: The same for a joint with identified friction, rotor and links: the friction reversal is added by its size,
#: since the joint reverses later than its setpoints.
KNOWN_SHARE = 0.15
#: Number of consecutive SYNCs with the same sign: delayed setpoints make the torque oscillate.
IN_A_ROW = ARM_RULES["contact"].count
#: Time constant of the recent mean [s].
MEMORY_S = 0.5
#: A delayed SYNC makes the drives wait and start again: contact is not checked until the oscillation has decayed.
DELAY_GRACE_S = ARM_RULES["late_sync"].limit
#: After the brakes open, the drives take over the torque that the brakes have carried; nothing moves yet.
TAKE_OVER_S = 0.3
#: Commanded movement after which a joint has to follow, and the share of it that it has to move. A joint that lags at
#: speed and reverses has moved less, but is then close to its target.
FOLLOW_RAD = ARM_RULES["stays_behind"].limit
FOLLOW_SHARE = 0.2


class Contact:
    """Contact detection of one arm; one instance per run.

    Parameters
    ----------
    arm : str
        Name, for messages.
    workspace : Workspace
    period_s : float
        SYNC period.
    turning_nm : array of shape (N,), optional
        Change of each joint's friction torque at a reversal; NaN where not identified.
    """

    def __init__(self, arm: str, workspace: Workspace, period_s: float, turning_nm: np.ndarray | None = None) -> None:
        self._arm = arm
        self._share = min(period_s / MEMORY_S, 1.0)
        self._limit = CONTACT_SHARE * workspace.torque_nm
        if turning_nm is not None:
            self._limit = np.fmin(self._limit, KNOWN_SHARE * workspace.torque_nm + turning_nm)
        self._reversal = 1.0 / workspace.efficiency - workspace.efficiency
        self._mean = np.zeros_like(self._limit)
        self._take_over_syncs = self._taking_over = int(np.ceil(TAKE_OVER_S / period_s))
        self._grace_syncs = int(np.ceil(DELAY_GRACE_S / period_s))
        self._grace = 0
        self._count = np.zeros(len(self._limit), dtype=int)
        self._side = np.zeros_like(self._limit)
        self._from: tuple[np.ndarray, np.ndarray] | None = None
        #: Joints (bool, (N,)) that are not checked.
        self.excused = np.zeros(len(self._limit), dtype=bool)

    def excuse(self, joints: np.ndarray) -> None:
        """Exclude joints (bool, (N,)) from now on; a joint that is included again starts as after enabling."""
        if (self.excused & ~joints).any():
            self._taking_over = self._take_over_syncs
        self.excused = joints

    def note_delayed_sync(self) -> None:
        """Note a delayed SYNC: the arm oscillates at the next SYNCs."""
        self._grace = self._grace_syncs

    def check(self, q_rad: np.ndarray, torque_nm: np.ndarray, modelled_nm: np.ndarray, target_rad: np.ndarray) -> None:
        """Check one complete SYNC.

        Parameters
        ----------
        q_rad : array of shape (N,)
            Measured positions.
        torque_nm, modelled_nm : arrays of shape (N,)
            Joint side.
        target_rad : array of shape (N,)
            Setpoints of the drives.

        Raises
        ------
        LimitExceeded
            Contact is detected, or a joint does not follow.
        """
        self._check_following(q_rad, target_rad)
        unexplained_nm = torque_nm - modelled_nm
        if self._taking_over > 0:
            self._taking_over -= 1
            self._mean = unexplained_nm
            return
        if self._grace > 0:
            self._grace -= 1
            self._count[:] = 0
            self._mean = self._mean + self._share * (unexplained_nm - self._mean)
            return
        signed = unexplained_nm - self._mean
        jump = np.abs(signed)
        over = (jump > self._limit) & ~self.excused
        if over.any():
            carried = np.maximum(np.abs(torque_nm), np.abs(modelled_nm + self._mean))
            over &= jump > self._limit + self._reversal * carried
        if over.any():
            side = np.sign(signed) * over
            self._count = np.where(side == self._side, self._count + 1, 1) * over
            self._side = side
            if self._count.max() >= IN_A_ROW:
                joint = int(np.argmax(self._count))
                raise LimitExceeded(
                    f"arm '{self._arm}', joint {joint + 1}: the torque has jumped by {jump[joint]:.0f} Nm, more than"
                    f" the limit of {self._limit[joint]:.0f} Nm plus the effect of a reversal: "
                    f"{ARM_RULES['contact'].advice}",
                    joint=joint + 1,
                )
            return
        self._count[:] = 0
        self._mean = self._mean + self._share * (unexplained_nm - self._mean)

    def _check_following(self, q_rad: np.ndarray, target_rad: np.ndarray) -> None:
        if self._from is None:
            self._from = (q_rad.copy(), target_rad.copy())
            return
        start_q, start_target = self._from
        commanded = target_rad - start_target
        far = np.abs(commanded) > FOLLOW_RAD
        if not far.any():
            return
        done = (q_rad - start_q) * np.sign(commanded)
        now = np.abs(target_rad - q_rad) > (1.0 - FOLLOW_SHARE) * FOLLOW_RAD
        behind = far & now & (done < FOLLOW_SHARE * np.abs(commanded))
        if behind.any():
            joint = int(np.argmax(behind))
            raise LimitExceeded(
                f"arm '{self._arm}', joint {joint + 1} was commanded to move by {commanded[joint]:.3f} rad "
                f"but has moved by {q_rad[joint] - start_q[joint]:.3f} rad: "
                f"{ARM_RULES['stays_behind'].advice}",
                joint=joint + 1,
            )
        start_q[far], start_target[far] = q_rad[far], target_rad[far]
