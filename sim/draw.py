"""An arm with what is stated of it, loads drawn for it, and the rest poses that are most informative about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.offline import Protocol, gravity_columns
from sim.plant import Payload, Plant
from sim.urdf import SimChain

Array = NDArray[np.float64]

CAD_ERROR = 0.05
GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True, slots=True)
class DrawnArm:
    """Random arm: its true parameters, and the parameters stated in its URDF.

    Attributes
    ----------
    chain : geometry with the true inertials
    urdf : text of the URDF with wrong inertials
    prior_std : (24,) standard deviation of the CAD's [m, hx, hy, hz] per link
    plant : true physics without undeclared effects
    loads : loads that can be mounted on the flange
    known : label -> (mass, x, y, z) of loads that were weighed
    protocol : how it is measured
    gear_ratio, efficiency : (6,) as the cell file states them
    floor_nm : (6,) true noise floor of half the sum of both sides
    shift_time_s : between which times a load may shift: well inside the visits with the load
    """

    chain: SimChain
    urdf: str
    prior_std: Array
    plant: Plant
    loads: dict[str, Payload]
    known: dict[str, tuple[float, float, float, float]]
    protocol: Protocol
    gear_ratio: Array
    efficiency: Array
    floor_nm: Array
    shift_time_s: tuple[float, float]


def prior_std(chain: SimChain) -> Array:
    """Return the standard deviation (24,) of CAD inertials: 5 % of each mass, and of mass x length for moments."""
    std = np.zeros(24)
    for link in range(6):
        body = chain.bodies[link]
        if body is None:
            raise ValueError(f"link_{link + 1} has no inertial")
        reach = float(np.linalg.norm(chain.placement[link + 1, :3, 3])) if link < 5 else 0.0
        length = max(reach, float(np.linalg.norm(body.com_m)))
        std[4 * link] = CAD_ERROR * body.mass_kg
        std[4 * link + 1 : 4 * link + 4] = CAD_ERROR * body.mass_kg * length
    return std


def draw_load(label: str, payload_kg: float, rng: np.random.Generator) -> Payload:
    """Draw a load of 30 to 100 % of the arm's capacity, with the centre of gravity of a typical tool."""
    mass = payload_kg * float(rng.uniform(0.3, 1.0))
    reach = 0.25 * (payload_kg / 165.0) ** 0.3
    com = reach * rng.uniform(-1.0, 1.0, 3)
    return Payload(label, mass, com, 0.01 * mass * np.eye(3))


def choose_poses(chain: SimChain, floor_nm: Array, prior_std: Array, count: int, rng: np.random.Generator) -> Array:
    """Return rest poses (count, 6) that are most informative about load and links: greedy D-optimal among random ones.

    The links are known to `prior_std` (24,), and the noise floor is `floor_nm` (6,).
    """
    q = rng.uniform(0.95 * chain.lower_rad, 0.95 * chain.upper_rad, (80, 6))
    columns = gravity_columns(chain, q, GRAVITY) / floor_nm[:, None]
    scaled = columns * prior_std
    inverse = np.eye(24)
    chosen: list[int] = []
    for _ in range(count):
        gains = np.array([np.linalg.slogdet(np.eye(6) + rows @ inverse @ rows.T)[1] for rows in scaled])
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        chosen.append(best)
        rows = scaled[best]
        inverse = inverse - inverse @ rows.T @ np.linalg.solve(np.eye(6) + rows @ inverse @ rows.T, rows @ inverse)
    return q[chosen]
