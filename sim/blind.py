"""Blind cells: an arm drawn from a seed with an undeclared effect, none, or two; the truth goes to a file of its own.

The strength of an effect is what it does to the measured rows beyond everything that link and load parameters can take
over: its torques are weighted by the floor of each axis and projected on the base and load columns, with the prior on
the link parameters as rows; strength = RMS over the visits of what is left, on the axis where that is largest. For an
effect between the two sides of a visit: RMS of half the difference after removing each axis's mean, over the floor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.draw import GRAVITY, Arm, choose_poses, draw_arm
from sim.effects import apply_effects
from sim.offline import Protocol, Visit, gravity_columns, measure, point_jacobian
from sim.plant import Payload, Plant

Array = NDArray[np.float64]
Effect = dict[str, object]

VISIT_S = 25.0
CHANGE_S = 180.0
LEAST_STRENGTH = 1.5
MIX = {"clean": 0.52, "two": 0.14, "off": 0.08}


@dataclass(frozen=True, slots=True)
class Truth:
    """What was built in: effects as the undeclared-effects file has them, and their strengths (inf for a mistake)."""

    kind: str
    effects: tuple[Effect, ...]
    strengths: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BlindCell:
    """One cell: the arm, its plant with the effects built in, the visits of the first recording, the truth."""

    seed: int
    arm: Arm
    plant: Plant
    protocol: Protocol
    visits: tuple[Visit, ...]
    truth: Truth

    def measure(self, visits: Sequence[Visit], stream: int = 0) -> dict[str, NDArray]:
        """Rows of a measured table of the given visits; `stream` makes the noise of later recordings differ."""
        rng = np.random.default_rng([self.seed, 7, stream])
        return measure(self.arm.chain, self.plant, visits, self.arm.loads, self.protocol, rng)

    def later(self, poses_rad: Array, first_pose: int, start_s: float) -> tuple[Visit, ...]:
        """Further visits with the load on, one after the other."""
        return tuple(
            Visit(first_pose + k, "tool", start_s + VISIT_S * k, np.asarray(q)) for k, q in enumerate(poses_rad)
        )


def draw_cell(seed: int, count: int = 12) -> BlindCell:
    """Cell of one seed: arm, effects, and `count` rest poses, bare and then with the load."""
    rng = np.random.default_rng([seed, 1])
    arm = draw_arm(rng)
    poses = choose_poses(arm, count, rng)
    visits = [Visit(k, "none", VISIT_S * k, q) for k, q in enumerate(poses)]
    start = VISIT_S * count + CHANGE_S
    visits += [Visit(k, "tool", start + VISIT_S * k, q) for k, q in enumerate(poses)]
    truth, protocol = _draw_truth(arm, visits, rng)
    plant = apply_effects(arm.plant, truth.effects, point_jacobian(arm.chain))
    return BlindCell(seed, arm, plant, protocol, tuple(visits), truth)


def _draw_truth(arm: Arm, visits: list[Visit], rng: np.random.Generator) -> tuple[Truth, Protocol]:
    lot = rng.random()
    if lot < MIX["clean"]:
        return Truth("clean", (), ()), arm.protocol
    two, off = lot < MIX["clean"] + MIX["two"], lot > 1.0 - MIX["off"]
    makers = OFF_MAKERS if off else MAKERS
    names = [name for name in makers if _applies(name, arm, two)]
    chosen = [names[k] for k in rng.permutation(len(names))[: 2 if two else 1]]
    effects, strengths, protocol = [], [], arm.protocol
    for name in chosen:
        wanted = float(np.exp(rng.uniform(np.log(1.5), np.log(20.0))))
        if name == "position_friction":
            protocol, strength = _position_friction(arm, wanted, rng)
            effects.append({"name": name, "joints": [], "parameters": {}})
        else:
            effect, strength = _scaled(arm, visits, makers[name], wanted, rng)
            effects.append(effect)
        strengths.append(strength)
    return Truth("two" if two else "off" if off else "one", tuple(effects), tuple(strengths)), protocol


def _applies(name: str, arm: Arm, two: bool) -> bool:
    if name == "torque_constant_scale_common":
        return bool(arm.known)
    return not (two and name in ("sign_reversed", "axes_swapped", "current_rms_peak"))


def _scaled(
    arm: Arm, visits: list[Visit], maker: Maker, wanted: float, rng: np.random.Generator
) -> tuple[Effect, float]:
    """An effect whose strength is `wanted`, as far as its physical limit lets it; of several draws the closest."""
    best: tuple[Effect, float] | None = None
    for _ in range(4):
        build, limit = maker(arm, rng)
        if limit is None:
            return build(0.0), float("inf")
        size = 0.1 * limit
        for _ in range(4):
            reached = strength(arm, visits, build(size))
            size = min(limit, size * wanted / max(reached, 1e-12))
        effect = build(size)
        reached = strength(arm, visits, effect)
        if best is None or abs(np.log(max(reached, 1e-9) / wanted)) < abs(np.log(max(best[1], 1e-9) / wanted)):
            best = effect, reached
        if reached > 0.95 * wanted:
            break
    if best is None:
        raise ValueError("no effect was drawn")
    return best


def strength(arm: Arm, visits: Sequence[Visit], effect: Mapping[str, object]) -> float:
    """Projected strength of one effect over the noise floor, as the module text defines it."""
    quiet = replace(arm.protocol, settle=np.zeros(6), resolution_nm=np.zeros(6), samples=1)
    still = replace(arm.plant, reading_noise_nm=np.zeros(6))
    rng = np.random.default_rng(0)
    changed = apply_effects(still, [effect], point_jacobian(arm.chain))
    eta = arm.efficiency
    with_, without = (
        _halves(measure(arm.chain, plant, visits, arm.loads, quiet, rng), eta) for plant in (changed, still)
    )
    half_sum = (with_[0] - without[0]) / arm.floor_nm
    half_difference = with_[1] - without[1]
    half_difference = (half_difference - half_difference.mean(axis=0)) / arm.floor_nm
    q = np.array([visit.q_rad for visit in visits])
    links = gravity_columns(arm.chain, q, GRAVITY) / arm.floor_nm[:, None]
    loaded = np.array([visit.load != "none" for visit in visits], dtype=float)
    columns = [(links * arm.prior_std).reshape(-1, 24)]
    free = 0
    if not arm.known:
        columns.append((links[:, :, 20:] * loaded[:, None, None]).reshape(-1, 4))
        free = 4
    prior = np.hstack([np.eye(24), np.zeros((24, free))])
    design = np.vstack([np.hstack(columns), prior])
    target = np.append(half_sum.ravel(), np.zeros(24))
    fit, *_ = np.linalg.lstsq(design, target, rcond=None)
    left = (target - design @ fit)[: half_sum.size].reshape(-1, 6)
    rms = np.sqrt(np.mean(left**2, axis=0)), np.sqrt(np.mean(half_difference**2, axis=0))
    return float(max(rms[0].max(), rms[1].max()))


def _halves(columns: Mapping[str, NDArray], efficiency: Array) -> tuple[Array, Array]:
    """Half sum and half difference (visits, 6) of rows up, down; each side through the gear by its own direction."""
    sides = []
    for side, direction in ((slice(0, None, 2), 1.0), (slice(1, None, 2), -1.0)):
        motor = columns["tau_nm"][side]
        sides.append(np.where(motor * direction > 0, motor * efficiency, motor / efficiency))
    return (sides[0] + sides[1]) / 2.0, (sides[0] - sides[1]) / 2.0


# ------------------------------------------------------------------------------------ one maker per kind of effect

Build = Callable[[float], Effect]
Maker = Callable[[Arm, np.random.Generator], tuple[Build, float | None]]


def _entry(name: str, joints: Sequence[int], **parameters: object) -> Effect:
    return {"name": name, "joints": [int(j) for j in joints], "parameters": parameters}


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _joint(rng: np.random.Generator, first: int = 1, last: int = 6) -> int:
    return int(rng.integers(first, last + 1))


def _effort(arm: Arm, joint: int) -> float:
    """Rated torque of one axis, from the resolution of its reading [Nm]."""
    return float(arm.protocol.resolution_nm[joint - 1] * 1e3)


def _load_friction(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2)
    return lambda s: _entry("load_dependent_friction", [joint], coefficient=s), 0.4


def _tilt(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    angle = rng.uniform(0, 2 * np.pi)
    x, y = float(np.cos(angle)), float(np.sin(angle))
    return lambda s: _entry("base_tilt", [], tilt_x_rad=s * x, tilt_y_rad=s * y), 0.15


def _zero(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    return lambda s: _entry("joint_zero_offset", [joint], offset_rad=sign * s), 0.15


def _scale(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    return lambda s: _entry("torque_constant_scale", [joint], scale=1.0 + sign * s), 0.3


def _common_scale(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    sign = _sign(rng)
    return lambda s: _entry("torque_constant_scale", [], scale=1.0 + sign * s), 0.3


def _offset(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng), _sign(rng)
    return lambda s: _entry("torque_offset", [joint], offset_nm=sign * s), 0.3 * _effort(arm, joint)


def _drift(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    if arm.plant.temperature_c is not None:
        return lambda s: _entry("thermal_drift", [joint], per_k=sign * s), 0.03
    return lambda s: _entry("thermal_drift", [joint], per_s=sign * s), 5e-4


def _balancer(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    size = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    lever, anchor = size * rng.uniform(0.12, 0.3), size * rng.uniform(0.35, 0.8)
    shape = {"lever_m": lever, "anchor_m": anchor, "phase_rad": rng.uniform(-0.6, 0.6)}
    if rng.random() < 0.5:
        shape["free_length_m"] = (anchor - lever) * rng.uniform(0.6, 1.0)
    else:
        shape["gas_length_m"] = 2.0 * lever * rng.uniform(1.3, 2.5)
    unit = _effort(arm, 2) / lever / size
    return lambda s: _entry("balancer_spring", [2], stiffness_n_m=s * unit, **shape), 4.0


def _cable(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 4)
    shape: dict[str, object] = {"neutral_rad": rng.uniform(-0.5, 0.5)}
    if rng.random() < 0.3:
        shape["shape"] = "harmonic"
    return lambda s: _entry("cable_torque", [joint], stiffness_nm_rad=s, **shape), 0.3 * _effort(arm, joint)


def _elasticity(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 5)
    return lambda s: _entry("joint_elasticity", [joint], compliance_rad_nm=s), 0.12 / _effort(arm, joint)


def _ripple(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng)
    periods = float(arm.gear_ratio[joint - 1] * rng.integers(1, 3))
    phase = rng.uniform(0, 2 * np.pi)
    return (
        lambda s: _entry("torque_ripple", [joint], amplitude_nm=s, per_revolution=periods, phase_rad=phase),
        0.2 * _effort(arm, joint),
    )


def _coupling(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    pairs = [(5, 6), (2, 3), (4, 5), (4, 6)]
    pair, sign = pairs[int(rng.choice(4, p=[0.4, 0.3, 0.15, 0.15]))], _sign(rng)
    return lambda s: _entry("axis_coupling", pair, coefficient=sign * s), 1.0


def _link_mass(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    link = _joint(rng, 2, 4)
    body = arm.chain.bodies[link - 1]
    reach = float(np.linalg.norm(arm.chain.placement[min(link, 5), :3, 3])) + 0.2
    place = reach * rng.uniform(-0.6, 0.9, 3)
    mass = body.mass_kg if body else 1.0
    return lambda s: _entry(
        "link_mass", [link], mass_kg=s * mass, first_moment_kg_m=[float(v) for v in s * mass * place]
    ), 0.8


def _shift(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    when = VISIT_S * 12 + CHANGE_S + VISIT_S * float(rng.uniform(3, 9))
    reach = 0.3 * (arm.loads["tool"].mass_kg / 100.0) ** 0.3
    return lambda s: _entry("payload_shift", [], shift_m=[float(v) for v in s * direction], time_s=when), reach


def _reversed(_arm: Arm, rng: np.random.Generator) -> tuple[Build, None]:
    joint = _joint(rng)
    return lambda _s: _entry("sign_reversed", [joint]), None


def _swapped(_arm: Arm, rng: np.random.Generator) -> tuple[Build, None]:
    first, second = sorted(int(v) + 1 for v in rng.choice(6, 2, replace=False))
    return lambda _s: _entry("axes_swapped", [first, second]), None


def _rms_peak(_arm: Arm, rng: np.random.Generator) -> tuple[Build, None]:
    joint, factor = _joint(rng, 2), float(np.sqrt(2.0) ** _sign(rng))
    return lambda _s: _entry("current_rms_peak", [joint], factor=factor), None


MAKERS: dict[str, Maker] = {
    "load_dependent_friction": _load_friction,
    "base_tilt": _tilt,
    "joint_zero_offset": _zero,
    "torque_constant_scale": _scale,
    "torque_constant_scale_common": _common_scale,
    "torque_offset": _offset,
    "thermal_drift": _drift,
    "balancer_spring": _balancer,
    "cable_torque": _cable,
    "joint_elasticity": _elasticity,
    "torque_ripple": _ripple,
    "axis_coupling": _coupling,
    "link_mass": _link_mass,
    "payload_shift": _shift,
    "sign_reversed": _reversed,
    "axes_swapped": _swapped,
    "current_rms_peak": _rms_peak,
}


# ------------------------------------------------------------------------------------------------- off the library


def _hardening(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, phase = _joint(rng, 2, 5), rng.uniform(0, 2 * np.pi)
    return (
        lambda s: _entry("hardening_cable", [joint], amplitude_nm=s, phase_rad=phase),
        0.4 * _effort(arm, joint),
    )


def _buffer(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 5)
    angle = arm.chain.upper_rad[joint - 1] * rng.uniform(0.0, 0.4)
    return (
        lambda s: _entry("end_stop_buffer", [joint], stiffness_nm_rad2=s, angle_rad=angle),
        0.4 * _effort(arm, joint),
    )


def _linkage(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    phase = rng.uniform(0, 2 * np.pi)
    return lambda s: _entry("linkage_spring", [3], stiffness_nm=s, phase_rad=phase), 0.4 * _effort(arm, 3)


def _saturating(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 3)
    reference = _effort(arm, joint)
    return lambda s: _entry("saturating_motor", [joint], coefficient=s, reference_nm=reference), 0.6


def _eccentric(_arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, phase = _joint(rng, 2, 3), rng.uniform(0, 2 * np.pi)
    return lambda s: _entry("eccentric_gear", [joint], coefficient=s, phase_rad=phase), 0.4


def _hose(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    force = rng.standard_normal(3) * [1.0, 1.0, 0.3]
    force /= np.linalg.norm(force)
    unit = _effort(arm, 3)
    return lambda s: _entry("world_hose", [4], force_n=[float(v) for v in s * unit * force]), 0.5


def _bungee(arm: Arm, rng: np.random.Generator) -> tuple[Build, float]:
    reach = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    hook = reach * np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(1.5, 2.5)])
    unit = _effort(arm, 3) / reach**2
    return (
        lambda s: _entry(
            "bungee", [3], hook_m=[float(v) for v in hook], stiffness_n_m=s * unit, free_length_m=0.8 * reach
        ),
        0.6,
    )


def _position_friction(arm: Arm, wanted: float, rng: np.random.Generator) -> tuple[Protocol, float]:
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


def _unused(_arm: Arm, _rng: np.random.Generator) -> tuple[Build, None]:
    return lambda _s: _entry("position_friction", []), None


OFF_MAKERS: dict[str, Maker] = {
    "hardening_cable": _hardening,
    "end_stop_buffer": _buffer,
    "linkage_spring": _linkage,
    "saturating_motor": _saturating,
    "eccentric_gear": _eccentric,
    "world_hose": _hose,
    "bungee": _bungee,
    "position_friction": _unused,
}

__all__ = ["LEAST_STRENGTH", "BlindCell", "Payload", "Truth", "draw_cell", "strength"]
