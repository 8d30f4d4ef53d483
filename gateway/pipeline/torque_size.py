"""Compare the torques of a table with the weight of the links, to detect a wrong torque unit."""

from __future__ import annotations

from typing import Final

import numpy as np

from gateway.data.table import Table
from gateway.errors import InputError
from gateway.identify.links import PER_LINK_AT_REST, has_inertials, link_values
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot

#: Share of the gravity torque of the links below which the unit must be wrong; arms with balancers are above it.
LEAST_SHARE: Final = 1.0 / 30.0


def refuse_small_torques(table: Table, robot: Robot, gravity_m_s2: tuple[float, float, float]) -> None:
    """Refuse joint torques that are far below the gravity torque of the links.

    Raises
    ------
    InputError
        The torques are too small; the message names the ratio and the likely units.
    """
    at_rest = table.take(~table.moving)
    if not has_inertials(robot) or not len(at_rest.load):
        return
    links = link_values(robot)[:, :PER_LINK_AT_REST].ravel()
    needed_nm = gravity_regressor(robot, at_rest.q_rad, gravity_m_s2) @ links
    measured = np.isfinite(at_rest.tau_nm)
    square = float(np.sum(at_rest.tau_nm[measured] ** 2))
    share = np.sqrt(square / max(float(np.sum(needed_nm[measured] ** 2)), 1e-12))
    if share < LEAST_SHARE:
        raise InputError(
            f"{at_rest.file[0]}: the torques are {100 * share:.2g} % of the gravity torque of the links: they may be"
            " in kNm, of the motors, or currents in A. Use column tauN_nm for joint torque [Nm], taumN_nm for motor"
            " torque [Nm], iN_a for current [A]"
        )
