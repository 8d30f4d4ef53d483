"""Random arms from a seed: geometry, true inertials, a URDF with errors, friction, drives and loads.

Arms from the 10 kg to the 200 kg class, with a spherical wrist or with the offset wrist of light arms. The URDF that is
handed over carries inertials that are wrong by a few percent, as CAD is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.draw import DrawnArm, draw_load, prior_std
from sim.effects import warm_up
from sim.offline import Protocol, half_floor, statics
from sim.plant import Payload, nominal_plant
from sim.urdf import SimBody, SimChain, write_chain

Array = NDArray[np.float64]

POSES = 12
VISIT_S = 25.0
CHANGE_S = 180.0
#: Start of the first visit with the load: after the bare ones.
LOADED_S = POSES * VISIT_S + CHANGE_S


def draw_arm(rng: np.random.Generator) -> DrawnArm:
    """Draw one arm; everything random comes from `rng`."""
    payload_kg = float(np.exp(rng.uniform(np.log(10.0), np.log(200.0))))
    chain = arm_geometry(payload_kg, rng)
    body = [chain.bodies[i] for i in range(6)]
    masses = np.array([b.mass_kg for b in body if b])
    coms = np.array([b.com_m for b in body if b])
    tensors = np.array([b.inertia_kg_m2 for b in body if b])
    loads = {"tool": draw_load("tool", payload_kg, rng)}
    capacity = rated_torque_nm(chain, masses, coms, loads["tool"], rng)
    coulomb = capacity * rng.uniform(0.015, 0.05, 6)
    efficiency = np.ones(6) if rng.random() < 0.5 else rng.uniform(0.8, 0.95, 6)
    plant = nominal_plant(
        masses,
        coms,
        tensors,
        coulomb_nm=coulomb,
        stiction_nm=1.2 * coulomb,
        gear_efficiency=efficiency,
        reading_noise_nm=capacity * rng.uniform(0.002, 0.01, 6),
    )
    if rng.random() < 0.5:
        plant = replace(plant, temperature_c=warm_up)
    protocol = Protocol(samples=100, settle=rng.uniform(0.1, 0.6, 6), resolution_nm=capacity * 1e-3)
    std = prior_std(chain)
    tool = loads["tool"]
    known: dict[str, tuple[float, float, float, float]] = {}
    if rng.random() < 0.2:
        x, y, z = (float(v) for v in tool.com_m)
        known = {"tool": (tool.mass_kg, x, y, z)}
    return DrawnArm(
        chain=chain,
        urdf=_stated(chain, std, rng),
        prior_std=std,
        plant=plant,
        loads=loads,
        known=known,
        protocol=protocol,
        gear_ratio=np.round(rng.uniform(80, 220, 6)),
        efficiency=efficiency,
        floor_nm=half_floor(plant, protocol),
        shift_time_s=(LOADED_S + 3.0 * VISIT_S, LOADED_S + 9.0 * VISIT_S),
    )


def _stated(chain: SimChain, std: Array, rng: np.random.Generator) -> str:
    bodies = []
    for link, body in enumerate(chain.bodies):
        if body is None:
            raise ValueError(f"link_{link + 1} has no inertial")
        error = std[4 * link : 4 * link + 4] * np.clip(rng.standard_normal(4), -2.5, 2.5)
        mass = body.mass_kg + error[0]
        bodies.append(SimBody(mass, (body.mass_kg * body.com_m + error[1:]) / mass, body.inertia_kg_m2))
    return write_chain(replace(chain, bodies=tuple(bodies)))


def arm_geometry(payload_kg: float, rng: np.random.Generator) -> SimChain:
    """Return the chain of an arm for loads up to `payload_kg`, with a spherical wrist or an offset wrist."""
    size = (payload_kg / 165.0) ** 0.3
    total = payload_kg * float(rng.uniform(4.0, 7.0))
    spherical = rng.random() < 0.6
    base, upper, fore = (size * rng.uniform(low, high) for low, high in ((0.4, 0.8), (0.7, 1.2), (0.7, 1.3)))
    column, elbow, last = (size * rng.uniform(low, high) for low, high in ((0.1, 0.4), (0.0, 0.25), (0.1, 0.25)))
    x, y, z = np.eye(3)
    if spherical:
        steps = [(0, 0, base), (column, 0, 0.1 * size), (0, 0, upper), (0.4 * fore, 0, elbow), (0.6 * fore, 0, 0)]
        steps.append((last, 0, 0))
        axes, along = [z, y, y, x, y, x], [(0.5, 0.5), (0, 1), (1, 0), (1, 0), (1, 0), (1, 0)]
    else:
        rejected = 0.12 * size
        steps = [(0, 0, base), (0, rejected, 0.1 * size), (0, -0.8 * rejected, upper), (0, 0, fore), (0, rejected, 0)]
        steps.append((0, 0, last))
        axes, along = [z, y, y, y, z, y], [(0, 0.5), (0, 1), (0, 1), (0, 1), (0, 0.5), (0, 0.3)]
    shares = np.array([0.25, 0.28, 0.24, 0.11, 0.08, 0.04]) * rng.uniform(0.8, 1.2, 6)
    masses = total * shares / shares.sum()
    lengths = np.array([0.5 * size, upper, 0.4 * fore if spherical else fore, 0.6 * fore, last, last])
    placement, bodies = np.tile(np.eye(4), (6, 1, 1)), []
    for link in range(6):
        placement[link, :3, 3] = steps[link]
        direction = np.array([along[link][0], 0.0, along[link][1]], dtype=float)
        com = lengths[link] * (rng.uniform(0.3, 0.5) * direction + rng.uniform(-0.08, 0.08, 3))
        radius = 0.15 * size + 0.15 * lengths[link]
        bodies.append(
            SimBody(float(masses[link]), com, 0.4 * masses[link] * radius**2 * np.diag(rng.uniform(0.9, 1.1, 3)))
        )
    limits = np.array([2.9, 1.6, 2.2, 3.1, 2.1, 3.1]) * rng.uniform(0.8, 1.0, 6)
    return SimChain(
        name="drawn",
        placement=placement,
        axis=np.array(axes),
        bodies=tuple(bodies),
        lower_rad=-limits,
        upper_rad=limits,
        effort_nm=np.full(6, 1e4),
        velocity_rad_s=np.full(6, 2.0),
    )


def rated_torque_nm(chain: SimChain, masses: Array, coms: Array, load: Payload, rng: np.random.Generator) -> Array:
    """Return the rated torque (N,) [Nm]: the largest static torque over the joint space with the load, plus margin."""
    axes = len(masses)
    plant = nominal_plant(masses, coms, np.tile(np.eye(3), (axes, 1, 1)), payload=load)
    q = rng.uniform(chain.lower_rad, chain.upper_rad, (60, axes))
    largest = np.abs(statics(chain, plant, q)).max(axis=0)
    largest[0] = largest[:2].max()
    return 1.3 * np.maximum(largest, 0.02 * largest.max())
