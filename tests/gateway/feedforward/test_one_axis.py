"""Equations (7) and (8) of JP3698770B2: against numbers by hand, and as the special case of the whole model."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.feedforward.dynamics import ArmDynamics
from gateway.identify.links import body_parameters
from gateway.model.robot import robot_from_urdf

# One vertical axis at the origin, arm of 0.6 m with its centre of mass at 0.3 m; the five joints beyond are at its tip.
ARM, TIP, BEYOND = 0.3, 0.6, 0.1
ROTOR, MASS, OWN, LOAD, GAIN = 0.8, 20.0, 0.5, 12.0, 2.5


@pytest.fixture
def planar():
    """A robot whose first axis is vertical and carries everything."""
    inertial = (
        '<inertial><origin xyz="{x} 0 0"/><mass value="{m}"/>'
        '<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    text = ['<robot name="planar"><link name="base"/>']
    for number in range(1, 7):
        own = inertial.format(x=ARM, m=MASS, i=OWN) if number == 1 else inertial.format(x=0, m=1e-9, i=1e-9)
        place = f"{TIP} 0 0" if number == 2 else "0 0 0"
        text.append(
            f'<link name="link_{number}">{own}</link><joint name="joint_{number}" type="revolute">'
            f'<parent link="{"base" if number == 1 else f"link_{number - 1}"}"/><child link="link_{number}"/>'
            f'<origin xyz="{place}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    return robot_from_urdf("".join([*text, "</robot>"]), "planar.urdf")


def arm_inertia(rotor_kg_m2, mass_kg, distance_m, own_kg_m2):
    """J of equation (8): rotor (times gear ratio squared), arm as a point at its centre of mass, arm about it."""
    return rotor_kg_m2 + mass_kg * distance_m**2 + own_kg_m2


def equation_8(inertia_kg_m2, mass_kg, lever_m, acceleration_rad_s2):
    """tau = (J + m6 L) q'' with L = r6^2, r6 from the joint's axis to the load's centre of gravity.

    The print gives L = (s1 + l1 + s6)^2. With s1 measured from the joint, as J needs it, and l1 the arm's length, this
    counts s1 twice: (l1 + s6)^2 is right.
    """
    return (inertia_kg_m2 + mass_kg * lever_m**2) * acceleration_rad_s2


def parameters_of(robot, load):
    bodies = [body_parameters(robot.mass_kg[i], robot.com_m[i], robot.inertia_kg_m2[i]) for i in range(6)]
    bodies[5] = bodies[5] + load
    return np.concatenate(bodies)


def test_equation_8_is_the_whole_model_of_one_vertical_axis_with_a_point_load(planar):
    com = np.array([BEYOND, 0.0, 0.4])
    load = body_parameters(LOAD, com, np.zeros((3, 3)))
    rotor_free = arm_inertia(0.0, MASS, ARM, OWN)
    dynamics = ArmDynamics(planar, parameters_of(planar, load))
    torque = dynamics.torque([0.3, 0, 0, 0, 0, 0], [0.0] * 6, [GAIN, 0, 0, 0, 0, 0])[0]
    assert torque == pytest.approx(equation_8(rotor_free, LOAD, TIP + BEYOND, GAIN), rel=1e-7)
    # computed by hand: (20 x 0.3^2 + 0.5 + 12 x 0.7^2) x 2.5
    assert torque == pytest.approx(20.45, rel=1e-7)


def test_the_rotor_and_the_loads_own_inertia_are_what_the_equation_leaves_to_be_added(planar):
    com, own = np.array([BEYOND, 0.0, 0.0]), 0.7
    load = body_parameters(LOAD, com, own * np.eye(3))
    dynamics = ArmDynamics(planar, parameters_of(planar, load))
    torque = dynamics.torque([0.0] * 6, [0.0] * 6, [GAIN, 0, 0, 0, 0, 0])[0] + ROTOR * GAIN
    by_equation = equation_8(arm_inertia(ROTOR, MASS, ARM, OWN), LOAD, TIP + BEYOND, GAIN)
    assert torque - by_equation == pytest.approx(own * GAIN, rel=1e-6)
