"""Kinematic chain with assumed link inertias from Denavit-Hartenberg rows.

The rows contain no masses. Each link is assumed to be a solid cylinder from its joint to the next one, thick at the
base and thin at the hand, as light as the axes can carry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.plant import GRAVITY_M_S2
from sim.urdf import FEWEST_AXES, MOST_AXES, SimBody, SimChain, UrdfError, translation, turn

Array = NDArray[np.float64]

#: Radius of the first and of the last link, share of the length of the arm.
FIRST_RADIUS, LAST_RADIUS = 0.08, 0.05
#: No link is thinner: a motor has to go into it.
LEAST_RADIUS_M = 0.04
#: Length of the last link without a flange, share of the length of the arm.
LAST_LENGTH = 0.05
#: Mass over volume of a link: aluminium and steel, with some air.
DENSITY_KG_M3 = 2500.0
#: What the links take of a torque limit at most, however the arm is stretched.
LINKS_SHARE = 0.3
#: Shorter than any arm.
LEAST_LENGTH_M = 0.1
#: An axis this far from the last frame does not go through it.
ON_AXIS_M = 1e-9
COLUMNS = ("alpha_rad", "a_m", "d_m", "theta_offset_rad")


def chain_of_rows(table: Mapping[str, Any], name: str, flange_m: Sequence[float], torque_nm: Array) -> SimChain:
    """Chain with assumed links.

    Parameters
    ----------
    table : `[arm.dh]` of the cell file
    name : of the arm
    flange_m : (3,) where the last link ends, in its frame; zeros = not known
    torque_nm : (N,) limits of the joint torques; the links are made as light as these can carry

    Raises
    ------
    UrdfError : columns of different length, a number that is none, a convention that is not known, or a standard table
        whose last length is not 0
    """
    rows = np.array([[float(value) for value in table[column]] for column in COLUMNS], dtype=float).T
    if not FEWEST_AXES <= len(rows) <= MOST_AXES or not np.isfinite(rows).all():
        raise UrdfError(f"[arm.dh] of '{name}': {FEWEST_AXES} to {MOST_AXES} rows of finite numbers are needed")
    poses, axes = _standing(rows, str(table["convention"]), name)
    steps = [poses[0], *(np.linalg.solve(before, pose) for before, pose in pairwise(poses))]
    placement = np.array(steps, dtype=np.float64)
    bodies = _links(placement, np.array(flange_m, dtype=float), torque_nm)
    open_ = np.full(len(rows), math.inf)
    return SimChain(name, placement, axes, bodies, -open_, open_, open_, open_)


def _standing(rows: Array, convention: str, name: str) -> tuple[list[Array], Array]:
    """Return the link frames (4, 4) in the base at q = 0, and the joint axes (N, 3) in these frames."""
    if convention == "modified":
        return list(accumulate((_craig(*row) for row in rows), np.matmul)), np.tile([0.0, 0.0, 1.0], (len(rows), 1))
    if convention != "standard":
        raise UrdfError(f"[arm.dh] of '{name}': convention '{convention}' is neither 'modified' nor 'standard'")
    ends = list(accumulate((_paul(*row) for row in rows), np.matmul))
    starts = [np.eye(4), *ends[:-1]]
    if abs(rows[-1, 1]) > ON_AXIS_M:
        raise UrdfError(f"[arm.dh] of '{name}': the last a_m must be 0 in the standard convention; use the flange")
    # each link is on its own axis, which is the z of the frame before it; the last one is its own frame
    poses = [*starts[:-1], ends[-1]]
    return poses, np.array([pose[:3, :3].T @ start[:3, 2] for pose, start in zip(poses, starts, strict=True)])


def _craig(alpha: float, a: float, d: float, theta: float) -> Array:
    """Return the modified Denavit-Hartenberg link transform (Craig, Introduction to Robotics, eq. 3.6)."""
    return turn("x", alpha) @ translation(a, 0.0, 0.0) @ turn("z", theta) @ translation(0.0, 0.0, d)


def _paul(alpha: float, a: float, d: float, theta: float) -> Array:
    """Return the standard Denavit-Hartenberg link transform (Paul, Robot Manipulators, eq. 2.32)."""
    return turn("z", theta) @ translation(a, 0.0, d) @ turn("x", alpha)


def _links(placement: Array, flange_m: Array, torque_nm: Array) -> tuple[SimBody, ...]:
    """Return cylindrical links between the joints, light enough for the torque limits in any posture."""
    steps = [*placement[1:, :3, 3], flange_m]
    length = max(sum(float(np.linalg.norm(step)) for step in steps), LEAST_LENGTH_M)
    if not flange_m.any():
        steps[-1] = np.array([0.0, 0.0, LAST_LENGTH * length])
    radii = np.maximum(np.linspace(FIRST_RADIUS, LAST_RADIUS, len(steps)) * length, LEAST_RADIUS_M)
    bodies = [_cylinder(step, radius) for step, radius in zip(steps, radii, strict=True)]
    share = min(1.0, LINKS_SHARE / _heaviest_share(bodies, steps, torque_nm))
    return tuple(SimBody(share * body.mass_kg, body.com_m, share * body.inertia_kg_m2) for body in bodies)


def _cylinder(step: Array, radius: float) -> SimBody:
    """Return a solid cylinder from the origin along a vector [m], at least as long as its diameter."""
    length = max(float(np.linalg.norm(step)), 2.0 * radius)
    along = step / np.linalg.norm(step) if step.any() else np.array([0.0, 0.0, 1.0])
    mass = DENSITY_KG_M3 * math.pi * radius**2 * length
    axial, across = 0.5 * mass * radius**2, mass * (3.0 * radius**2 + length**2) / 12.0
    inertia = across * np.eye(3) + (axial - across) * np.outer(along, along)
    return SimBody(mass, 0.5 * step, inertia)


def _heaviest_share(bodies: Sequence[SimBody], steps: Sequence[Array], torque_nm: Array) -> float:
    """Return the largest share of a torque limit that the links need, stretched out horizontally from the joint."""
    share = 0.0
    for joint, limit in enumerate(torque_nm):
        moment, way = 0.0, 0.0
        for body, step in zip(bodies[joint:], steps[joint:], strict=True):
            moment += body.mass_kg * (way + float(np.linalg.norm(body.com_m)))
            way += float(np.linalg.norm(step))
        share = max(share, GRAVITY_M_S2 * moment / float(limit))
    return share
