"""Two arms as one body with two branches on a fixed base, as PyBullet requires them."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.pair.geometry import ArmGeometry, turn
from sim.pair.motors import DriveTrain
from sim.physics import bullet
from sim.urdf import SimBody, SimChain, write_chain

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ArmTruth:
    """One arm as it really is.

    Attributes
    ----------
    geometry : with its errors
    bodies : N links, gripper and half the part on the last
    train : drives and gears
    shift_rad : (N,) cell's zero offsets
    max_rad_s : (N,) speed limit of the drives
    """

    geometry: ArmGeometry
    bodies: tuple[SimBody, ...]
    train: DriveTrain
    shift_rad: Array
    max_rad_s: Array


def chain_of(arm: ArmTruth) -> SimChain:
    """The arm in the world as joints about z: everything between two axes is in the placement of the second."""
    geometry = arm.geometry
    before, placement = geometry.base, []
    axes = len(geometry.d_m)
    for i in range(axes):
        placement.append(before @ turn("z", geometry.zero_rad[i]))
        before = np.eye(4)
        before[:3, 3] = geometry.a_m[i], 0.0, geometry.d_m[i]
        before = before @ turn("x", geometry.alpha_rad[i])
    free = np.full(axes, np.inf)
    axis = np.tile([0.0, 0.0, 1.0], (axes, 1))
    return SimChain("arm", np.array(placement), axis, arm.bodies, -free, free, free, free)


def load_pair(arms: tuple[ArmTruth, ArmTruth], step_s: float) -> tuple[int, int]:
    """Engine and body: both arms on one fixed base."""
    client = bullet.connect(bullet.DIRECT)
    bullet.setTimeStep(step_s, physicsClientId=client)
    bullet.setGravity(0.0, 0.0, -9.80665, physicsClientId=client)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pair.urdf"
        path.write_text(_tree([write_chain(chain_of(arm)) for arm in arms]), encoding="utf-8")
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    joints = range(sum(len(arm.bodies) for arm in arms))
    for joint in (-1, *joints):
        bullet.changeDynamics(body, joint, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client)
    still = [0.0] * len(joints)
    bullet.setJointMotorControlArray(body, joints, bullet.VELOCITY_CONTROL, forces=still, physicsClientId=client)
    return client, body


def _tree(chains: list[str]) -> str:
    """Two chains as two branches of one base link."""
    lines = ['<?xml version="1.0"?>', '<robot name="pair">']
    for number, text in enumerate(chains):
        links = re.findall(r"  <link.*?</link>", text, re.DOTALL)
        joints = re.findall(r"  <joint.*?</joint>", text, re.DOTALL)
        lines += links[:1] if number == 0 else []
        lines += [re.sub(r'"((?:link|joint)_\d)"', rf'"arm_{number}_\1"', part) for part in [*links[1:], *joints]]
    return "\n".join([*lines, "</robot>"])
