"""Friction of one gear as a set: a joint at rest stays at rest for any torque inside the band.

The gear's efficiency is written as a band too, so that driving, driven back and standing are one formula. For a motor
torque `u` (joint side) the gear output `T` may be anything in

    [min(eta u, u / eta), max(eta u, u / eta)] = u (eta + 1/eta) / 2  +-  |u| (1/eta - eta) / 2

and motion in direction d ends at the edge that takes power away: `T = eta u` where the motor drives, `T = u / eta`
where it is driven back. Coulomb friction, stiction and losses in proportion to the transmitted torque widen the band.
"""

from __future__ import annotations

import random

#: Speed at which friction has fallen half way from stiction to Coulomb [rad/s].
STRIBECK_RAD_S = 0.002
#: Time after which the creep of a stuck joint has fallen to half [s].
CREEP_TIME_S = 0.3
#: Rest after which the next motion finds its own level of friction [s]; a joint that crawls slower than this rests.
REST_S = 0.2
CRAWL_RAD_S = 2e-4


class JointFriction:
    """Friction of one joint, with its stick-slip state.

    Attributes
    ----------
    coulomb_nm, stiction_nm, viscous_nm_s_rad, load_friction, bias_nm, creep_rad_s, scatter : see `sim.plant.Plant`
    stuck_s : time since the joint came to rest, or to a crawl [s]; 0 while it moves
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.coulomb_nm = self.stiction_nm = self.viscous_nm_s_rad = 0.0
        self.load_friction = self.bias_nm = self.creep_rad_s = self.stuck_s = 0.0
        self.scatter = 0.0
        self._creep, self._scale = 0.0, 1.0
        self._middle, self._spread = 1.0, 0.0

    def set_efficiency(self, efficiency: float) -> None:
        """Set a gear efficiency in (0, 1]."""
        self._middle = 0.5 * (1.0 / efficiency + efficiency)
        self._spread = 0.5 * (1.0 / efficiency - efficiency)

    def speed(self, omega_rad_s: float, u_nm: float, tau_nm: float, step: float) -> float:
        """Speed after one step under motor torque, transmitted torque and friction.

        Parameters
        ----------
        omega_rad_s : speed before the step
        u_nm : motor torque, joint side
        tau_nm : torque the joint transmits to the link
        step : step width over rotor inertia [s / (kg m2)]

        Returns
        -------
        Speed [rad/s]; 0 (or a creep of at most `creep_rad_s`) while friction holds the joint
        """
        slow = STRIBECK_RAD_S / (STRIBECK_RAD_S + abs(omega_rad_s))
        lost = abs(u_nm) * self._spread + self.load_friction * abs(tau_nm)
        lost = (lost + (self.coulomb_nm + (self.stiction_nm - self.coulomb_nm) * slow) * self._scale) * step
        free = omega_rad_s + (u_nm * self._middle - tau_nm - self.bias_nm - self.viscous_nm_s_rad * omega_rad_s) * step
        if free > lost or free < -lost:
            omega = free - lost if free > lost else free + lost
            if -CRAWL_RAD_S < omega < CRAWL_RAD_S:
                self.stuck_s += 0.001
                return omega
            if self.stuck_s > REST_S and self.scatter:
                self._scale = max(0.0, 1.0 + self.scatter * self._random.gauss(0.0, 1.0))
            self.stuck_s = self._creep = 0.0
            return omega
        if self.creep_rad_s == 0.0 or lost == 0.0:
            self.stuck_s += 0.001
            return 0.0
        if self._creep == 0.0:
            self._creep = self.creep_rad_s * self._random.random()
        self.stuck_s += 0.001
        held = free / lost
        return self._creep * held * held * held / (1.0 + self.stuck_s / CREEP_TIME_S) ** 2
