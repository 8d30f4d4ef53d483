"""Mechanisms of an arm in motion that its owner does not state, each written from what happens in the arm.

A mechanism changes the arm itself, bends it, adds a torque at the joints, or changes what a drive reports. Nothing here
depends on how effects are detected; the names are those that are right for each mechanism.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.moving_arm import MovingArm
from sim.urdf import SimBody, combine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MovingEffect:
    """One mechanism in motion; what it does not act on stays None.

    Attributes
    ----------
    name : the only right name
    joints : where it acts, from 1; empty where it acts on the whole arm
    arm : (arm, number of the period in its run) -> the arm as it is then
    angle_rad : (encoder angles (n, N), torque behind the gear (n, N) [Nm]) -> angles of the links (n, N)
    joint_nm : (angles (n, N), torque behind the gear (n, N)) -> torque (n, N) that is added there
    reading_nm : (motor torque (n, N), angles (n, N), seconds since the arm was cold (n,)) -> torque as reported (n, N)
    """

    name: str
    joints: tuple[int, ...]
    arm: Callable[[MovingArm, int], MovingArm] | None = None
    angle_rad: Callable[[Array, Array], Array] | None = None
    joint_nm: Callable[[Array, Array], Array] | None = None
    reading_nm: Callable[[Array, Array, Array], Array] | None = None


#: Size -> mechanism of that size.
Build = Callable[[float], MovingEffect]
#: Draws place and shape; returns the mechanism by its size, and the largest size (None = it has no size).
Maker = Callable[[MovingArm, np.random.Generator], tuple[Build, float | None]]


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _on(axis: int, values: Array, like: Array) -> Array:
    """Values (n,) on one axis, zero on the others (n, N)."""
    out = np.zeros_like(like)
    out[:, axis] = values
    return out


def gear_losses(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis = int(rng.integers(1, 6))

    def build(size: float) -> MovingEffect:
        def changed(old: MovingArm, _period: int) -> MovingArm:
            losses = old.friction.load_loss + size * (np.arange(6) == axis)
            return replace(old, friction=replace(old.friction, load_loss=losses))

        return MovingEffect("load_dependent_friction", (axis + 1,), arm=changed)

    return build, 0.4


def tilted_base(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    angle = rng.uniform(0.0, 2.0 * np.pi)

    def build(size: float) -> MovingEffect:
        x, y, z = arm.gravity_m_s2
        leaning = np.array([x - size * np.sin(angle) * z, y + size * np.cos(angle) * z, z])
        leaning *= np.linalg.norm(arm.gravity_m_s2) / np.linalg.norm(leaning)
        return MovingEffect("base_tilt", (), arm=lambda old, _period: replace(old, gravity_m_s2=leaning))

    return build, 0.15


def shifted_zero(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, sign = int(rng.integers(1, 6)), _sign(rng)
    shift = sign * (np.arange(6) == axis)
    return lambda size: MovingEffect("joint_zero_offset", (axis + 1,), angle_rad=lambda q, _tau: q + size * shift), 0.15


def soft_gear(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis = int(rng.integers(1, 5))
    which = np.arange(6) == axis
    build: Build = lambda size: MovingEffect(  # noqa: E731
        "joint_elasticity", (axis + 1,), angle_rad=lambda q, tau: q - size * which * tau
    )
    return build, 0.12 / float(arm.rated_nm[axis])


def wrong_constant(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, sign = int(rng.integers(1, 6)), _sign(rng)
    which = sign * (np.arange(6) == axis)
    return lambda size: MovingEffect(
        "torque_constant_scale", (axis + 1,), reading_nm=lambda motor, _q, _t: motor * (1.0 + size * which)
    ), 0.3


def offset_sensor(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, sign = int(rng.integers(0, 6)), _sign(rng)
    which = sign * (np.arange(6) == axis)
    return lambda size: MovingEffect(
        "torque_offset", (axis + 1,), reading_nm=lambda motor, _q, _t: motor + size * which
    ), 0.3 * float(arm.rated_nm[axis])


def weak_magnets(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, sign = int(rng.integers(1, 6)), _sign(rng)
    which = sign * (np.arange(6) == axis)
    return lambda size: MovingEffect(
        "thermal_drift",
        (axis + 1,),
        reading_nm=lambda motor, _q, time_s: motor * (1.0 + size * which * (time_s[:, None] - 1800.0)),
    ), 1e-3


def balancer(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    size_m = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    lever_m, anchor_m = size_m * rng.uniform(0.12, 0.3), size_m * rng.uniform(0.35, 0.8)
    phase_rad, free_m = rng.uniform(-0.6, 0.6), (anchor_m - lever_m) * rng.uniform(0.6, 1.0)
    unit_n_m = float(arm.rated_nm[1]) / lever_m / size_m

    def build(size: float) -> MovingEffect:
        def spring(q: Array, tau: Array) -> Array:
            angle = q[:, 1] - phase_rad
            length_m = np.sqrt(lever_m**2 + anchor_m**2 - 2.0 * lever_m * anchor_m * np.cos(angle))
            pull_n = size * unit_n_m * (length_m - free_m)
            return _on(1, pull_n * lever_m * anchor_m * np.sin(angle) / length_m, tau)

        return MovingEffect("balancer_spring", (2,), joint_nm=spring)

    return build, 4.0


def clamped_cable(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, neutral_rad = int(rng.integers(3, 6)), rng.uniform(-0.5, 0.5)
    return lambda size: MovingEffect(
        "cable_torque", (axis + 1,), joint_nm=lambda q, tau: _on(axis, size * (q[:, axis] - neutral_rad), tau)
    ), 0.3 * float(arm.rated_nm[axis])


def ripple(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    axis, phase = int(rng.integers(0, 6)), rng.uniform(0.0, 2.0 * np.pi)
    turns = float(arm.gear_ratio[axis] * rng.integers(1, 3))
    return lambda size: MovingEffect(
        "torque_ripple",
        (axis + 1,),
        reading_nm=lambda motor, q, _t: motor + _on(axis, size * np.sin(turns * q[:, axis] + phase), motor),
    ), 0.2 * float(arm.rated_nm[axis])


def geared_wrist(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    pairs = [(5, 6), (2, 3), (4, 5), (4, 6)]
    row, column = pairs[int(rng.choice(4, p=[0.4, 0.3, 0.15, 0.15]))]
    sign = _sign(rng)
    return lambda size: MovingEffect(
        "axis_coupling", (row, column), joint_nm=lambda _q, tau: _on(row - 1, sign * size * tau[:, column - 1], tau)
    ), 1.0


def dressed_link(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    link = int(rng.integers(1, 4))
    reach_m = float(np.linalg.norm(arm.chain.placement[min(link + 1, 5), :3, 3])) + 0.2
    place_m = reach_m * rng.uniform(-0.6, 0.9, 3)
    stated = arm.chain.bodies[link]
    mass_kg = 1.0 if stated is None else stated.mass_kg

    def build(size: float) -> MovingEffect:
        # a compact body: its own inertia is that of a ball of a tenth of the reach
        box = SimBody(size * mass_kg, place_m, 0.4 * size * mass_kg * (0.1 * reach_m) ** 2 * np.eye(3))

        def changed(old: MovingArm, _period: int) -> MovingArm:
            bodies = list(old.chain.bodies)
            body = bodies[link]
            bodies[link] = box if body is None else combine(body, box)
            return replace(old, chain=replace(old.chain, bodies=tuple(bodies)))

        return MovingEffect("link_mass", (link + 1,), arm=changed)

    return build, 0.8


def slipping_load(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, float]:
    towards = rng.standard_normal(3)
    towards /= np.linalg.norm(towards)

    def build(size: float) -> MovingEffect:
        def changed(old: MovingArm, period: int) -> MovingArm:
            slipped = replace(old.tool, com_m=np.asarray(old.tool.com_m) + size * towards)
            return replace(old, tool=slipped) if period > 0 else old

        return MovingEffect("payload_shift", (), arm=changed)

    return build, 0.3


def turned_sign(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, None]:
    axis = int(rng.integers(0, 6))
    sign = 1.0 - 2.0 * (np.arange(6) == axis)
    return lambda _size: MovingEffect("sign_reversed", (axis + 1,), reading_nm=lambda motor, _q, _t: motor * sign), None


def exchanged_cables(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, None]:
    first, second = sorted(int(axis) for axis in rng.choice(6, 2, replace=False))
    order = np.arange(6)
    order[[first, second]] = second, first
    return lambda _size: MovingEffect(
        "axes_swapped", (first + 1, second + 1), reading_nm=lambda motor, _q, _t: motor[:, order]
    ), None


def rms_for_peak(arm: MovingArm, rng: np.random.Generator) -> tuple[Build, None]:
    axis, factor = int(rng.integers(1, 6)), float(np.sqrt(2.0) ** _sign(rng))
    which = np.where(np.arange(6) == axis, factor, 1.0)
    return lambda _size: MovingEffect(
        "current_rms_peak", (axis + 1,), reading_nm=lambda motor, _q, _t: motor * which
    ), None


MAKERS: Mapping[str, Maker] = {
    "load_dependent_friction": gear_losses,
    "base_tilt": tilted_base,
    "joint_zero_offset": shifted_zero,
    "joint_elasticity": soft_gear,
    "torque_constant_scale": wrong_constant,
    "torque_offset": offset_sensor,
    "thermal_drift": weak_magnets,
    "balancer_spring": balancer,
    "cable_torque": clamped_cable,
    "torque_ripple": ripple,
    "axis_coupling": geared_wrist,
    "link_mass": dressed_link,
    "payload_shift": slipping_load,
    "sign_reversed": turned_sign,
    "axes_swapped": exchanged_cables,
    "current_rms_peak": rms_for_peak,
}
