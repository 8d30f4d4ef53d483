"""Rigid bodies in PyBullet, with its console output suppressed: inverse dynamics, mass matrix, steps of time."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.servo import TICK_S
from sim.urdf import SimBody, SimChain, UrdfError, write_chain

Array = NDArray[np.float64]
Numbers = Sequence[float] | Array


def _quietly() -> Any:
    """Import PyBullet without the line it writes to standard error, which belongs to the program's own messages."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as sink:
            os.dup2(sink.fileno(), 2)
        import pybullet
    finally:
        os.dup2(kept, 2)
        os.close(kept)
    return pybullet


bullet = _quietly()


@contextmanager
def unsaid_if_raised() -> Generator[None]:
    """Buffer the engine's console output during the block, and discard it if the block raises."""
    kept = os.dup(1)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)
        said.seek(0)
        os.write(1, said.read())


#: Attempts at building the links of an arm, and how much further out their centres of gravity are in each.
NUDGES, NUDGE = 12, 1e-11


class Engine:
    """Arms on one fixed base, without damping, limits and motors; a context that gives the engine back.

    PyBullet refuses an inertia that its own rounding made unsymmetrical in the last bit; centres of gravity a few
    picometres further out round otherwise. Each object is an engine of its own: PyBullet keeps inverse dynamics by
    address, and may return those of a deleted body.

    Parameters
    ----------
    chains : one arm, or several as branches of one body; states hold their N joints one after the other
    gravity_m_s2 : (3,)
    step_s : time step

    Raises
    ------
    UrdfError : a link without inertial, or inertias that the engine refuses
    """

    def __init__(self, chains: Sequence[SimChain], gravity_m_s2: Numbers, step_s: float = TICK_S) -> None:
        self._joints = list(range(sum(len(chain.axis) for chain in chains)))
        still = [0.0] * len(self._joints)
        for attempt in range(NUDGES):
            self.client = bullet.connect(bullet.DIRECT)
            self.body = self._load(_urdf([_stretched(chain, 1.0 + attempt * NUDGE) for chain in chains]))
            if self._usable(still):
                break
            self.close()
        else:
            raise UrdfError("PyBullet refuses the inertias of the arm")
        whose = {"bodyUniqueId": self.body, "physicsClientId": self.client}
        for joint in (-1, *self._joints):
            bullet.changeDynamics(linkIndex=joint, linearDamping=0, angularDamping=0, jointDamping=0, **whose)
        bullet.setJointMotorControlArray(
            jointIndices=self._joints, controlMode=bullet.VELOCITY_CONTROL, forces=still, **whose
        )
        bullet.setTimeStep(step_s, physicsClientId=self.client)
        self.set_gravity(gravity_m_s2)

    def _load(self, text: str) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "arm.urdf"
            path.write_text(text, encoding="utf-8")
            flags = bullet.URDF_USE_INERTIA_FROM_FILE
            return bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=self.client)

    def _usable(self, q_rad: list[float]) -> bool:
        """Return whether the engine can compute inverse dynamics; its console output is discarded."""
        try:
            with unsaid_if_raised():
                self.mass(q_rad)
        except (bullet.error, SystemError):  # the one is raised from the other
            return False
        return True

    def set_gravity(self, gravity_m_s2: Numbers) -> None:
        """Set gravity (3,) in the frame of the base [m/s2]."""
        bullet.setGravity(*(float(value) for value in gravity_m_s2), physicsClientId=self.client)

    def place(self, q_rad: Numbers, qd_rad_s: Numbers) -> None:
        """Set the state of the joints, each (N,)."""
        for joint in self._joints:
            bullet.resetJointState(
                self.body, joint, float(q_rad[joint]), float(qd_rad_s[joint]), physicsClientId=self.client
            )

    def mass(self, q_rad: Numbers) -> Array:
        """Mass matrix (N, N) at joint angles (N,) [kg m2]."""
        return np.array(bullet.calculateMassMatrix(self.body, list(q_rad), physicsClientId=self.client))

    def needed_nm(self, q_rad: Numbers, qd_rad_s: Numbers, qdd_rad_s2: Numbers) -> Array:
        """Joint torques (N,) [Nm] for a state: gravity, inertia, Coriolis; no rotors, no friction."""
        state = (list(q_rad), list(qd_rad_s), list(qdd_rad_s2))
        return np.array(bullet.calculateInverseDynamics(self.body, *state, physicsClientId=self.client))

    def torque_nm(self, q_rad: Array, qd_rad_s: Array, qdd_rad_s2: Array) -> Array:
        """Joint torques (n, N) [Nm] for states (n, N), as `needed_nm`."""
        states = zip(q_rad.tolist(), qd_rad_s.tolist(), qdd_rad_s2.tolist(), strict=True)
        return np.array([self.needed_nm(*state) for state in states])

    def step(self, torque_nm: list[float]) -> tuple[list[float], list[float]]:
        """Advance by one time step under joint torques (N,); return angles and speeds (N,) [rad, rad/s]."""
        body, client, joints = self.body, self.client, self._joints
        bullet.setJointMotorControlArray(body, joints, bullet.TORQUE_CONTROL, forces=torque_nm, physicsClientId=client)
        bullet.stepSimulation(physicsClientId=client)
        states = bullet.getJointStates(body, joints, physicsClientId=client)
        return [state[0] for state in states], [state[1] for state in states]

    def close(self) -> None:
        """Give the engine back; may be called again."""
        if self.client >= 0:
            bullet.disconnect(physicsClientId=self.client)
            self.client = -1

    def __enter__(self) -> Engine:
        """Return this object as context manager."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Give the engine back."""
        self.close()


def _stretched(chain: SimChain, factor: float) -> SimChain:
    """Return the chain without limits, its centres of gravity that much further out."""
    free = np.full(len(chain.bodies), np.inf)
    bodies = tuple(body and SimBody(body.mass_kg, factor * body.com_m, body.inertia_kg_m2) for body in chain.bodies)
    return replace(chain, bodies=bodies, lower_rad=-free, upper_rad=free, effort_nm=free, velocity_rad_s=free)


def _urdf(chains: Sequence[SimChain]) -> str:
    """Text of one robot whose chains are branches of one base link."""
    lines = ['<?xml version="1.0"?>', '<robot name="arms">']
    for number, text in enumerate(write_chain(chain) for chain in chains):
        links = re.findall(r"  <link.*?</link>", text, re.DOTALL)
        joints = re.findall(r"  <joint.*?</joint>", text, re.DOTALL)
        lines += links[:1] if number == 0 else []
        lines += [re.sub(r'"((?:link|joint)_\d)"', rf'"arm_{number}_\1"', part) for part in [*links[1:], *joints]]
    return "\n".join([*lines, "</robot>"])
