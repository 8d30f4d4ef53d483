"""Model of the torque of an arm's motion besides gravity: identified friction, rotors and links.

Contact detection compares measured with modelled torque. The motion is taken from the setpoints; the servo lag and the
load are not modelled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.cell.conversion import AxisConversion
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.identified import AxisConstants, Known
from gateway.feedforward.law import TURN_ROUND_RAD
from gateway.identify.links import body_parameters
from gateway.motion.arm import Arm
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]


class OwnTorque:
    """Friction and inertia torque of one arm, updated with every setpoint.

    Parameters
    ----------
    known : tuple of AxisConstants
        Constants; only axes with identified friction and rotor are used.
    axes : AxisConversion
    workspace : Workspace
        Links of its robot; an unknown link adds no torque.
    period_s : float
        SYNC period.

    Attributes
    ----------
    turning_nm : array of shape (N,)
        Largest change of each joint's friction torque at a reversal; NaN where not identified.
    """

    def __init__(
        self, known: tuple[AxisConstants, ...], axes: AxisConversion, workspace: Workspace, period_s: float
    ) -> None:
        used = np.array([watched(axis) for axis in known])
        self._coupling, self._period_s, self._used = axes.coupling, period_s, used
        self._coulomb = _of(used, [axis.coulomb_nm for axis in known])
        self._viscous = _of(used, [axis.viscous_nm_s_rad for axis in known])
        self._rotor = _of(used, [axis.rotor_kg_m2 for axis in known])
        self._links = _dynamics(workspace)
        peak = np.fmax(self._coulomb, [axis.breakaway_nm for axis in known])
        weight = np.abs(axes.coupling)
        identified = ~(weight[~used] > 0.0).any(axis=0)
        self.turning_nm = np.where(identified, 2.0 * peak @ weight, np.nan)
        self._identified = identified
        self._at: Floats | None = None
        self._rate = self._sense = np.zeros_like(self._rotor)
        self._change = np.zeros_like(self._rotor)

    def take(self, target_rad: Floats) -> None:
        """Update the motion with the setpoints (N,) [rad] of the next SYNC."""
        before = target_rad if self._at is None else self._at
        displacement = self._coupling @ (target_rad - before)
        rate = (target_rad - before) / self._period_s
        self._at, self._rate, self._change = target_rad, rate, (rate - self._rate) / self._period_s
        self._sense = np.clip(self._sense + displacement / TURN_ROUND_RAD, -1.0, 1.0)

    @property
    def friction_nm(self) -> Floats:
        """Return the friction torque (N,) [Nm] at the joints."""
        return (self._coulomb * self._sense + self._viscous * (self._coupling @ self._rate)) @ self._coupling

    @property
    def inertia_nm(self) -> Floats:
        """Return the inertia torque (N,) [Nm] of identified rotors and links at the joints."""
        if self._at is None or not self._identified.any():
            return np.zeros_like(self._rate)
        rotors = (self._rotor * (self._coupling @ self._change)) @ self._coupling
        if self._links is not None:
            rotors = rotors + self._links.torque(self._at.tolist(), self._rate.tolist(), self._change.tolist())
        return np.where(self._identified, rotors, 0.0)


def own_torque(arm: Arm, workspace: Workspace, period_s: float) -> OwnTorque | None:
    """Return the torque model of an arm's motion; None where nothing was identified."""
    if not any(watched(axis) for axis in arm.known):
        return None
    return OwnTorque(arm.known, arm.axes, workspace, period_s)


def watched(axis: AxisConstants) -> bool:
    """Return True if the motion torque of this axis was identified, so that contact detection uses it."""
    return all(one is not None and one.identified for one in (axis.coulomb_nm, axis.rotor_kg_m2))


def _of(used: NDArray[np.bool_], constants: list[Known | None]) -> Floats:
    """Return the values (N,) of the used axes, 0 for the others."""
    return np.array([one.value if here and one is not None else 0.0 for here, one in zip(used, constants, strict=True)])


def _dynamics(workspace: Workspace) -> ArmDynamics | None:
    """Return the link dynamics without gravity; None if a link is unknown or the cell file distrusts the masses."""
    robot = workspace.robot
    if workspace.links is None or not np.isfinite(robot.inertia_kg_m2).all():
        return None
    parts = zip(robot.mass_kg, robot.com_m, robot.inertia_kg_m2, strict=True)
    return ArmDynamics(robot, np.concatenate([body_parameters(*part) for part in parts]), np.zeros(3))
