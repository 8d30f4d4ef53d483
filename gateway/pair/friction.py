"""Torque offset for the friction of one arm: what would otherwise shake a free hand whenever a joint turns round."""

from __future__ import annotations

from collections import deque

import numpy as np

from gateway.pair.cell import PairArm
from gateway.pair.transform import Floats

#: Joint speed at which dry friction has nearly reached its full size [rad/s].
TURNING_RAD_S = 0.003


class FrictionOffset:
    """Joint torque of the cell's friction constants, for the targets that the servos reach at this cycle.

    Parameters
    ----------
    arm : PairArm
    dt_s : control cycle
    lag_s : by which the axes follow their set points
    """

    def __init__(self, arm: PairArm, dt_s: float, lag_s: float) -> None:
        self._arm, self._dt_s = arm, dt_s
        self._targets: deque[Floats] = deque(maxlen=2 + round(lag_s / dt_s))

    def at(self, q_rad: Floats) -> Floats:
        """Torque (6,) [Nm] beside the next targets (6,) [rad]; zero at rest."""
        self._targets.append(q_rad)
        if len(self._targets) < 2:
            return np.zeros(6)
        speed = (self._targets[1] - self._targets[0]) / self._dt_s
        return self._arm.coulomb_nm * np.tanh(speed / TURNING_RAD_S) + self._arm.viscous_nm_s_rad * speed
