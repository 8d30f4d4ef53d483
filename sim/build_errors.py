"""Build errors: geometric differences between the real arm and its drawing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.plant import Plant
from sim.urdf import SimChain

#: Usual standard deviation of a link's mass, and of its first moment as a share of mass x link length.
MASS_SHARE = 0.03


def with_build_errors(plant: Plant, chain: SimChain, seed: int, share: float = MASS_SHARE) -> Plant:
    """Plant whose link masses and centres of gravity differ from the drawing, drawn from a seed.

    `share` is the standard deviation of a link's mass, and of its first moment as a share of mass x link length. That
    length is the distance to the next joint, at least 0.1 m.
    """
    rng = np.random.default_rng([seed, 3])
    reach = np.linalg.norm(chain.placement[1:, :3, 3], axis=1)
    length = np.maximum(np.append(reach, reach[-1]), 0.1)
    mass = plant.link_mass_kg * (1.0 + share * np.clip(rng.standard_normal(plant.axes), -2.5, 2.5))
    shift = share * length[:, None] * np.clip(rng.standard_normal((plant.axes, 3)), -2.5, 2.5)
    scale = mass / plant.link_mass_kg
    return replace(
        plant,
        link_mass_kg=mass,
        link_com_m=plant.link_com_m + shift,
        link_inertia_kg_m2=plant.link_inertia_kg_m2 * scale[:, None, None],
    )
