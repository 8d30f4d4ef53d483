"""One arm that carries a gripper, and the gripper with a workpiece: the workpiece as the difference of both loads."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from benchmarks.calibrated.nature import (
    AXES,
    OCCASION_S,
    Floats,
    as_table,
    at_rest,
    draw,
    excitation,
    in_motion,
    occasion_gain,
    poses,
    stated_urdf,
)
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf


def workpiece(seed: int, kind: str, pose_count: int, gain_std: float) -> tuple[Floats, dict, float]:
    """Return the true workpiece (4,), its load by one fit, and the error [kg] of the difference of two results.

    The one fit has the unloaded arm and both loads; each of the two results is of a recording with one load, an
    unloaded run and poses of its own. Every block has a change of gain of its own.
    """
    cell = draw(seed, gain_std)
    spread_m = 0.09 * 0.45 * cell.arm.rated_kg**0.34
    mass_kg = cell.arm.rated_kg * cell.rng.uniform([0.1, 0.1], [0.4, 0.5])
    both = np.column_stack([mass_kg, spread_m * cell.rng.standard_normal((2, 3))])
    gripper, part = both
    places, blocks = [(poses(cell, pose_count), excitation(cell)) for _ in range(2)], []
    order = [("none", None), ("gripper", gripper), ("both", both), ("none", None), ("both", both)]
    for number, (label, load) in enumerate(order):
        loaded = cell if load is None else replace(cell, load=load)
        q_rad, motion = places[number // 3]
        when, gain = (label, f"r{number // 3}", number * OCCASION_S), occasion_gain(cell)
        if kind == "part in motion":
            blocks.append(in_motion(loaded, motion, *when, gain))
        else:
            blocks.append(at_rest(loaded, q_rad, *when, gain, np.zeros((pose_count, AXES)), repeats=1))
    knowledge = Knowledge(link_std=0.05, gain_std=(gain_std,) * AXES)
    robot = robot_from_urdf(stated_urdf(cell), "drawn.urdf")
    stated = replace(knowledge, parts={"part": ("both", "gripper")})
    loads = run(as_table([*blocks[0], *blocks[1], *blocks[2]]), robot, stated).loads
    alone = [run(as_table([*blocks[a], *blocks[b]]), robot, knowledge).loads[0].mass_kg for a, b in ((0, 1), (3, 4))]
    return part, asdict(next(load for load in loads if load.label == "part")), alone[1] - alone[0] - part[0]
