"""Uncertainty of the constants of two arms, reduced by the torques measured while they carry a part together.

Of the twelve torques of two six-axis arms, six components depend on the internal force. The six others, and those of
any further axis, depend on the models of the arms alone. Their residual estimates friction, rotors and links during
normal operation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.pair.pair_cell import PairArm
from gateway.pair.transform import Floats

#: By which torques may be read later or earlier than positions, standard deviation [s].
DELAY_STD_S = 0.002
#: Shares of its stated value by which a constant may be off: dry friction of another day, what turns with the motor (a
#: drive that is read at the SYNC shows less of its acceleration), links by CAD.
COULOMB_SHARE, VISCOUS_SHARE, ROTOR_SHARE, LINK_SHARE = 0.25, 0.3, 0.15, 0.03
#: Constants of a joint whose torque follows from its measured motion, those of the path beside them, and of the part.
OF_MOTION, OF_PATH, OF_PART = 3, 2, 4
#: Standard deviation of a part's mass: share of it, and of one that is not stated [kg]; of where its weight acts [m].
PART_SHARE, UNKNOWN_KG, PART_OFF_M = 0.1, 5.0, 0.03
#: Forgetting factor per cycle: friction changes as arms get warm.
KEPT = 0.8
#: Correlation length of the unexplained torque, in SYNCs.
CORRELATED_SYNCS = 10


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyColumns:
    """Torque (M, J) [Nm] per standard deviation of each uncertain constant, of the J joints of both arms.

    Attributes
    ----------
    along : array of shape (M, J, 2 J + 4)
        Links, delays and the part, along the nominal path.
    coulomb_nm, viscous_nm_s_rad, rotor_kg_m2 : arrays of shape (J,)
        One standard deviation of each.
    """

    along: Floats
    coulomb_nm: Floats
    viscous_nm_s_rad: Floats
    rotor_kg_m2: Floats

    def of(self, turned: Floats, speed_rad_s: Floats, acceleration_rad_s2: Floats) -> Floats:
        """Return all columns (M, J, K) of a motion (M, J)."""
        joints = len(self.coulomb_nm)
        every = np.arange(joints)
        out = np.zeros((*turned.shape, constants_of(joints)))
        out[:, every, every] = self.coulomb_nm * turned
        out[:, every, joints + every] = self.viscous_nm_s_rad * speed_rad_s
        out[:, every, 2 * joints + every] = self.rotor_kg_m2 * acceleration_rad_s2
        out[:, :, OF_MOTION * joints :] = self.along
        return out

    def torque(self, m: int, by: Floats, turned: Floats, speed_rad_s: Floats, acceleration_rad_s2: Floats) -> Floats:
        """Return the torque (J,) caused by deviations `by` (K,) of the constants at row m."""
        joints = len(turned)
        return (
            self.coulomb_nm * turned * by[:joints]
            + self.viscous_nm_s_rad * speed_rad_s * by[joints : 2 * joints]
            + self.rotor_kg_m2 * acceleration_rad_s2 * by[2 * joints : OF_MOTION * joints]
            + self.along[m] @ by[OF_MOTION * joints :]
        )


def constants_of(joints: int) -> int:
    """Return the number K of constants of two arms with J joints in total and their part."""
    return (OF_MOTION + OF_PATH) * joints + OF_PART


def columns_of(
    arms: tuple[PairArm, PairArm], motions: tuple[tuple[Floats, Floats, Floats], ...], dt_s: float, part: Floats
) -> UncertaintyColumns:
    """UncertaintyColumns of a motion of both arms.

    Parameters
    ----------
    arms : two PairArm
    motions : angles, speeds and accelerations (M, N) of each
    dt_s : between rows
    part : array of shape (M, J, 4), columns of the part
    """
    shape = part.shape[:2]
    along: list[Floats] = []
    first = 0
    for arm, motion in zip(arms, motions, strict=True):
        for rows in arm.link_torques(*motion):
            column = np.zeros(shape)
            column[:, first : first + arm.axes] = LINK_SHARE * rows
            along.append(column)
        rate = np.gradient(arm.model_torque(*motion), dt_s, axis=0)
        for axis in range(arm.axes):
            column = np.zeros(shape)
            column[:, first + axis] = DELAY_STD_S * rate[:, axis]
            along.append(column)
        first += arm.axes
    return UncertaintyColumns(
        np.concatenate([np.stack(along, axis=2), part], axis=2),
        COULOMB_SHARE * np.concatenate([arm.coulomb_nm for arm in arms]),
        VISCOUS_SHARE * np.concatenate([arm.viscous_nm_s_rad for arm in arms]),
        ROTOR_SHARE * np.concatenate([arm.rotor_kg_m2 for arm in arms]),
    )


def part_uncertainty(share_per_kg: Floats, mass_kg: float) -> Floats:
    """Wrenches (M, 6, 4) on one hand about the part's centre, per standard deviation of its mass and weight's place.

    Parameters
    ----------
    share_per_kg : array of shape (M, 6)
        What half a part of 1 kg does to this hand.
    mass_kg : 0 = not stated
    """
    out = np.zeros((len(share_per_kg), 6, 4))
    out[:, :, 0] = share_per_kg * (PART_SHARE * mass_kg or UNKNOWN_KG)
    for axis, unit in enumerate(np.eye(3), start=1):
        out[:, 3:, axis] = np.cross(unit, share_per_kg[:, :3]) * PART_OFF_M * (mass_kg or UNKNOWN_KG)
    return out


class ModelUncertainty:
    """Constants of both arms in standard deviations from the values of the cell file, with their covariance.

    Parameters
    ----------
    count : int
        How many, K.

    Attributes
    ----------
    value : array of shape (K,)
    covariance : array of shape (K, K)
    """

    def __init__(self, count: int) -> None:
        self._information, self._sum = np.zeros((count, count)), np.zeros(count)
        self.value, self.covariance = np.zeros(count), np.eye(count)

    def learn(self, columns: Floats, torque_nm: Floats, force: Floats, std_nm: Floats) -> None:
        """Update from one trajectory.

        Parameters
        ----------
        columns : array of shape (n, J, K)
        torque_nm : array of shape (n, J)
            External torque by the cell's constants, the part's share taken off.
        force : array of shape (n, J, 6)
            Torque per wrench inside the part, which may be any.
        std_nm : array of shape (n, J)
            Of what neither explains.
        """
        columns, torque_nm, force = columns / std_nm[..., None], torque_nm / std_nm, force / std_nm[..., None]
        basis = np.linalg.qr(force)[0]
        seen = np.einsum("nij,nik->njk", basis, columns)
        left = np.einsum("nij,ni->nj", basis, torque_nm)
        information = np.tensordot(columns, columns, ((0, 1), (0, 1))) - np.tensordot(seen, seen, ((0, 1), (0, 1)))
        total = np.tensordot(columns, torque_nm, ((0, 1), (0, 1))) - np.tensordot(seen, left, ((0, 1), (0, 1)))
        self._information = KEPT * self._information + information / CORRELATED_SYNCS
        self._sum = KEPT * self._sum + total / CORRELATED_SYNCS
        self.covariance = np.linalg.inv(np.eye(len(self.value)) + self._information)
        self.value = self.covariance @ self._sum
