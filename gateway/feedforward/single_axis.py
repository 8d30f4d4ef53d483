"""Feedforward of one axis alone: JP3698770B2 equations (7) and (8), the lever repaired.

    (7)  tau = (Jm + m1 s1^2 + I1) q'' + m6 r6^2 q''
    (8)  tau = (J + m6 L) q'',   J = Jm + m1 s1^2 + I1,   L = r6^2

r6 is the distance of the load's centre of gravity from the joint's axis. The print gives L = (s1 + l1 + s6)^2, which
counts s1 twice when s1 is measured from the joint, as J needs it, and l1 is the arm's length: (l1 + s6)^2 is right.
Here L is taken from the kinematics, so that there is nothing to mistake. Gravity, the other axes and the load's own
inertia are not in (8): it is what `dynamics.ArmDynamics` gives when one vertical axis alone moves a point mass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.model.kinematics import joint_axes_origins, link_frames
from gateway.model.robot import Robot

Floats = NDArray[np.float64]


def arm_inertia(rotor_kg_m2: float, mass_kg: float, distance_m: float, own_kg_m2: float) -> float:
    """J of equation (8): rotor (times gear ratio squared), arm as a point at its centre of mass, arm about it."""
    return rotor_kg_m2 + mass_kg * distance_m**2 + own_kg_m2


def lever_squared(robot: Robot, q_rad: Floats, joint: int, point_m: Floats) -> float:
    """L of equation (8): squared distance [m2] of a point from a joint's axis.

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (6,)
    joint : int
        From 0.
    point_m : array of shape (3,)
        Centre of gravity of the load in link 6.
    """
    axes, origins = joint_axes_origins(robot, q_rad[None])
    frame = link_frames(robot, q_rad[None])[0, -1]
    away = frame[:3, :3] @ point_m + frame[:3, 3] - origins[0, joint]
    across = away - (away @ axes[0, joint]) * axes[0, joint]
    return float(across @ across)


def single_axis_torque(inertia_kg_m2: float, mass_kg: float, lever_m2: float, acceleration_rad_s2: float) -> float:
    """Equation (8) [Nm]."""
    return (inertia_kg_m2 + mass_kg * lever_m2) * acceleration_rad_s2
