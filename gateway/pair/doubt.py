"""What the cell does not say exactly of two arms, and what their torques say of it while they carry a part together.

Twelve torques hold six numbers of the force inside the part; the six others belong to both arms' models alone. What is
not in balance there tells friction, rotors and links by the way, without any motion for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.pair.cell import PairArm
from gateway.pair.transform import Floats

#: By which torques may be read later or earlier than positions, standard deviation [s].
LATE_S = 0.002
#: Shares of its stated value by which a constant may be off: dry friction of another day, what turns with the motor (a
#: drive that is read at the SYNC shows less of its acceleration), links by CAD.
COULOMB_SHARE, VISCOUS_SHARE, ROTOR_SHARE, LINK_SHARE = 0.25, 0.3, 0.15, 0.03
#: Joints of both arms; constants whose torque follows from the measured motion, and those of the path beside them.
JOINTS = 12
MOVING, CONSTANTS = 3 * JOINTS, 5 * JOINTS + 4
#: Standard deviation of a part's mass: share of it, and of one that is not stated [kg]; of where its weight acts [m].
PART_SHARE, UNKNOWN_KG, PART_OFF_M = 0.1, 5.0, 0.03
#: What each cycle leaves of what was told before: friction changes as arms get warm.
KEPT = 0.8
#: SYNCs over which what no column explains stays alike.
ALIKE_SYNCS = 10


@dataclass(frozen=True, slots=True, eq=False)
class DoubtColumns:
    """Torque (M, 12) [Nm] per standard deviation of what is not known exactly.

    Attributes
    ----------
    along : array of shape (M, 12, 28)
        Links, delays and the part, along the nominal path.
    coulomb_nm, viscous_nm_s_rad, rotor_kg_m2 : arrays of shape (12,)
        One standard deviation of each.
    """

    along: Floats
    coulomb_nm: Floats
    viscous_nm_s_rad: Floats
    rotor_kg_m2: Floats

    def of(self, turned: Floats, speed_rad_s: Floats, acceleration_rad_s2: Floats) -> Floats:
        """All columns (M, 12, K) of a motion (M, 12)."""
        every = np.arange(JOINTS)
        out = np.zeros((*turned.shape, CONSTANTS))
        out[:, every, every] = self.coulomb_nm * turned
        out[:, every, 12 + every] = self.viscous_nm_s_rad * speed_rad_s
        out[:, every, 24 + every] = self.rotor_kg_m2 * acceleration_rad_s2
        out[:, :, MOVING:] = self.along
        return out

    def torque(self, m: int, by: Floats, turned: Floats, speed_rad_s: Floats, acceleration_rad_s2: Floats) -> Floats:
        """Torque (12,) of the constants `by` (K,) at row m."""
        return (
            self.coulomb_nm * turned * by[:12]
            + self.viscous_nm_s_rad * speed_rad_s * by[12:24]
            + self.rotor_kg_m2 * acceleration_rad_s2 * by[24:36]
            + self.along[m] @ by[MOVING:]
        )


def columns_of(
    arms: tuple[PairArm, PairArm], motions: tuple[tuple[Floats, Floats, Floats], ...], dt_s: float, part: Floats
) -> DoubtColumns:
    """DoubtColumns of a motion of both arms.

    Parameters
    ----------
    arms : two PairArm
    motions : angles, speeds and accelerations (M, 6) of each
    dt_s : between rows
    part : array of shape (M, 12, 4), columns of the part
    """
    count = len(motions[0][0])
    along: list[Floats] = []
    for index, (arm, motion) in enumerate(zip(arms, motions, strict=True)):
        for rows in arm.link_torques(*motion):
            column = np.zeros((count, JOINTS))
            column[:, 6 * index : 6 * index + 6] = LINK_SHARE * rows
            along.append(column)
        rate = np.gradient(arm.model_torque(*motion), dt_s, axis=0)
        for axis in range(6):
            column = np.zeros((count, JOINTS))
            column[:, 6 * index + axis] = LATE_S * rate[:, axis]
            along.append(column)
    return DoubtColumns(
        np.concatenate([np.stack(along, axis=2), part], axis=2),
        COULOMB_SHARE * np.concatenate([arm.coulomb_nm for arm in arms]),
        VISCOUS_SHARE * np.concatenate([arm.viscous_nm_s_rad for arm in arms]),
        ROTOR_SHARE * np.concatenate([arm.rotor_kg_m2 for arm in arms]),
    )


def part_doubts(share_per_kg: Floats, mass_kg: float) -> Floats:
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


class Doubts:
    """Constants of both arms in standard deviations from what the cell says, and how well they are known.

    Attributes
    ----------
    value : array of shape (K,)
    covariance : array of shape (K, K)
    """

    def __init__(self, count: int = CONSTANTS) -> None:
        self._told, self._sum = np.zeros((count, count)), np.zeros(count)
        self.value, self.covariance = np.zeros(count), np.eye(count)

    def learn(self, columns: Floats, torque_nm: Floats, force: Floats, std_nm: Floats) -> None:
        """Take in one way.

        Parameters
        ----------
        columns : array of shape (n, 12, K)
        torque_nm : array of shape (n, 12)
            External torque by the cell's constants, the part's share taken off.
        force : array of shape (n, 12, 6)
            Torque per wrench inside the part, which may be any.
        std_nm : array of shape (n, 12)
            Of what neither explains.
        """
        columns, torque_nm, force = columns / std_nm[..., None], torque_nm / std_nm, force / std_nm[..., None]
        basis = np.linalg.qr(force)[0]
        seen = np.einsum("nij,nik->njk", basis, columns)
        left = np.einsum("nij,ni->nj", basis, torque_nm)
        told = np.tensordot(columns, columns, ((0, 1), (0, 1))) - np.tensordot(seen, seen, ((0, 1), (0, 1)))
        total = np.tensordot(columns, torque_nm, ((0, 1), (0, 1))) - np.tensordot(seen, left, ((0, 1), (0, 1)))
        self._told = KEPT * self._told + told / ALIKE_SYNCS
        self._sum = KEPT * self._sum + total / ALIKE_SYNCS
        self.covariance = np.linalg.inv(np.eye(len(self.value)) + self._told)
        self.value = self.covariance @ self._sum
