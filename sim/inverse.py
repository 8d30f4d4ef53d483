"""Rigid-body inverse dynamics of an arm by PyBullet."""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from sim.engine import NUDGE, NUDGES, bullet, load_arm, usable
from sim.urdf import SimBody, SimChain, UrdfError, write_chain

Array = NDArray[np.float64]


class InverseDynamics:
    """Inverse dynamics of one arm, in an engine of its own; a context that gives it back.

    PyBullet refuses an inertia that its own rounding made unsymmetrical in the last bit; centres of gravity a few
    picometres further out round otherwise.

    Raises
    ------
    UrdfError : a link without inertial, or inertias that the engine refuses
    """

    def __init__(self, chain: SimChain, gravity_m_s2: Array) -> None:
        still = [0.0] * len(chain.axis)
        for attempt in range(NUDGES):
            self._client = bullet.connect(bullet.DIRECT)
            self._body = load_arm(write_chain(_stretched(chain, 1.0 + attempt * NUDGE)), self._client)
            if usable(self._body, still, self._client):
                bullet.setGravity(*np.asarray(gravity_m_s2, dtype=float).tolist(), physicsClientId=self._client)
                return
            self.close()
        raise UrdfError("PyBullet refuses the inertias of the arm")

    def torque_nm(self, q_rad: Array, qd_rad_s: Array, qdd_rad_s2: Array) -> Array:
        """Return joint torques (n, N) [Nm] for states (n, N): gravity, inertia, Coriolis; no rotors, no friction."""
        states = zip(q_rad.tolist(), qd_rad_s.tolist(), qdd_rad_s2.tolist(), strict=True)
        body, client, torque = self._body, self._client, bullet.calculateInverseDynamics
        return np.array([torque(body, q, qd, qdd, physicsClientId=client) for q, qd, qdd in states])

    def close(self) -> None:
        """Give the engine back."""
        if self._client >= 0:
            bullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def __enter__(self) -> InverseDynamics:
        """Return this object as context manager."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Give the engine back."""
        self.close()


def _stretched(chain: SimChain, factor: float) -> SimChain:
    bodies = tuple(
        None if body is None else SimBody(body.mass_kg, factor * body.com_m, body.inertia_kg_m2)
        for body in chain.bodies
    )
    free = np.full(len(bodies), np.inf)
    return replace(chain, bodies=bodies, lower_rad=-free, upper_rad=free, effort_nm=free, velocity_rad_s=free)
