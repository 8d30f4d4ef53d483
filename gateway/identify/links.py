"""Link parameters from a robot model and their prior.

S is the relative standard deviation of every link's mass. The standard deviation of the first moment is S x mass x
length of the link, that of the inertia S x mass x length^2. A link without inertial has unknown parameters, not zero
mass.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.inertia import central_directions
from gateway.identify.load_estimate import load_directions
from gateway.model.motion import PER_BODY
from gateway.model.placeholders import wide_inertia
from gateway.model.robot import Robot, link_lengths_m, reach_m

Floats = NDArray[np.float64]

#: Relative standard deviation of link masses where none is stated.
LINK_STD: Final = 0.05
#: Parameters of one link: [m, h] at rest, [m, h, I about the link's origin] in motion.
PER_LINK_AT_REST: Final = 4
PER_LINK_MOVING: Final = PER_BODY
#: Power of the link's length by which each of them grows.
_POWERS: Final = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0])


def default_link_std(robot: Robot) -> float:
    """Return the relative standard deviation of the links that is assumed; infinite without link inertials."""
    return LINK_STD if np.isfinite(robot.mass_kg).any() else math.inf


def has_inertials(robot: Robot) -> bool:
    """Return whether mass and centre of mass of every link are known."""
    return bool(np.isfinite(robot.mass_kg).all() and np.isfinite(robot.com_m).all() and (robot.mass_kg > 0).all())


def body_parameters(mass_kg: float, com_m: Floats, inertia_kg_m2: Floats) -> Floats:
    """[m, h, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] (10,) of a body, inertia about the link's origin.

    Parameters
    ----------
    mass_kg : float
    com_m : array of shape (3,)
    inertia_kg_m2 : array of shape (3, 3)
        About the centre of mass, link axes.
    """
    com = np.asarray(com_m, dtype=float)
    about = np.asarray(inertia_kg_m2, dtype=float) + mass_kg * (com @ com * np.eye(3) - np.outer(com, com))
    return np.concatenate([[mass_kg], mass_kg * com, about[np.triu_indices(3)]])


def link_values(robot: Robot) -> Floats:
    """Parameters (N, 10) of the links in the robot model; NaN where it has none."""
    bodies = zip(robot.mass_kg, robot.com_m, robot.inertia_kg_m2, strict=True)
    return np.array([body_parameters(*body) for body in bodies])


def link_prior(robot: Robot, trust: float, per_link: int) -> tuple[Floats, Floats]:
    """Mean and standard deviation of the link parameters.

    Parameters
    ----------
    robot : Robot
    trust : float
        Relative standard deviation; 0 = exact, infinite = nothing is known.
    per_link : int
        How many parameters of each link: `PER_LINK_AT_REST` or `PER_LINK_MOVING`.

    Returns
    -------
    mean, std : arrays of shape (N per_link,)
        Mean 0 and infinite standard deviation where nothing is known. A mass of 0 or less is unknown. An inertia that
        is too large for its link is a placeholder: a point mass with the standard deviation mass x reach^2 instead.
    """
    wide = wide_inertia(robot) & (trust > 0.0)
    tensor = np.where(wide[:, None, None], 0.0, robot.inertia_kg_m2)
    values = link_values(replace(robot, inertia_kg_m2=tensor))[:, :per_link]
    known = np.isfinite(values[:, :PER_LINK_AT_REST]).all(axis=1) & np.isfinite(trust) & (robot.mass_kg > 0.0)
    size = robot.mass_kg[:, None] * link_lengths_m(robot)[:, None] ** _POWERS[:per_link]
    mean = np.where(known[:, None], np.nan_to_num(values), 0.0)
    std = np.full(mean.shape, np.inf)
    std[known] = trust * size[known]
    if per_link == PER_LINK_MOVING:
        std[known & wide, PER_LINK_AT_REST:] = (robot.mass_kg * reach_m(robot) ** 2)[known & wide, None]
    return mean.ravel(), std.ravel()


def as_bodies(mean: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Prior of k links as physical bodies: `rows @ parameters = right`, each with unit standard deviation.

    A link that weighs more than its model says has larger first moments and a larger inertia too. Ten independent
    numbers would count its mass several times, and through all links a common gain of the torques.
    As uncertain as in `link_prior` are the mass, the first moment at that mass, and the inertia about the centre of
    gravity.

    Parameters
    ----------
    mean, std : arrays of shape (10 k,)
        Of `link_prior`, of links of which something is known but not all.

    Returns
    -------
    rows, right : arrays of shape (10 k, 10 k), (10 k,)
    """
    rows = np.zeros((len(mean), len(mean)))
    for first in range(0, len(mean), PER_LINK_MOVING):
        part = slice(first, first + PER_LINK_MOVING)
        turn = np.zeros((PER_LINK_MOVING, PER_LINK_MOVING))
        turn[:4, :4], turn[4:] = load_directions(mean[part][:4]), central_directions(mean[part])
        size = std[part].copy()
        size[1:4] /= mean[first]
        rows[part, part] = turn / size[:, None]
    return rows, rows @ mean
