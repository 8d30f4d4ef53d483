"""The arm that the drives move: a hand-written chain of six links, its motors, and the moments of weight.

All joint frames are parallel when all angles are zero. `robot.urdf` beside the cell of the tests states the same arm;
a test compares the moments of weight of both by another library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

GRAVITY_M_S2 = 9.80665

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Link:
    """One joint and the link that it turns."""

    axis: str  # "x", "y" or "z"
    origin: Vector  # of the joint in the frame of the joint before [m]
    mass: float  # [kg]
    com: Vector  # centre of gravity in the frame of this joint [m]


LINKS = (
    Link("z", (0.0, 0.0, 0.30), 6.0, (0.010, -0.005, -0.060)),
    Link("y", (0.04, 0.0, 0.05), 5.2, (0.005, 0.020, 0.170)),
    Link("y", (0.0, 0.0, 0.40), 3.4, (0.040, -0.010, 0.020)),
    Link("x", (0.10, 0.0, 0.03), 2.6, (0.120, 0.004, -0.003)),
    Link("y", (0.30, 0.0, 0.0), 1.5, (0.030, -0.010, 0.004)),
    Link("x", (0.08, 0.0, 0.0), 0.4, (0.010, 0.001, 0.000)),
)


@dataclass(frozen=True)
class Motor:
    """Motor, gear and brake of one axis, as built."""

    ratio: float  # motor revolutions per joint revolution; negative = turned against the joint
    zero_rad: float  # joint angle at position 0
    rated_torque_mnm: int
    rated_current_ma: int
    inertia: float  # of rotor and gear at the joint [kg m2]
    coulomb: float  # friction at the joint [Nm]
    viscous: float  # [Nm s/rad]
    closing_s: float = 0.01  # from power off until the brake holds


MOTORS = (
    Motor(100.0, 0.0, 1300, 4200, 6.0, 8.0, 12.0),
    Motor(-100.0, 0.02, 1300, 4200, 6.0, 9.0, 12.0),
    Motor(80.0, 0.0, 900, 3100, 3.0, 5.0, 7.0),
    Motor(-60.0, 0.0, 450, 2400, 0.9, 1.8, 2.0),
    Motor(60.0, -0.015, 450, 2400, 0.9, 1.6, 2.0),
    Motor(50.0, 0.0, 250, 1900, 0.4, 0.8, 1.0),
)
#: Part of the motor's work that arrives at the joint, and of the joint's work that arrives at the motor.
EFFICIENCY = 0.9
COUNTS_PER_REVOLUTION = 1 << 16


def moments_of_weight(angles: Sequence[float], load: tuple[float, Vector] | None = None) -> list[float]:
    """Torques [Nm] that hold the arm against its weight: derivative of the potential energy by each joint angle.

    Parameters
    ----------
    angles : sequence of float
        Joint angles [rad].
    load : (mass, centre of gravity), optional
        Attached to the last link: kg, m in its joint's frame.
    """
    ex, ey, ez = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    place = (0.0, 0.0, 0.0)
    joints, weights = [], []
    for number, (link, angle) in enumerate(zip(LINKS, angles, strict=True)):
        place = _place(place, ex, ey, ez, link.origin)
        c, s = math.cos(angle), math.sin(angle)
        if link.axis == "x":
            axis, ey, ez = ex, _turned(ey, ez, c, s), _turned(ez, ey, c, -s)
        elif link.axis == "y":
            axis, ez, ex = ey, _turned(ez, ex, c, s), _turned(ex, ez, c, -s)
        else:
            axis, ex, ey = ez, _turned(ex, ey, c, s), _turned(ey, ex, c, -s)
        joints.append((axis, place))
        masses = [(link.mass, link.com)]
        if load is not None and number == len(LINKS) - 1:
            masses.append(load)
        weights.append([(mass, _place(place, ex, ey, ez, com)) for mass, com in masses])
    torques = [0.0] * len(LINKS)
    mass = moment_x = moment_y = 0.0
    for number in range(len(LINKS) - 1, -1, -1):
        for part, (x, y, _) in weights[number]:
            mass += part
            moment_x += part * x
            moment_y += part * y
        (axis_x, axis_y, _), (x, y, _) = joints[number]
        torques[number] = GRAVITY_M_S2 * (axis_x * (moment_y - mass * y) - axis_y * (moment_x - mass * x))
    return torques


def _turned(a: Vector, b: Vector, c: float, s: float) -> Vector:
    return (c * a[0] + s * b[0], c * a[1] + s * b[1], c * a[2] + s * b[2])


def _place(origin: Vector, ex: Vector, ey: Vector, ez: Vector, at: Vector) -> Vector:
    x, y, z = at
    return (
        origin[0] + x * ex[0] + y * ey[0] + z * ez[0],
        origin[1] + x * ex[1] + y * ey[1] + z * ez[1],
        origin[2] + x * ex[2] + y * ey[2] + z * ez[2],
    )
