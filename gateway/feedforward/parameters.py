"""Inertial parameters of the arm for the feedforward: the drawing's, corrected by what was identified at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.errors import ConfigError
from gateway.identify.links import body_parameters
from gateway.model.robot import Robot, link_lengths_m
from gateway.result.result import Bare

Floats = NDArray[np.float64]
#: A link lighter than this share of the drawing's is no correction but a contradiction.
LEAST_SHARE = 0.3


def drawn_parameters(robot: Robot, arm: ArmConfig) -> Floats:
    """Parameters (10 N,) of the links as the robot model gives them.

    Raises
    ------
    ConfigError
        A link of which mass, centre of mass or inertia is unknown, or inertials = "ignore": nothing is taken as zero.
    """
    if arm.inertials == "ignore":
        raise ConfigError(
            f"arm '{arm.name}': inertials = \"ignore\" leaves the links unknown, and feedforward needs them; give "
            'inertials = "prior:0.05" if the robot model holds plausible ones'
        )
    parameters = []
    for number in range(robot.axes):
        values = [robot.mass_kg[number], *robot.com_m[number], *robot.inertia_kg_m2[number].ravel()]
        if not np.isfinite(values).all():
            raise ConfigError(
                f"robot '{robot.name}', link {number + 1}: mass, centre of mass or inertia is not given; feedforward "
                "needs every link's inertials in the robot model"
            )
        parameters.append(body_parameters(values[0], robot.com_m[number], robot.inertia_kg_m2[number]))
    return np.concatenate(parameters)


def corrected_parameters(robot: Robot, drawn: Floats, bare: Bare, gravity_m_s2: Floats) -> Floats | None:
    """The drawing's parameters, changed the least so that the arm holds the torque that was identified bare.

    Masses and first moments are moved by the minimum of their changes over mass and mass times link length; each link's
    inertia about its own centre of mass stays.

    Parameters
    ----------
    robot : Robot
    drawn : array of shape (10 N,)
    bare : Bare
        Of a result: base gravity parameters.
    gravity_m_s2 : array of shape (3,)
        Of this arm.

    Returns
    -------
    array of shape (10 N,) or None
        None where the identification does not fit: another gravity or robot, not all of it known, or a link that would
        have to be lighter than a third of the drawing's.
    """
    if bare.robot != robot.name or not np.allclose(bare.gravity_m_s2, gravity_m_s2, atol=1e-6):
        return None
    combination, value = np.array(bare.combination, dtype=float), np.array(bare.value, dtype=float)
    if combination.ndim != 2 or not (np.isfinite(combination).all() and np.isfinite(value).all()):
        return None
    bodies = drawn.reshape(robot.axes, 10)
    lengths = link_lengths_m(robot)
    scale = (bodies[:, :1] * np.column_stack([np.ones(robot.axes), lengths, lengths, lengths])).ravel()
    wide = combination * scale
    change = scale * np.linalg.lstsq(wide, value - combination @ bodies[:, :4].ravel(), rcond=1e-9)[0]
    moments = bodies[:, :4] + change.reshape(robot.axes, 4)
    if (moments[:, 0] < LEAST_SHARE * bodies[:, 0]).any():
        return None
    return np.concatenate(
        [
            body_parameters(mass, moment / mass, robot.inertia_kg_m2[number])
            for number, (mass, moment) in enumerate(zip(moments[:, 0], moments[:, 1:], strict=True))
        ]
    )
