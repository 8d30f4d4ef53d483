"""Two arms as they really are, and as joints and links of the physics engine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.engine import Engine
from sim.pair.geometry import ArmGeometry
from sim.pair.motors import DriveTrain
from sim.plant import GRAVITY_M_S2
from sim.urdf import SimBody, SimChain, turn

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ArmTruth:
    """One arm as it really is.

    Attributes
    ----------
    geometry : with its errors
    bodies : N links, gripper and half the part on the last
    train : drives and gears
    """

    geometry: ArmGeometry
    bodies: tuple[SimBody, ...]
    train: DriveTrain


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


def load_pair(arms: tuple[ArmTruth, ArmTruth], step_s: float) -> Engine:
    """Both arms on one fixed base."""
    return Engine([chain_of(arm) for arm in arms], (0.0, 0.0, -GRAVITY_M_S2), step_s)
