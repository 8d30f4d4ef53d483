"""Blind cells: an arm drawn from a seed with one undeclared effect, none, or two; the truth is written to a separate
file.

Cells are drawn by the strength of `sim.blind`; `strength_beyond` projects the nuisance parameters out as well: errors
of the torque constants and a bias of friction by direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.drawn_arm import LOADED_S, POSES, VISIT_S, draw_arm
from sim.blind import BIAS_SHARE, GAIN_STD, applies, left_over, planned, scaled, strength, wanted_strength
from sim.draw import DrawnArm, choose_poses
from sim.draw_effects import MAKERS, MISTAKES, OFF_MAKERS, Effect
from sim.effects import apply_effects
from sim.offline import PlannedVisit, Protocol, measure, point_jacobian
from sim.plant import Plant

Array = NDArray[np.float64]

MIX = {"clean": 0.52, "two": 0.14, "off": 0.08}


@dataclass(frozen=True, slots=True)
class Truth:
    """Effects built into a blind cell, as in the undeclared-effects file, with their strengths (inf for a mistake)."""

    kind: str
    effects: tuple[Effect, ...]
    strengths: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BlindCell:
    """One cell: the arm, its plant with the effects built in, the visits of the first recording, the truth."""

    seed: int
    arm: DrawnArm
    plant: Plant
    protocol: Protocol
    visits: tuple[PlannedVisit, ...]
    truth: Truth

    def measure(self, visits: Sequence[PlannedVisit], stream: int = 0) -> dict[str, NDArray[Any]]:
        """Return the measured rows of pose visits; `stream` selects an independent noise sequence per recording."""
        rng = np.random.default_rng([self.seed, 7, stream])
        return measure(self.arm.chain, self.plant, visits, self.arm.loads, self.protocol, rng)

    def poses(self, count: int, stream: int) -> Array:
        """Return further poses (count, 6) that are informative about load and links; `stream` as `measure`."""
        rng = np.random.default_rng([self.seed, stream])
        return choose_poses(self.arm.chain, self.arm.floor_nm, self.arm.prior_std, count, rng)

    def later(self, poses_rad: Array, first_pose: int, start_s: float) -> tuple[PlannedVisit, ...]:
        """Further visits with the load on, one after the other."""
        return tuple(
            PlannedVisit(first_pose + k, "tool", start_s + VISIT_S * k, np.asarray(q)) for k, q in enumerate(poses_rad)
        )


def draw_cell(seed: int) -> BlindCell:
    """Cell of one seed: arm, effects, and rest poses, bare and then with the load."""
    rng = np.random.default_rng([seed, 1])
    arm = draw_arm(rng)
    poses = choose_poses(arm.chain, arm.floor_nm, arm.prior_std, POSES, rng)
    visits = planned(poses, {"none": 0.0, "tool": LOADED_S}, VISIT_S)
    truth, protocol = _draw_truth(arm, visits, rng)
    in_plant = [effect for effect in truth.effects if effect["name"] != "position_friction"]
    plant = apply_effects(arm.plant, in_plant, point_jacobian(arm.chain))
    return BlindCell(seed, arm, plant, protocol, tuple(visits), truth)


def _draw_truth(arm: DrawnArm, visits: list[PlannedVisit], rng: np.random.Generator) -> tuple[Truth, Protocol]:
    lot = rng.random()
    if lot < MIX["clean"]:
        return Truth("clean", (), ()), arm.protocol
    two, off = lot < MIX["clean"] + MIX["two"], lot > 1.0 - MIX["off"]
    makers = OFF_MAKERS if off else MAKERS
    names = [name for name in makers if applies(name, arm, two)]
    chosen = [names[k] for k in rng.permutation(len(names))[: 2 if two else 1]]
    effects, strengths, protocol = [], [], arm.protocol
    for name in chosen:
        wanted = wanted_strength(rng)
        if name == "position_friction":
            protocol, strength = _position_friction(arm, wanted, rng)
            effects.append({"name": name, "joints": [], "parameters": {}})
        else:
            effect, strength = scaled(arm, visits, makers[name], wanted, rng)
            effects.append(effect)
        strengths.append(strength)
    return Truth("two" if two else "off" if off else "one", tuple(effects), tuple(strengths)), protocol


def strength_beyond(arm: DrawnArm, visits: Sequence[PlannedVisit], effect: Mapping[str, object]) -> float:
    """Strength of one effect beyond gains and biases too; infinite for a mistake of commissioning."""
    if effect["name"] in MISTAKES:
        return float("inf")
    return strength(left_over(arm, visits, effect, GAIN_STD, BIAS_SHARE))


def _position_friction(arm: DrawnArm, wanted: float, rng: np.random.Generator) -> tuple[Protocol, float]:
    """Friction of one axis that changes once per turn; its swing is what the half differences show."""
    axis = int(rng.integers(1, 6))
    swing = min(0.9, wanted * float(arm.floor_nm[axis]) / max(float(arm.plant.coulomb_nm[axis]), 1e-9) * np.sqrt(2.0))
    phase = rng.uniform(0, 2 * np.pi)

    def factor(q_rad: Array) -> Array:
        out = np.ones(6)
        out[axis] += swing * np.cos(q_rad[axis] + phase)
        return out

    reached = swing / np.sqrt(2.0) * float(arm.plant.coulomb_nm[axis] / arm.floor_nm[axis])
    return replace(arm.protocol, band_factor=factor), reached
