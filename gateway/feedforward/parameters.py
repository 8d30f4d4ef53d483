"""Inertial parameters of the arm for the feedforward: CAD values, corrected by an identification at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.errors import ConfigError
from gateway.identify.links import PER_LINK_AT_REST, body_parameters, link_prior, link_values
from gateway.model.robot import Robot
from gateway.result.result import Bare

Floats = NDArray[np.float64]
#: Smallest corrected link mass, as a share of the CAD mass: below it the identification contradicts the robot model.
LEAST_SHARE = 0.3


def drawn_parameters(robot: Robot, arm: ArmConfig) -> Floats:
    """Return the parameters (10 N,) of the links from the robot model.

    Raises
    ------
    ConfigError
        Mass, centre of mass or inertia of a link is missing, or inertials = "ignore". No value is assumed to be zero.
    """
    if np.isinf(arm.link_std):
        raise ConfigError(
            f"arm '{arm.name}': inertials = \"ignore\" makes the links unknown, but feedforward needs them; give "
            'inertials = "prior:0.05" if the robot model holds plausible ones'
        )
    values = link_values(robot)
    missing = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(missing):
        raise ConfigError(
            f"robot '{robot.name}', link {missing[0] + 1}: mass, centre of mass or inertia is not given; feedforward "
            "needs every link's inertials in the robot model"
        )
    return values.ravel()


def corrected_parameters(robot: Robot, bare: Bare, gravity_m_s2: Floats) -> Floats | None:
    """Return the CAD parameters (10 N,) with the smallest change that reproduces the identified torque without a load.

    The sum of squares of the changes over mass (and over mass times link length, for first moments) is minimal. The
    inertia of each link about its own centre of mass is kept.

    Parameters
    ----------
    robot : Robot
    bare : Bare
        Base gravity parameters of a result.
    gravity_m_s2 : array of shape (3,)
        Gravity in the base frame of this arm.

    Returns
    -------
    array of shape (10 N,) or None
        None where the identification does not apply.
        That is another gravity or robot, missing values, or a link mass below `LEAST_SHARE` of the CAD mass.
    """
    if bare.robot != robot.name or not np.allclose(bare.gravity_m_s2, gravity_m_s2, atol=1e-6):
        return None
    combination, value = np.array(bare.combination, dtype=float), np.array(bare.value, dtype=float)
    if combination.ndim != 2 or not (np.isfinite(combination).all() and np.isfinite(value).all()):
        return None
    mean, std = link_prior(robot, 1.0, PER_LINK_AT_REST)
    # exact constraints: `identify.solve` weighs rows by their noise, and this arm has to hold its own torque exactly
    change = std * np.linalg.lstsq(combination * std, value - combination @ mean, rcond=1e-9)[0]
    moments = (mean + change).reshape(robot.axes, PER_LINK_AT_REST)
    if (moments[:, 0] < LEAST_SHARE * robot.mass_kg).any():
        return None
    return np.concatenate(
        [
            body_parameters(mass, moment / mass, robot.inertia_kg_m2[number])
            for number, (mass, moment) in enumerate(zip(moments[:, 0], moments[:, 1:], strict=True))
        ]
    )
