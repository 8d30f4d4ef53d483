"""Draw the undeclared effects of an arm on the bus from a seed: one effect, none, or two.

The sizes are scaled to the strength wanted over the noise floor of this arm, on rest poses inside the limits of the
cell, as in the blind cells; what does not reach the least strength is not built in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.blind import LEAST_STRENGTH, applies, planned, scaled, wanted_strength
from sim.cellfile import ArmSpec
from sim.draw import DrawnArm, choose_poses, prior_std
from sim.draw_effects import MAKERS, Effect
from sim.offline import Protocol, half_floor
from sim.plant import Payload, Plant
from sim.units import OVERLOAD

Array = NDArray[np.float64]

#: Share of the seeds without an effect, and with two.
NONE, TWO = 0.35, 0.15
DRAWS = 8
POSES = 10
SAMPLES = 100
#: Time from one visit to the next, and while a load is mounted: typical of a recording at the cell's speeds.
VISIT_S, CHANGE_S = 9.0, 6.0
LOADED_S = POSES * VISIT_S + CHANGE_S
TOOL = "tool"


def draw_undeclared(arm: ArmSpec, plant: Plant, loads: Mapping[str, Payload], seed: int) -> list[Effect]:
    """Effects to build into an arm.

    Parameters
    ----------
    arm : ArmSpec
        Its chain, limits and gears.
    plant : Plant
        Its physics, build errors included.
    loads : mapping
        Loads that can be mounted on the flange; the first one is used.
    seed : int

    Returns
    -------
    list of effects as in the undeclared-effects file, each with its `strength` (absent for a commissioning mistake)
    """
    rng = np.random.default_rng([seed, 5])
    lot = float(rng.random())
    count = 0 if lot < NONE else 2 if lot > 1.0 - TWO else 1
    if count == 0:
        return []
    drawn = as_drawn(arm, plant, loads)
    starts_s = {"none": 0.0} | ({TOOL: LOADED_S} if drawn.loads else {})
    visits = planned(choose_poses(drawn.chain, drawn.floor_nm, drawn.prior_std, POSES, rng), starts_s, VISIT_S)
    names = [name for name in MAKERS if applies(name, drawn, two=count > 1)]
    effects: list[Effect] = []
    for name in rng.permutation(names)[:DRAWS]:
        effect, strength = scaled(drawn, visits, MAKERS[str(name)], wanted_strength(rng), rng)
        if strength >= LEAST_STRENGTH:
            effects.append(effect | ({"strength": strength} if math.isfinite(strength) else {}))
        if len(effects) == count:
            break
    return effects


def as_drawn(arm: ArmSpec, plant: Plant, loads: Mapping[str, Payload]) -> DrawnArm:
    """Return the arm of a cell file in the form of a drawn one, with the first of the loads."""
    low, high = np.array([axis.position_limit_rad for axis in arm.axes]).T
    rated = np.array([axis.torque_limit_nm for axis in arm.axes]) / OVERLOAD
    # the friction of each motion scatters about its band: the spread of a uniform loss on [0, settle]
    protocol = Protocol(SAMPLES, settle=math.sqrt(12.0) * plant.friction_scatter, resolution_nm=1e-3 * rated)
    return DrawnArm(
        chain=replace(arm.chain, lower_rad=low, upper_rad=high),
        urdf="",
        prior_std=prior_std(arm.chain),
        plant=plant,
        loads={TOOL: next(iter(loads.values()))} if loads else {},
        known={},
        protocol=protocol,
        gear_ratio=np.array([axis.gear_ratio for axis in arm.axes]),
        efficiency=np.array([axis.gear_efficiency for axis in arm.axes]),
        floor_nm=half_floor(plant, protocol),
        shift_time_s=(LOADED_S + 3.0 * VISIT_S, LOADED_S + 7.0 * VISIT_S),
    )
