"""Estimate the compliance between the hands (gears of both arms and part) from completed cycles.

The stated stiffness is that of the stiffest direction. In other directions the gears are several times more compliant,
and a correction of the remaining force would be several times too small. Two cycles that were commanded differently
show by how much: the compliance at the slave's fingertip is that of the stated stiffness and of each joint's gear, `S =
inv(K) + sum_j c_j g_j g_j^T` with `g_j` the move of the fingertips against each other per turn of joint j, linear in
the c_j of all joints, none of which is negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from gateway.pair.transform import Floats, cross_matrix

#: Prior standard deviation of the compliance of a joint [rad/Nm].
USUAL_RAD_NM = 5e-5
#: Repeatability of servos and gears from cycle to cycle, rotations by `LEVER_M` [m]; its correlation length in SYNCs.
DISTANCE_REPEAT_M, CORRELATED_SYNCS = 5e-5, 10
#: Lever that converts rotations to lengths [m].
LEVER_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """Fingertip of an arm along its path: poses (M, 4, 4) and Jacobians (M, 6, N), base axes."""

    poses: Floats
    jacobian: Floats


class GearChain:
    """Compliance between the hands along a path.

    Parameters
    ----------
    hands : of master and slave
    bases : two arrays of shape (4, 4), bases of both arms in the world
    stiffness : array of shape (6,), stated: straight [N/m] and turned [Nm/rad]

    Attributes
    ----------
    joints_rad_nm : array of shape (J,)
        Estimated compliance of each joint in addition to the stated stiffness.
    """

    def __init__(self, hands: tuple[Hand, Hand], bases: tuple[Floats, Floats], stiffness: Floats) -> None:
        first, second = hands
        turn = bases[1][:3, :3].T @ bases[0][:3, :3]
        tips = [(base @ each.poses)[:, :3, 3] for base, each in zip(bases, hands, strict=True)]
        lever = (tips[1] - tips[0]) @ bases[1][:3, :3]
        one = np.concatenate([turn @ first.jacobian[:, :3], turn @ first.jacobian[:, 3:]], axis=1)
        one[:, :3] -= cross_matrix(lever) @ one[:, 3:]
        self._displacements = np.concatenate([one, second.jacobian], axis=2)
        self._plain = 1.0 / stiffness
        self._weight = np.repeat([1.0, LEVER_M], 3)
        joints = self._displacements.shape[2]
        self._information, self._sum = np.zeros((joints, joints)), np.zeros(joints)
        self._last: tuple[Floats, Floats] | None = None
        self.joints_rad_nm = np.zeros(joints)

    def move(self, wrench: Floats) -> Floats:
        """Return the slave hand's displacement (M, 6) [m, rad] for wrenches (M, 6) at its fingertip, base axes."""
        along = np.einsum("nij,ni->nj", self._displacements, wrench) * self.joints_rad_nm
        return wrench * self._plain + np.einsum("nij,nj->ni", self._displacements, along)

    def take(self, command: Floats, wrench: Floats) -> None:
        """Update the compliance from a completed cycle.

        Parameters
        ----------
        command : array of shape (M, 6)
            Of the slave's hand relative to any fixed one, base axes [m, rad].
        wrench : array of shape (M, 6)
            At its fingertip at the time of the command, base axes [N, Nm].
        """
        last, self._last = self._last, (command, wrench)
        if last is None:
            return
        moved, fallen = command - last[0], last[1] - wrench
        along = np.einsum("nij,ni->nj", self._displacements, fallen)
        columns = (self._displacements * along[:, None]) * self._weight[:, None]
        left = (moved - fallen * self._plain) * self._weight
        self._information += np.tensordot(columns, columns, ((0, 1), (0, 1)))
        self._sum += np.tensordot(columns, left, ((0, 1), (0, 1)))
        scale = 1.0 / (DISTANCE_REPEAT_M**2 * CORRELATED_SYNCS)
        root = np.linalg.cholesky(self._information * scale + np.eye(len(self._sum)) / USUAL_RAD_NM**2)
        self.joints_rad_nm = nnls(root.T, np.linalg.solve(root, self._sum * scale))[0]
