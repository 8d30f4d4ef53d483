"""Rigid-body inverse dynamics of an arm by PyBullet."""

from __future__ import annotations

import numpy as np

from sim.engine import Array, Engine
from sim.urdf import SimChain


class InverseDynamics(Engine):
    """Inverse dynamics of one arm; a context that gives its engine back.

    Raises
    ------
    UrdfError : a link without inertial, or inertias that the engine refuses
    """

    def __init__(self, chain: SimChain, gravity_m_s2: Array) -> None:
        super().__init__([chain], gravity_m_s2)

    def torque_nm(self, q_rad: Array, qd_rad_s: Array, qdd_rad_s2: Array) -> Array:
        """Return joint torques (n, N) [Nm] for states (n, N): gravity, inertia, Coriolis; no rotors, no friction."""
        states = zip(q_rad.tolist(), qd_rad_s.tolist(), qdd_rad_s2.tolist(), strict=True)
        return np.array([self.needed_nm(*state) for state in states])
