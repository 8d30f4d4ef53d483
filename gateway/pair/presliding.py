"""Dry friction of an arm at reversals (presliding): its direction, and the torque offset that compensates it."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from gateway.pair.pair_cell import PairArm
from gateway.pair.transform import Floats

#: Angle by which a joint has to turn until dry friction has reached two thirds of its full size [rad].
PRESLIDING_RAD = 5e-5
#: The same for the torque that makes up for it, sooner: the gear is wound up before the joint turns [rad].
OFFSET_RAD = 1e-5
#: A joint slower than this is at rest [rad/s]. It may hold its friction, or the drive releases it, by an integrator or
#: by trembling: no more than this share is counted on, after this time [s].
REST_SPEED_RAD_S, REST_SHARE, LET_GO_S = 2e-4, 0.5, 0.1


def dahl(turned: Floats, moved_rad: Floats, over_rad: float) -> Floats:
    """Return the share of dry friction (n,), from -1 to 1, after displacements (n,) [rad]: Dahl's model.

    Over a displacement d towards s it moves by the share `1 - exp(-d/over_rad)` of the difference to s.
    """
    towards = np.sign(moved_rad)
    return towards - (towards - turned) * np.exp(-np.abs(moved_rad) / over_rad)


class Presliding:
    """Direction of dry friction of n joints, from their displacement since the last reversal.

    The speed of a joint does not matter: friction stays constant until the joint is at rest. Then half of it is
    uncertain.

    Parameters
    ----------
    joints : n
    dt_s : between two moves

    Attributes
    ----------
    turned : array of shape (n,)
        From -1 to 1; 0 = direction unknown.
    """

    def __init__(self, joints: int, dt_s: float) -> None:
        self.turned = np.zeros(joints)
        self._at_rest_rad, self._lost = REST_SPEED_RAD_S * dt_s, 1.0 - math.exp(-dt_s / LET_GO_S)

    def move(self, moved_rad: Floats) -> None:
        """Update with the displacements (n,) [rad] of the joints."""
        turned, displacement = dahl(self.turned, moved_rad, PRESLIDING_RAD), np.abs(moved_rad)
        surplus = turned - np.clip(turned, -REST_SHARE, REST_SHARE)
        self.turned = turned - np.where(displacement < self._at_rest_rad, self._lost * surplus, 0.0)


class FrictionOffset:
    """Joint torque of the cell's friction constants, for the targets that the servos reach at this cycle.

    A joint that comes to rest keeps its offset, because friction keeps its direction until the targets reverse.

    Parameters
    ----------
    arm : PairArm
    dt_s : control cycle
    lag_s : by which the axes follow their setpoints
    """

    def __init__(self, arm: PairArm, dt_s: float, lag_s: float) -> None:
        self._arm, self._dt_s = arm, dt_s
        self._targets: deque[Floats] = deque(maxlen=2 + round(lag_s / dt_s))
        self._turned = np.zeros_like(arm.coulomb_nm)

    def at(self, q_rad: Floats) -> Floats:
        """Torque (N,) [Nm] beside the next targets (N,) [rad]; zero before the first move."""
        self._targets.append(q_rad)
        if len(self._targets) < 2:
            return np.zeros_like(q_rad)
        displacement = self._targets[1] - self._targets[0]
        self._turned = dahl(self._turned, displacement, OFFSET_RAD)
        return self._arm.coulomb_nm * self._turned + self._arm.viscous_nm_s_rad * displacement / self._dt_s
